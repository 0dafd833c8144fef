//! Calibration: whether predicted probabilities match observed rates.
//!
//! - Brier score: mean of (p - y)².
//! - Log loss: mean of -ln P(observed outcome). Infinite if an outcome with probability 0 occurred; the result reports
//!   this.
//! - Reliability: rows in bins of p. Each bin compares the mean p with the observed rate and its Wilson interval.
//! - Expected calibration error: Σ share of the bin · |observed - mean p|. It is biased upwards if bins have few rows,
//!   and it depends on the bins, so their number is part of the figure.
//!
//! With weights, every mean is a weighted mean, and bin intervals use Kish's effective counts. Rows of one cluster, such as
//! repeats of a scenario, may depend on each other: bin intervals then divide these counts by the design effect of the bin
//! ([`design_effect`]). Limit: a good score in sample does not imply a good score out of sample. Sources: Brier (1950);
//! Good (1952); Murphy and Winkler (1977); Naeini, Cooper and Hauskrecht (2015).

use crate::interval::{Confidence, Interval, wilson_real};
use crate::prediction_powered::design_effect;
use crate::weighted::is_weight;

/// The reason why probabilities cannot be scored.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum CalibrationError {
    /// Lengths differ.
    #[error("{found} values. Expected {expected}, one for each outcome")]
    Length {
        /// Rows of the outcomes.
        expected: usize,
        /// Values found.
        found: usize,
    },
    /// A stated probability is outside [0, 1] or NaN.
    #[error("row {row}: {value} is not a probability. Expected a number from 0 to 1")]
    NotAProbability {
        /// Index of the row.
        row: usize,
        /// Value found.
        value: f64,
    },
    /// A weight is negative, NaN, or so large or small that its square over- or underflows.
    #[error("the weight of row {row} is {value}. Expected 0 or a number from 1e-150 to 1e150")]
    BadWeight {
        /// Index of the row.
        row: usize,
        /// Value found.
        value: f64,
    },
    /// No row has positive weight.
    #[error("no row has positive weight. Expected at least one")]
    NoRows,
    /// Reliability needs at least one bin.
    #[error("the number of bins is 0. Expected at least 1")]
    NoBins,
}

/// How the interval [0, 1] is divided into bins.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Bins {
    /// This number of bins of equal width over [0, 1].
    EqualWidth(usize),
    /// This number of bins with nearly equal row counts. Equal probabilities stay together.
    EqualCount(usize),
}

/// One bin of a reliability diagram.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ReliabilityBin {
    /// Smallest and largest stated probability that can be in the bin.
    pub range: Interval,
    /// Rows of positive weight in the bin.
    pub rows: usize,
    /// Share of the total weight.
    pub share: f64,
    /// Mean stated probability.
    pub stated: f64,
    /// Observed rate of success.
    pub observed: f64,
    /// Wilson interval of the observed rate.
    pub interval: Interval,
}

/// Scores of stated probabilities.
#[derive(Debug, Clone, PartialEq)]
pub struct Calibration {
    /// Rows of positive weight.
    pub rows: usize,
    /// Mean of (p - y)².
    pub brier: f64,
    /// Brier score of a constant prediction of the overall rate: the baseline for the model.
    pub brier_of_the_rate: f64,
    /// Mean of -ln P(observed outcome). `None` if infinite, see `certain_and_wrong`.
    pub log_loss: Option<f64>,
    /// Rows with a stated probability of 0 or 1 and the opposite outcome.
    pub certain_and_wrong: usize,
    /// Expected calibration error over `bins`.
    pub expected_error: f64,
    /// Largest |observed - stated| over `bins`.
    pub largest_error: f64,
    /// Non-empty bins, in order.
    pub bins: Vec<ReliabilityBin>,
}

/// Scores stated probabilities of success.
///
/// `clusters[i]` is the cluster of row i. Without clusters, rows are independent.
///
/// # Errors
/// Unequal lengths, an invalid probability or weight, no rows, or zero bins.
pub fn calibration(
    probabilities: &[f64],
    outcomes: &[bool],
    weights: Option<&[f64]>,
    clusters: Option<&[usize]>,
    bins: Bins,
    confidence: Confidence,
) -> Result<Calibration, CalibrationError> {
    let expected = outcomes.len();
    let lengths = [Some(probabilities.len()), weights.map(<[f64]>::len), clusters.map(<[usize]>::len)];
    for found in lengths.into_iter().flatten() {
        if found != expected {
            return Err(CalibrationError::Length { expected, found });
        }
    }
    if let Some(row) = probabilities.iter().position(|p| !(0.0..=1.0).contains(p)) {
        return Err(CalibrationError::NotAProbability { row, value: probabilities[row] });
    }
    if let Some((row, value)) = weights.and_then(|w| w.iter().copied().enumerate().find(|(_, w)| !is_weight(*w))) {
        return Err(CalibrationError::BadWeight { row, value });
    }
    let weight = |row: usize| weights.map_or(1.0, |w| w[row]);
    let rows: Vec<usize> = (0..expected).filter(|&row| weight(row) > 0.0).collect();
    if rows.is_empty() {
        return Err(CalibrationError::NoRows);
    }
    let total: f64 = rows.iter().map(|&r| weight(r)).sum();

    let mut brier = 0.0;
    let mut loss = 0.0;
    let mut success_weight = 0.0;
    let mut certain_and_wrong = 0;
    for &row in &rows {
        let (p, w) = (probabilities[row], weight(row));
        let y = f64::from(u8::from(outcomes[row]));
        brier += w * (p - y).powi(2);
        success_weight += w * y;
        let seen = if outcomes[row] { p.ln() } else { (-p).ln_1p() };
        if seen.is_finite() {
            loss -= w * seen;
        } else {
            certain_and_wrong += 1;
        }
    }
    let rate = success_weight / total;
    let columns = Columns { probabilities, outcomes, clusters };
    let bins = reliability(columns, &rows, &weight, total, bins, confidence)?;
    let gap = |b: &ReliabilityBin| (b.observed - b.stated).abs();
    Ok(Calibration {
        rows: rows.len(),
        brier: brier / total,
        brier_of_the_rate: rate * (1.0 - rate),
        log_loss: (certain_and_wrong == 0).then_some(loss / total),
        certain_and_wrong,
        expected_error: bins.iter().map(|b| b.share * gap(b)).sum(),
        largest_error: bins.iter().map(gap).fold(0.0, f64::max),
        bins,
    })
}

/// The columns of the rows, without their weights.
#[derive(Clone, Copy)]
struct Columns<'a> {
    probabilities: &'a [f64],
    outcomes: &'a [bool],
    clusters: Option<&'a [usize]>,
}

fn reliability(
    Columns { probabilities, outcomes, clusters }: Columns<'_>,
    rows: &[usize],
    weight: &impl Fn(usize) -> f64,
    total: f64,
    bins: Bins,
    confidence: Confidence,
) -> Result<Vec<ReliabilityBin>, CalibrationError> {
    let edges: Vec<f64> = match bins {
        Bins::EqualWidth(0) | Bins::EqualCount(0) => return Err(CalibrationError::NoBins),
        Bins::EqualWidth(k) => (0..=k).map(|i| i as f64 / k as f64).collect(),
        Bins::EqualCount(k) => {
            let mut sorted: Vec<f64> = rows.iter().map(|&r| probabilities[r]).collect();
            sorted.sort_unstable_by(f64::total_cmp);
            let mut edges = vec![0.0];
            edges.extend((1..k).map(|i| sorted[i * sorted.len() / k]));
            edges.push(1.0);
            edges.dedup();
            edges
        }
    };
    let inner = &edges[1..edges.len() - 1];
    let count = edges.len() - 1;
    let mut sums = vec![[0.0_f64; 4]; count];
    let mut members: Vec<Vec<usize>> = vec![Vec::new(); count];
    for &row in rows {
        let (p, w) = (probabilities[row], weight(row));
        let bin = inner.partition_point(|edge| *edge <= p);
        members[bin].push(row);
        sums[bin][0] += w;
        sums[bin][1] += w * w;
        sums[bin][2] += w * p;
        sums[bin][3] += w * f64::from(u8::from(outcomes[row]));
    }
    let z = confidence.z();
    Ok((0..count)
        .filter(|&b| !members[b].is_empty())
        .map(|b| {
            let [w, ww, wp, wy] = sums[b];
            let observed = (wy / w).min(1.0);
            let shared = clusters.map_or(1.0, |clusters| inflation(outcomes, clusters, &members[b], confidence));
            let effective = w * w / ww / shared;
            ReliabilityBin {
                range: Interval { low: edges[b], high: edges[b + 1] },
                rows: members[b].len(),
                share: w / total,
                stated: wp / w,
                observed,
                interval: wilson_real(observed * effective, effective, z),
            }
        })
        .collect())
}

/// How many times the variance of the rate of these rows exceeds that of independent ones.
fn inflation(outcomes: &[bool], clusters: &[usize], rows: &[usize], confidence: Confidence) -> f64 {
    let of_rows: Vec<usize> = rows.iter().map(|&row| clusters[row]).collect();
    let mut distinct = of_rows.clone();
    distinct.sort_unstable();
    distinct.dedup();
    match distinct.len() {
        // Rows of one cluster do not show how much they share.
        1 => rows.len() as f64,
        count if count == rows.len() => 1.0,
        _ => {
            let outcomes: Vec<bool> = rows.iter().map(|&row| outcomes[row]).collect();
            design_effect(&outcomes, &[of_rows], confidence)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::interval::{Trials, wilson};

    #[test]
    fn clusters_widen_the_bins() {
        let outcomes: Vec<bool> = (0..200).map(|i| i / 5 * 7 % 10 < 6).collect();
        let stated = vec![0.6; 200];
        let interval = |clusters: Option<&[usize]>| {
            let found = calibration(&stated, &outcomes, None, clusters, Bins::EqualCount(1), Confidence::P95).unwrap();
            assert!((found.bins[0].observed - 0.6).abs() < 1e-12);
            found.bins[0].interval
        };
        let alone: Vec<usize> = (0..200).collect();
        assert_eq!(interval(None), interval(Some(&alone)));
        // 40 clusters of five equal outcomes are worth a little less than 40 rows, because their variance is estimated.
        let clusters: Vec<usize> = (0..200).map(|i| i / 5).collect();
        let [five, forty] = [interval(Some(&clusters)), wilson(Trials::new(24, 40).unwrap(), Confidence::P95)];
        assert!(five.width() > forty.width() && five.width() < 1.1 * forty.width(), "{five:?} {forty:?}");
        // One cluster is worth one row.
        assert_eq!(interval(Some(&[7; 200])), wilson_real(0.6, 1.0, Confidence::P95.z()));
    }

    #[test]
    fn certain_errors_are_counted() {
        let c = calibration(&[1.0, 0.5], &[false, true], None, None, Bins::EqualWidth(10), Confidence::P95).unwrap();
        assert_eq!((c.log_loss, c.certain_and_wrong), (None, 1));
    }

    #[test]
    fn constant_prediction_scores_baseline() {
        let outcomes = [true, false, false, true, false];
        let c = calibration(&[0.4; 5], &outcomes, None, None, Bins::EqualCount(4), Confidence::P95).unwrap();
        assert!((c.brier - c.brier_of_the_rate).abs() < 1e-15 && c.expected_error < 1e-15);
        assert_eq!(c.bins.len(), 1);
    }

    #[test]
    fn invalid_probability_is_rejected() {
        for p in [-0.1, 1.1, f64::NAN] {
            let found = calibration(&[p], &[true], None, None, Bins::EqualWidth(1), Confidence::P95);
            assert!(matches!(found, Err(CalibrationError::NotAProbability { row: 0, .. })));
        }
        let none = calibration(&[], &[], None, None, Bins::EqualWidth(1), Confidence::P95);
        assert_eq!(none, Err(CalibrationError::NoRows));
    }
}
