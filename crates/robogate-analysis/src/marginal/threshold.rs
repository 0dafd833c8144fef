//! The critical threshold of one parameter: where the success rate crosses 50 %.

use robogate_stats::binning::Edges;
use robogate_stats::threshold::{Direction, StaysAt, Threshold, ThresholdOptions, threshold};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::{integer_edges, no_contrast};
use crate::dependence::too_few;
use crate::rate::{Finding, ends};
use crate::table::{ParameterColumn, Sample};

/// Number of bootstrap replicates, as in the paper.
const REPLICATES: usize = 1_000;
/// Smallest number of valid episodes for a threshold.
const MIN_EPISODES: usize = 20;

/// Where the success rate crosses 50 %: bins of equal count, isotonic regression, 1,000 bootstrap replicates.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case", tag = "finding")]
pub enum CriticalThreshold {
    /// It crosses once.
    Crosses {
        /// The value at which it crosses.
        at: f64,
        /// Whether success rises with the parameter.
        rising: bool,
        /// Lower end of the 95 % percentile interval. `None` if it lies outside the observed range.
        low: Option<f64>,
        /// Upper end of the interval. `None` if it lies outside the observed range.
        high: Option<f64>,
        /// Bootstrap standard error. `None` if some replicates do not cross.
        se: Option<f64>,
        /// Share of the replicates that cross.
        crossing_share: f64,
    },
    /// It significantly crosses more than once, so there is no single threshold.
    CrossesMoreThanOnce {
        /// Ranges that each contain a crossing.
        between: Vec<[f64; 2]>,
    },
    /// It does not cross.
    DoesNotCross {
        /// Whether it stays above 50 %.
        stays_above: bool,
        /// Share of the replicates that cross.
        crossing_share: f64,
    },
}

pub(super) fn critical_threshold(base: &Sample, parameter: &ParameterColumn) -> Finding<CriticalThreshold> {
    if !parameter.is_numeric() {
        return Finding::not("a categorical parameter has no order");
    }
    if base.len() < MIN_EPISODES {
        let n = base.len();
        return Finding::not(format!("there are too few valid episodes ({n}; it needs at least {MIN_EPISODES})"));
    }
    if let Some(because) = base.clusters().and_then(|clusters| too_few(clusters.count())) {
        return Finding::not(because);
    }
    // At least fifty rows per bin, up to a maximum number of bins.
    let bins = (base.len() / 50).clamp(4, 20);
    let edges = integer_edges(parameter).map_or_else(|| Edges::equal_count(&parameter.values, bins), Ok);
    let Ok(edges) = edges else {
        return Finding::not(no_contrast(base, parameter));
    };
    let options = ThresholdOptions { replicates: REPLICATES, ..ThresholdOptions::default() };
    match threshold(&parameter.values, &base.success, base.weights.as_deref(), base.clusters(), &edges, options) {
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
        Err(_) => Finding::not(no_contrast(base, parameter)),
    }
}
