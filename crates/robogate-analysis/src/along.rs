//! Success along each parameter: rates per bin or level, zones, correlation, critical threshold, failure modes.

use robogate_stats::binning::{Edges, per_bin, per_category};
use robogate_stats::correlation::{cramers_v, point_biserial, spearman};
use robogate_stats::modes::{self, Transitions};
use robogate_stats::threshold::{Direction, StaysAt, Threshold, ThresholdOptions, threshold};
use robogate_stats::zone::{self, ZoneLimits, zones};
use robogate_stats::{Confidence, Trials};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::rate::ends;
use crate::rate::{Finding, Rate};
use crate::rows::{ParameterColumn, ParameterKind, Rows, Sample};

/// Bins over the range of a continuous parameter, as in the paper.
pub(crate) const BINS: usize = 10;
/// Replicates of the bootstrap, as in the paper.
const REPLICATES: usize = 1_000;
/// An integer parameter with more levels than this is cut into bins.
const MOST_LEVELS: i64 = 30;

/// Success along one parameter. Every rate speaks of the population of the whole analysis.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Along {
    /// The parameter.
    pub parameter: String,
    /// Its name as people write it.
    pub label: String,
    /// Its unit; empty where it has none.
    pub unit: String,
    /// What it is.
    pub kind: AlongKind,
    /// Bins of equal width over its range (a continuous one), or its levels.
    pub cells: Vec<Cell>,
    /// Rows outside the range.
    pub outside: u64,
    /// How it goes together with success.
    pub correlation: Finding<Correlation>,
    /// Where the success rate crosses 50 %; of a number only.
    pub threshold: Finding<CriticalThreshold>,
    /// How the dominant failure mode changes along it; of a number only.
    pub transitions: Finding<ModeChanges>,
}

/// What a parameter is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum AlongKind {
    /// A real number, drawn evenly.
    Continuous,
    /// A real number, drawn evenly in its logarithm.
    ContinuousLog,
    /// A whole number.
    Integer,
    /// A word.
    Categorical,
}

/// One bin or level.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Cell {
    /// The bin or level as people read it.
    pub label: String,
    /// Edges of a bin; absent for a level.
    pub range: Option<[f64; 2]>,
    /// Its rate.
    pub rate: Rate,
    /// What may be said of it, the level shared over all cells of the parameter.
    pub zone: Zone,
}

/// What a cell's count allows to be said: safe from 70 %, danger to 30 %.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Zone {
    /// The whole interval is at or above 70 %.
    Safe,
    /// The whole interval is between.
    Boundary,
    /// The whole interval is at or below 30 %.
    Danger,
    /// Enough episodes for any zone, yet the interval reaches over a limit: the rate is near it.
    Undecided,
    /// Too few episodes: not even a rate of 50 % would surely lie between the limits.
    TooThin,
}

impl Zone {
    /// The zone in words.
    pub fn word(self) -> &'static str {
        match self {
            Self::Safe => "safe",
            Self::Boundary => "boundary",
            Self::Danger => "danger",
            Self::Undecided => "undecided",
            Self::TooThin => "too thin",
        }
    }

    /// The zone of each cell at 95 % shared over all of them.
    pub(crate) fn of(cells: &[Trials]) -> Vec<Self> {
        let level = Confidence::P95.shared_by(cells.len());
        // As many episodes, half of them successes.
        let halves: Vec<Trials> = cells.iter().map(|c| Trials::new(c.n() / 2, c.n()).unwrap_or(Trials::NONE)).collect();
        let zone = |(found, half)| match found {
            zone::Zone::Safe => Self::Safe,
            zone::Zone::Boundary => Self::Boundary,
            zone::Zone::Danger => Self::Danger,
            zone::Zone::TooThin { .. } if half == zone::Zone::Boundary => Self::Undecided,
            zone::Zone::TooThin { .. } => Self::TooThin,
        };
        let at_level = |cells: &[Trials]| zones(cells, ZoneLimits::PAPER, level);
        at_level(cells).into_iter().zip(at_level(&halves)).map(zone).collect()
    }

    /// Whether it is one of the three, and not left open.
    pub fn is_stated(self) -> bool {
        matches!(self, Self::Safe | Self::Boundary | Self::Danger)
    }
}

/// How a parameter goes together with success.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case", tag = "measure")]
pub enum Correlation {
    /// Of a number.
    Number {
        /// Point-biserial correlation: above 0, success is likelier at larger values.
        point_biserial: f64,
        /// 95 % interval by Fisher's transform.
        interval_95: [f64; 2],
        /// ln of its two-sided p-value; absent where it is not defined.
        ln_p: Option<f64>,
        /// Spearman's rank correlation; absent where it is not defined.
        spearman: Option<f64>,
    },
    /// Of a word: Cramer's V, without direction.
    Category {
        /// Cramer's V, from 0 to 1, less its bias under independence.
        cramers_v: f64,
        /// ln of the p-value of independence.
        ln_p: f64,
        /// Smallest expected count: below 5 the p-value is rough.
        smallest_expected: f64,
    },
}

impl Correlation {
    /// How strong it is, whatever its direction.
    pub fn strength(&self) -> f64 {
        match self {
            Self::Number { point_biserial, .. } => point_biserial.abs(),
            Self::Category { cramers_v, .. } => *cramers_v,
        }
    }
}

/// Where the success rate crosses 50 %: bins of equal count, isotonic regression, 1,000 bootstrap replicates.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case", tag = "finding")]
pub enum CriticalThreshold {
    /// It crosses once.
    Crosses {
        /// Where.
        at: f64,
        /// Whether success grows along the parameter.
        rising: bool,
        /// Lower end of the 95 % percentile interval; absent where it lies beyond the observed range.
        low: Option<f64>,
        /// Upper end; absent likewise.
        high: Option<f64>,
        /// Bootstrap standard error; absent where some replicates do not cross.
        se: Option<f64>,
        /// Share of replicates that cross.
        crossing_share: f64,
    },
    /// It crosses more than once, surely: no single threshold exists.
    CrossesMoreThanOnce {
        /// Ranges in each of which it crosses.
        between: Vec<[f64; 2]>,
    },
    /// It stays on one side.
    DoesNotCross {
        /// Whether it stays above 50 %.
        stays_above: bool,
        /// Share of replicates that do cross.
        crossing_share: f64,
    },
}

/// How the dominant failure mode changes along a parameter.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ModeChanges {
    /// Bins of about equal numbers of failures.
    pub bins: Vec<ModeBin>,
    /// Changes between bins whose dominant mode is sure.
    pub changes: Vec<ModeChange>,
}

/// Failures in one bin.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ModeBin {
    /// Edges of the bin.
    pub range: [f64; 2],
    /// Failures of each mode, in the order of the analysis' failure modes.
    pub counts: Vec<u64>,
    /// The most frequent mode; absent where nothing failed.
    pub dominant: Option<String>,
    /// Its share of the bin's failures.
    pub share: Option<f64>,
    /// Whether it is surely ahead of the second (exact sign test, Holm over the bins).
    pub sure: bool,
}

/// A change of the surely dominant mode.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ModeChange {
    /// Mode before.
    pub from: String,
    /// Mode after.
    pub to: String,
    /// Where: somewhere between these two values.
    pub between: [f64; 2],
}

pub(crate) fn along(rows: &Rows, base: &Sample, parameter: &ParameterColumn) -> Along {
    let (label, unit) = crate::labels::label_and_unit(&parameter.name);
    let (cells, outside) = cells(base, parameter);
    let kind = match &parameter.kind {
        ParameterKind::Continuous { log: false, .. } => AlongKind::Continuous,
        ParameterKind::Continuous { log: true, .. } => AlongKind::ContinuousLog,
        ParameterKind::Integer { .. } => AlongKind::Integer,
        ParameterKind::Categorical { .. } => AlongKind::Categorical,
    };
    Along {
        parameter: parameter.name.clone(),
        label,
        unit: unit.to_owned(),
        kind,
        cells,
        outside,
        correlation: correlation(base, parameter),
        threshold: critical(base, parameter),
        transitions: mode_changes(rows, base, parameter),
    }
}

fn cells(base: &Sample, parameter: &ParameterColumn) -> (Vec<Cell>, u64) {
    let binned = |edges: Edges| {
        let counted = per_bin(&parameter.values, &base.success, &edges);
        let (trials, outside) = counted.map_or_else(|_| (Vec::new(), 0), |c| (c.cells, c.outside as u64));
        let ranges = edges.as_slice().windows(2).map(|e| Some([e[0], e[1]]));
        let cells = ranges.zip(&trials).zip(Zone::of(&trials)).map(|((range, trials), zone)| Cell {
            label: range.map_or_else(String::new, robogate_stats::format::range),
            range,
            rate: Rate::of(*trials),
            zone,
        });
        (cells.collect(), outside)
    };
    match &parameter.kind {
        ParameterKind::Continuous { low, high, .. } => even_edges(*low, *high, BINS).map_or((Vec::new(), 0), binned),
        ParameterKind::Integer { low, high } => {
            let Some(edges) = level_edges(*low, *high) else {
                let edges = even_edges(*low as f64 - 0.5, *high as f64 + 0.5, BINS);
                return edges.map_or((Vec::new(), 0), binned);
            };
            let (mut cells, outside): (Vec<Cell>, u64) = binned(edges);
            for (cell, level) in cells.iter_mut().zip(*low..) {
                cell.label = level.to_string();
                cell.range = None;
            }
            (cells, outside)
        }
        ParameterKind::Categorical { words } => {
            let trials = per_category(&parameter.codes(), &base.success, words.len()).unwrap_or_default();
            let cells = words.iter().zip(&trials).zip(Zone::of(&trials));
            let cell = |((word, trials), zone): ((&String, &Trials), Zone)| Cell {
                label: word.clone(),
                range: None,
                rate: Rate::of(*trials),
                zone,
            };
            (cells.map(cell).collect(), 0)
        }
    }
}

/// One bin for each whole number; `None` where there are too many, or so large ones that halves are lost.
fn level_edges(low: i64, high: i64) -> Option<Edges> {
    let exact = low.unsigned_abs().max(high.unsigned_abs()) < 1 << 50;
    if !exact || high - low >= MOST_LEVELS {
        return None;
    }
    Edges::new((low..=high + 1).map(|level| level as f64 - 0.5).collect()).ok()
}

/// Bins of equal width over a range.
pub(crate) fn even_edges(low: f64, high: f64, bins: usize) -> Option<Edges> {
    Edges::equal_width(&[low, high], bins).ok()
}

fn correlation(base: &Sample, parameter: &ParameterColumn) -> Finding<Correlation> {
    if parameter.is_numeric() {
        match point_biserial(&parameter.values, &base.success, Confidence::P95) {
            Ok(found) => {
                let outcomes: Vec<f64> = base.success.iter().map(|s| f64::from(u8::from(*s))).collect();
                let ranks = spearman(&parameter.values, &outcomes, Confidence::P95).ok();
                Finding::Estimated(Correlation::Number {
                    point_biserial: found.r,
                    interval_95: ends(found.interval),
                    ln_p: found.ln_p.filter(|p| p.is_finite()),
                    spearman: ranks.map(|ranks| ranks.r),
                })
            }
            Err(_) => Finding::not(why_no_contrast(base, parameter)),
        }
    } else {
        let outcomes: Vec<usize> = base.success.iter().map(|s| usize::from(*s)).collect();
        match cramers_v(&parameter.codes(), &outcomes) {
            Ok(found) => Finding::Estimated(Correlation::Category {
                cramers_v: found.v_corrected,
                ln_p: found.ln_p.max(f64::MIN),
                smallest_expected: found.smallest_expected,
            }),
            Err(_) => Finding::not(why_no_contrast(base, parameter)),
        }
    }
}

/// Why success cannot be compared along a parameter.
pub(crate) fn why_no_contrast(base: &Sample, parameter: &ParameterColumn) -> String {
    let first = parameter.values.first().copied();
    if base.len() < 2 {
        format!("there {} only", if base.len() == 1 { "is 1 valid episode" } else { "are 0 valid episodes" })
    } else if base.success.iter().all(|s| *s) {
        "every episode succeeded".to_owned()
    } else if base.success.iter().all(|s| !*s) {
        "every episode failed".to_owned()
    } else if first.is_some_and(|first| parameter.values.iter().all(|v| (v - first).abs() <= 0.0)) {
        format!("{} has the same value in every episode", crate::labels::parameter_label(&parameter.name))
    } else {
        format!("{} episodes do not determine it", base.len())
    }
}

fn critical(base: &Sample, parameter: &ParameterColumn) -> Finding<CriticalThreshold> {
    if !parameter.is_numeric() {
        return Finding::not("a category has no order in which a rate could cross anything");
    }
    if base.len() < 20 {
        return Finding::not(format!(
            "{} too few for bins of any use",
            if base.len() == 1 {
                "1 valid episode is".to_owned()
            } else {
                format!("{} valid episodes are", base.len())
            }
        ));
    }
    // At least fifty rows to a bin, and never more bins than say something.
    let bins = (base.len() / 50).clamp(4, 20);
    let by_level = match &parameter.kind {
        ParameterKind::Integer { low, high } => level_edges(*low, *high),
        _ => None,
    };
    let edges = by_level.map_or_else(|| Edges::equal_count(&parameter.values, bins), Ok);
    let Ok(edges) = edges else {
        return Finding::not(why_no_contrast(base, parameter));
    };
    let options = ThresholdOptions { replicates: REPLICATES, ..ThresholdOptions::default() };
    match threshold(&parameter.values, &base.success, None, &edges, options) {
        Ok(found) => Finding::Estimated(match found.threshold {
            Threshold::Crosses { at, direction, low, high, se, crossing_share } => CriticalThreshold::Crosses {
                at,
                rising: direction == Direction::Rising,
                low: low.filter(|x| x.is_finite()),
                high: high.filter(|x| x.is_finite()),
                se: se.filter(|x| x.is_finite()),
                crossing_share,
            },
            Threshold::CrossesMoreThanOnce { between } => {
                CriticalThreshold::CrossesMoreThanOnce { between: between.into_iter().map(ends).collect() }
            }
            Threshold::DoesNotCross { stays, crossing_share } => {
                CriticalThreshold::DoesNotCross { stays_above: stays == StaysAt::Above, crossing_share }
            }
        }),
        Err(_) => Finding::not(why_no_contrast(base, parameter)),
    }
}

fn mode_changes(rows: &Rows, base: &Sample, parameter: &ParameterColumn) -> Finding<ModeChanges> {
    if !parameter.is_numeric() {
        return Finding::not("a category has no order along which anything could change");
    }
    let (failed, modes_of) = base.failures(rows);
    if failed.len() < 2 {
        return Finding::not(format!("{} failed", robogate_stats::format::counted(failed.len() as u64, "episode")));
    }
    let values: Vec<f64> = failed.iter().map(|i| parameter.values[*i]).collect();
    let by_level = match &parameter.kind {
        ParameterKind::Integer { low, high } => level_edges(*low, *high),
        _ => None,
    };
    let edges = by_level.map_or_else(|| Edges::equal_count(&values, (failed.len() / 30).clamp(2, BINS)), Ok);
    let word = |mode: usize| rows.mode(mode).to_owned();
    let found =
        edges.and_then(|edges| modes::transitions(&values, &modes_of, rows.modes.len(), &edges, Confidence::P95));
    match found {
        Ok(Transitions { bins, transitions, .. }) => Finding::Estimated(ModeChanges {
            bins: bins
                .into_iter()
                .map(|bin| ModeBin {
                    range: ends(bin.range),
                    dominant: bin.dominance.map(|d| word(d.mode)),
                    share: bin.dominance.map(|d| d.count as f64 / d.failures as f64),
                    sure: bin.sure,
                    counts: bin.counts,
                })
                .collect(),
            changes: transitions
                .into_iter()
                .map(|t| ModeChange { from: word(t.from), to: word(t.to), between: ends(t.between) })
                .collect(),
        }),
        Err(_) => Finding::not(format!(
            "{} has the same value in every failure",
            crate::labels::parameter_label(&parameter.name)
        )),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn many_episodes_near_a_limit_are_undecided_and_few_are_too_thin() {
        let of = |k, n| Trials::new(k, n).unwrap();
        let cells = [of(700, 1_000), of(7, 10), of(0, 0), of(950, 1_000), of(500, 1_000), of(50, 1_000)];
        let words: Vec<&str> = Zone::of(&cells).into_iter().map(Zone::word).collect();
        assert_eq!(words, ["undecided", "too thin", "too thin", "safe", "boundary", "danger"]);
    }
}
