//! Training and calibration of a detector from recorded episodes.
//!
//! The episodes are divided by scenario. One part fits the model. Of the other part, the highest score of each success gives
//! the threshold: the k-th smallest of n, with the smallest k for which the one-sided 95 % upper bound of the share of warned
//! successes (Clopper and Pearson, of n - k exceedances) is at most the promised one. This is functional conformal prediction with
//! the supremum as its score; the bound holds for new successes of the same population (Vovk 2012, training-conditional validity).

use std::collections::{BTreeMap, BTreeSet};

use robogate_maths::dense::Cholesky;
use robogate_stats::boosting::{Boosting, Monotone, Options};
use robogate_stats::{Confidence, Trials, clopper_pearson};
use serde::{Deserialize, Serialize};

use super::detector::{Detector, Distance, Model, Moments, Scratch};
use super::features::{Features, LAST_PHASE, Moment, Window};

/// The promised share of warned successes.
pub const PROMISED: f64 = 0.05;
/// The share of the scenarios that fit the model.
const MODEL_SHARE: f64 = 0.6;
/// The most evaluations of an episode that fit the model, so that long episodes do not count more.
const ROWS_OF_EPISODE: usize = 32;
/// The fewest failures among the episodes that fit the model for trees.
const FEWEST_FAILURES: usize = 20;
/// The fewest evaluations of successes in a cell.
const FEWEST_IN_CELL: usize = 25;
/// The most cells of all phases, and columns of a distance.
const MOST_CELLS: usize = 200;
const MOST_COLUMNS: usize = 40;
/// The shortest bin of the time in a phase, in seconds.
const BIN_S: f64 = 0.1;
/// Slack for times that are stored in 32 bits, in seconds.
const TIME_SLACK_S: f64 = 1e-4;

/// A recorded episode.
#[derive(Debug, Clone, PartialEq)]
pub struct Track {
    /// The index of the episode.
    pub index: u64,
    /// A number that episodes of the same scenario have in common.
    pub scenario: u64,
    /// Whether the scenario is a sample from the operating space, and not chosen by a model.
    pub sampled: bool,
    /// The failure mode. `None` for a success.
    pub failure: Option<String>,
    /// The time of the event, in seconds since the start. Later control periods are not used.
    pub event_s: f64,
    /// The time of each control period.
    pub times: Vec<f32>,
    /// The rows of the control periods, one after the other.
    pub rows: Vec<f32>,
    /// The parameters of [`Features::parameters`].
    pub parameters: Vec<f64>,
    /// All numbers of the scenario, for the baseline.
    pub scenario_numbers: Vec<f64>,
}

/// The scores of an episode before its event.
#[derive(Debug, Clone, PartialEq)]
pub struct Scored {
    /// The index of the episode.
    pub index: u64,
    /// As in [`Track::scenario`].
    pub scenario: u64,
    /// As in [`Track::sampled`].
    pub sampled: bool,
    /// The failure mode. `None` for a success.
    pub failure: Option<String>,
    /// The time of the event, in seconds.
    pub event_s: f64,
    /// The times of the evaluations.
    pub times: Vec<f32>,
    /// The score of each.
    pub scores: Vec<f64>,
}

/// A threshold and what it promises.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Calibration {
    /// Scores above it warn.
    pub threshold: f64,
    /// The number of independent successes.
    pub successes: u64,
    /// The rank of the threshold among them.
    pub rank: u64,
    /// The promised share of warned successes, with 95 % confidence.
    pub promised: f64,
}

/// The reason why no detector can be trained or calibrated.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum WarnError {
    /// Too few successes for the promise.
    #[error(
        "{found} independent successes for the calibration. At least {needed} are needed to promise that at most {} % of successes are warned, with 95 % confidence",
        100.0 * .promised
    )]
    TooFew {
        /// Successes of different scenarios.
        found: u64,
        /// The smallest number with which the promise is possible.
        needed: u64,
        /// The promised share.
        promised: f64,
    },
    /// The threshold would be among episodes whose scores are unknown.
    #[error(
        "too many successes were ended by a warner before it is known how high their scores become, so they give no threshold\nHint: \
         calibrate with a run without a warner, or with `--on-warning record`"
    )]
    Ended,
    /// Too few episodes to fit anything.
    #[error("{found} successes to learn from. At least {needed} are needed")]
    NothingToLearn {
        /// Successes that fit the model.
        found: usize,
        /// The smallest number.
        needed: usize,
    },
    /// A row that is not of these signals.
    #[error("the signals of episode {index} have another number of columns")]
    Width {
        /// The episode.
        index: u64,
    },
    /// A file with tables that do not fit.
    #[error("{0}")]
    Tables(String),
}

/// Divides the episodes by scenario: those that fit the model, and the others.
pub fn divided(tracks: &[Track], seed: u64) -> (Vec<&Track>, Vec<&Track>) {
    let mixed = |scenario: u64| {
        // SplitMix64 (Steele, Lea and Flood 2014).
        let mut z = scenario.wrapping_add(seed.wrapping_mul(0x9e37_79b9_7f4a_7c15)).wrapping_add(0x9e37_79b9_7f4a_7c15);
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    };
    // Exactly the wanted share of the scenarios, in an order that depends on the seed alone.
    let mut scenarios: Vec<u64> =
        tracks.iter().map(|track| track.scenario).collect::<BTreeSet<_>>().into_iter().collect();
    scenarios.sort_by_key(|scenario| mixed(*scenario));
    let model = (MODEL_SHARE * scenarios.len() as f64).round() as usize;
    let model: BTreeSet<u64> = scenarios.into_iter().take(model).collect();
    tracks.iter().partition(|track| model.contains(&track.scenario))
}

/// Calls `receive` with each evaluation of an episode before its event.
fn evaluations(
    features: &Features,
    window: &mut Window,
    track: &Track,
    receive: &mut dyn FnMut(Moment, &[f64]),
) -> Result<(), WarnError> {
    let width = features.signals.width();
    if track.rows.len() != width * track.times.len() {
        return Err(WarnError::Width { index: track.index });
    }
    window.start(&track.parameters);
    for (row, time_s) in track.rows.chunks_exact(width.max(1)).zip(&track.times) {
        if f64::from(*time_s) >= track.event_s - TIME_SLACK_S {
            break;
        }
        if let Some((moment, columns)) = window.push(*time_s, row) {
            receive(moment, columns);
        }
    }
    Ok(())
}

/// Trains a detector.
///
/// # Errors
/// Too few successes, or rows of other signals.
pub fn train(features: Features, tracks: &[&Track], seed: u64) -> Result<Detector, WarnError> {
    /// The fewest successes to learn from.
    const FEWEST: usize = 20;
    let failures = tracks.iter().filter(|track| track.failure.is_some()).count();
    let successes = tracks.len() - failures;
    if successes < FEWEST {
        return Err(WarnError::NothingToLearn { found: successes, needed: FEWEST });
    }
    let model = if failures >= FEWEST_FAILURES {
        Model::Trees(trees(&features, tracks, seed)?)
    } else {
        let successes: Vec<&Track> = tracks.iter().copied().filter(|track| track.failure.is_none()).collect();
        Model::Distance(distance(&features, &successes)?)
    };
    Ok(Detector { features, model })
}

fn trees(features: &Features, tracks: &[&Track], seed: u64) -> Result<Boosting, WarnError> {
    let options = Options {
        trees: 120,
        learning_rate: 0.08,
        leaves: 12,
        rows_of_leaf: 60,
        column_share: 0.5,
        seed,
        ..Options::default()
    };
    let width = features.names().len();
    let (mut columns, mut outcomes) = (vec![Vec::new(); width], Vec::new());
    let mut window = Window::new(features);
    for track in tracks {
        let mut rows: Vec<f64> = Vec::new();
        evaluations(features, &mut window, track, &mut |_, row| rows.extend(row))?;
        let n = rows.len() / width;
        let taken = n.min(ROWS_OF_EPISODE);
        for i in 0..taken {
            // Evenly spaced, at a place that differs between episodes.
            let offset = (track.index % 4) as f64 / 4.0;
            let at = ((i as f64 + offset) * n as f64 / taken as f64) as usize;
            columns.iter_mut().zip(&rows[at * width..]).for_each(|(column, x)| column.push(*x));
            outcomes.push(track.failure.is_none());
        }
    }
    let views: Vec<&[f64]> = columns.iter().map(Vec::as_slice).collect();
    let fit = Boosting::fit(&views, &outcomes, &vec![Monotone::Free; width], options);
    fit.map_err(|error| WarnError::Tables(error.to_string()))
}

/// Sums for means.
#[derive(Debug, Clone, Default)]
struct Sum {
    n: usize,
    values: Vec<f64>,
}

impl Sum {
    fn add(&mut self, values: &[f64]) {
        self.values.resize(values.len(), 0.0);
        self.values.iter_mut().zip(values).for_each(|(sum, x)| *sum += if x.is_finite() { *x } else { 0.0 });
        self.n += 1;
    }
}

fn distance(features: &Features, successes: &[&Track]) -> Result<Distance, WarnError> {
    let names = features.names();
    // Speeds, ways, bends and errors first, then the values of the shortest vectors. The clock is the cell.
    let mut places: Vec<usize> =
        (0..names.len() - features.clocks()).filter(|at| !names[*at].starts_with("change")).collect();
    places.sort_by_key(|at| names[*at].contains('[') && !names[*at].contains(" of "));
    places.truncate(MOST_COLUMNS);
    let mut window = Window::new(features);
    let mut rows: Vec<(Moment, Vec<f64>)> = Vec::new();
    let mut longest = [0.0_f64; LAST_PHASE + 1];
    for track in successes {
        evaluations(features, &mut window, track, &mut |moment, columns| {
            longest[moment.phase] = longest[moment.phase].max(f64::from(moment.in_phase_s));
            rows.push((moment, places.iter().map(|at| columns[*at]).collect()));
        })?;
    }
    // Columns that do not vary have no distance.
    let mut scale = Vec::new();
    let kept: Vec<usize> = (0..places.len())
        .filter(|i| {
            let values: Vec<f64> = rows.iter().map(|(_, x)| x[*i]).filter(|x| x.is_finite()).collect();
            let n = values.len().max(1) as f64;
            let mean = values.iter().sum::<f64>() / n;
            let deviation = (values.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / n).sqrt();
            let varies = values.len() * 2 > rows.len() && deviation > 1e-9 * (1.0 + mean.abs());
            scale.extend(varies.then_some([mean, deviation]));
            varies
        })
        .collect();
    let scaled = |x: &[f64]| -> Vec<f64> {
        let z = kept.iter().zip(&scale).map(|(i, [mean, deviation])| (x[*i] - mean) / deviation);
        z.map(|z| if z.is_finite() { z } else { 0.0 }).collect()
    };
    let rows: Vec<(Moment, Vec<f64>)> = rows.iter().map(|(moment, x)| (*moment, scaled(x))).collect();
    let total: f64 = longest.iter().sum();
    let bin_s = BIN_S.max(total / (MOST_CELLS - LAST_PHASE - 1) as f64);
    let (mut moments, means) = cells(&rows, longest, bin_s);
    let factors = factors(&rows, &moments, &means, kept.len())?;
    moments.bin_s = bin_s;
    let columns = kept.iter().map(|i| places[*i]).collect();
    let band = vec![[0.0, 1.0]; means.len()];
    let mut distance = Distance { columns, scale, moments, means, factors, band };
    // The band is that of the same successes.
    let mut scratch = Scratch::of(kept.len());
    let mut found: Vec<Vec<f64>> = vec![Vec::new(); distance.means.len()];
    let mut whole = Vec::new();
    for track in successes {
        evaluations(features, &mut window, track, &mut |moment, columns| {
            let Some(cell) = distance.moments.cell(moment) else { return };
            let raw = distance.raw(moment, columns, &mut scratch);
            found[cell].push(raw);
            whole.push(raw);
        })?;
    }
    whole.sort_by(f64::total_cmp);
    let least = 0.25 * (quantile(&whole, 0.84) - quantile(&whole, 0.16)).max(1e-6) / 2.0;
    for (band, values) in distance.band.iter_mut().zip(&mut found) {
        values.sort_by(f64::total_cmp);
        let median = quantile(values, 0.5);
        *band = [median, (quantile(values, 0.9) - median).max(least)];
    }
    Ok(distance)
}

/// The cells with enough successes, with the means of the columns in them and their neighbours.
fn cells(rows: &[(Moment, Vec<f64>)], longest: [f64; LAST_PHASE + 1], bin_s: f64) -> (Moments, Vec<Vec<f64>>) {
    let bins = longest.map(|longest| (longest / bin_s) as usize + 1);
    let mut sums: Vec<Vec<Sum>> = bins.iter().map(|bins| vec![Sum::default(); *bins]).collect();
    for (moment, x) in rows {
        let at = (f64::from(moment.in_phase_s) / bin_s) as usize;
        let last = (at + 1).min(bins[moment.phase] - 1);
        sums[moment.phase][at.saturating_sub(1)..=last].iter_mut().for_each(|sum| sum.add(x));
    }
    let mut means = Vec::new();
    let cells = sums.into_iter().map(|phase| {
        let cell = |sum: Sum| {
            (sum.n >= FEWEST_IN_CELL && means.len() < MOST_CELLS).then(|| {
                means.push(sum.values.iter().map(|x| x / sum.n as f64).collect());
                (means.len() - 1) as u16
            })
        };
        phase.into_iter().map(cell).collect()
    });
    let cells = cells.collect();
    (Moments { bin_s, cells }, means)
}

/// For each phase, the Cholesky factor of the covariance around the means of the cells, plus 0.01 on its diagonal.
fn factors(
    rows: &[(Moment, Vec<f64>)],
    moments: &Moments,
    means: &[Vec<f64>],
    size: usize,
) -> Result<Vec<Vec<f64>>, WarnError> {
    /// Variance of rounding and noise, in units of the variance over all moments.
    const RIDGE: f64 = 0.01;
    (0..=LAST_PHASE)
        .map(|phase| {
            let (mut matrix, mut n) = (vec![0.0; size * size], 0.0);
            for (moment, x) in rows.iter().filter(|(moment, _)| moment.phase == phase) {
                let Some(mean) = moments.cell(*moment).map(|cell| &means[cell]) else { continue };
                n += 1.0;
                for i in 0..size {
                    for j in 0..=i {
                        matrix[i * size + j] += (x[i] - mean[i]) * (x[j] - mean[j]);
                    }
                }
            }
            for i in 0..size {
                for j in 0..=i {
                    let value = matrix[i * size + j] / f64::max(n, 1.0) + if i == j { RIDGE } else { 0.0 };
                    (matrix[i * size + j], matrix[j * size + i]) = (value, value);
                }
            }
            let factor = Cholesky::new(&matrix, size, 1e-12)
                .map_err(|_| WarnError::Tables("the covariance of the successes is singular".to_owned()))?;
            Ok((0..size).flat_map(|i| factor.lower()[i * size..=i * size + i].to_vec()).collect())
        })
        .collect()
}

/// A quantile of sorted values. Zero without values.
pub(crate) fn quantile(sorted: &[f64], share: f64) -> f64 {
    let at = (share * sorted.len().saturating_sub(1) as f64).round() as usize;
    sorted.get(at).copied().unwrap_or(0.0)
}

/// The scores of an episode.
///
/// # Errors
/// Rows of other signals.
pub fn score(detector: &Detector, track: &Track) -> Result<Scored, WarnError> {
    let (mut window, mut scratch) = (Window::new(&detector.features), Scratch::new(&detector.model));
    let (mut times, mut scores) = (Vec::new(), Vec::new());
    evaluations(&detector.features, &mut window, track, &mut |moment, columns| {
        times.push(moment.time_s);
        scores.push(detector.model.score(moment, columns, &mut scratch));
    })?;
    let Track { index, scenario, sampled, event_s, .. } = *track;
    Ok(Scored { index, scenario, sampled, failure: track.failure.clone(), event_s, times, scores })
}

impl Scored {
    /// The same episode with other scores.
    pub fn with(&self, score: impl Fn(f32) -> f64) -> Self {
        Self { scores: self.times.iter().map(|time_s| score(*time_s)).collect(), ..self.clone() }
    }

    /// The highest score.
    pub fn highest(&self) -> f64 {
        self.scores.iter().copied().fold(f64::NEG_INFINITY, f64::max)
    }

    /// When a threshold warns, in seconds before the event.
    pub fn lead_s(&self, threshold: f64) -> Option<f64> {
        let at = self.scores.iter().position(|score| *score > threshold)?;
        Some(self.event_s - f64::from(self.times[at]))
    }
}

/// One success of each scenario: the first. Only scenarios that are a sample from the operating space.
pub fn independent_successes(scored: &[Scored]) -> Vec<&Scored> {
    let mut first: BTreeMap<u64, &Scored> = BTreeMap::new();
    for episode in scored.iter().filter(|episode| episode.sampled && episode.failure.is_none()) {
        let kept = first.entry(episode.scenario).or_insert(episode);
        if episode.index < kept.index {
            *kept = episode;
        }
    }
    first.into_values().collect()
}

/// The upper bound of the share of warned successes, one-sided, with 95 % confidence.
pub fn upper_bound(warned: u64, of: u64) -> f64 {
    // The two-sided interval of 90 % has 5 % on each side.
    let (Ok(trials), Ok(level)) = (Trials::new(warned, of), Confidence::new(0.9)) else { return 1.0 };
    clopper_pearson(trials, level).high
}

/// The threshold with this promise.
///
/// # Errors
/// Too few successes of different scenarios.
pub fn calibrate(scored: &[Scored], promised: f64) -> Result<Calibration, WarnError> {
    let mut highest: Vec<f64> = independent_successes(scored).iter().map(|episode| episode.highest()).collect();
    highest.sort_by(f64::total_cmp);
    let n = highest.len() as u64;
    let above = (0..n).take_while(|above| upper_bound(*above, n) <= promised).last();
    let Some(above) = above else {
        let needed = (0.05_f64.ln() / (1.0 - promised).ln()).ceil() as u64;
        return Err(WarnError::TooFew { found: n, needed, promised });
    };
    let rank = n - above;
    let threshold = highest[rank as usize - 1];
    let known = threshold < f64::INFINITY;
    if known { Ok(Calibration { threshold, successes: n, rank, promised }) } else { Err(WarnError::Ended) }
}
