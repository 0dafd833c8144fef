//! Calibration of the risk model.

use robogate_stats::Confidence;
use robogate_stats::calibration::{Bins, Calibration, calibration};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::Finding;
use crate::rate::ends;

/// Agreement of predicted failure probabilities with observed rates.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct CalibrationFigures {
    /// Mean of (p - y)².
    pub brier: f64,
    /// The same for a model that always predicts the overall rate, as a reference.
    pub base_rate_brier: f64,
    /// Mean of -ln P(observed outcome). `None` if it is infinite.
    pub log_loss: Option<f64>,
    /// Expected calibration error over the bins.
    pub expected_calibration_error: f64,
    /// Ten bins with equal counts.
    pub bins: Vec<ReliabilityBin>,
}

/// One bin of a reliability diagram.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ReliabilityBin {
    /// Rows in it.
    pub rows: u64,
    /// Mean predicted probability of failure.
    pub predicted: f64,
    /// Observed failure rate.
    pub observed: f64,
    /// Its Wilson 95 % interval. Repeats of a scenario count by their design effect.
    pub interval_95: [f64; 2],
}

/// `scenarios` is the scenario of each row, if these have repeats.
pub(super) fn calibrated(
    p: &[f64],
    failed: &[bool],
    weights: Option<&[f64]>,
    scenarios: Option<&[usize]>,
) -> Finding<CalibrationFigures> {
    calibration(p, failed, weights, scenarios, Bins::EqualCount(10), Confidence::P95)
        .map(|found: Calibration| CalibrationFigures {
            brier: found.brier,
            base_rate_brier: found.brier_of_the_rate,
            log_loss: found.log_loss,
            expected_calibration_error: found.expected_error,
            bins: found
                .bins
                .iter()
                .map(|bin| ReliabilityBin {
                    rows: bin.rows as u64,
                    predicted: bin.stated,
                    observed: bin.observed,
                    interval_95: ends(bin.interval),
                })
                .collect(),
        })
        .into()
}
