//! Discrimination of the risk model: AUC and ROC curves.

use robogate_stats::Confidence;
use robogate_stats::roc::{CrossValidated, RocPoint, auc, curve};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::Finding;
use crate::rate::ends;

/// Maximum number of points of a ROC curve.
const ROC_POINTS: usize = 120;

/// Discrimination of the predicted probabilities between failures and successes.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct RocFigures {
    /// AUC on the training rows, which is biased upwards.
    pub auc_in_sample: f64,
    /// DeLong's 95 % interval, or Obuchowski's if scenarios have several episodes.
    pub auc_in_sample_95: [f64; 2],
    /// Mean AUC over those of five held-out folds that have both outcomes. `None` without cross-validation.
    pub auc_cross_validated: Option<f64>,
    /// 95 % interval from the same variance in each fold.
    pub auc_cross_validated_95: [f64; 2],
    /// The ROC curves, thinned.
    pub curves: Vec<RocCurve>,
}

/// A ROC curve of failure detection.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct RocCurve {
    /// The rows that it is computed from: `in_sample` or `cross_validated`.
    pub rows: String,
    /// Points (false positive rate, true positive rate).
    pub points: Vec<[f64; 2]>,
}

/// The figures of the rows in `sampled`. `scenarios` is the scenario of each row, if these have repeats.
pub(super) fn roc_figures(
    p: &[f64],
    failed: &[bool],
    sampled: &[usize],
    scenarios: Option<&[usize]>,
    crossed: Option<&CrossValidated>,
) -> Finding<RocFigures> {
    let outcomes: Vec<bool> = sampled.iter().map(|row| failed[*row]).collect();
    let scenarios: Option<Vec<usize>> = scenarios.map(|of| sampled.iter().map(|row| of[*row]).collect());
    let kept = |scores: &[f64]| sampled.iter().map(|row| scores[*row]).collect::<Vec<f64>>();
    let found = match auc(&kept(p), &outcomes, scenarios.as_deref(), Confidence::P95) {
        Ok(found) => found,
        Err(error) => return Finding::not(error.to_string()),
    };
    let thinned = |rows: &str, scores: &[f64]| {
        let points = curve(&kept(scores), &outcomes).unwrap_or_default();
        RocCurve { rows: rows.to_owned(), points: thin(&points) }
    };
    let mut curves = vec![thinned("in_sample", p)];
    curves.extend(crossed.map(|crossed| thinned("cross_validated", &crossed.scores)));
    let held_out = crossed.and_then(|crossed| match sampled.len() == failed.len() {
        true => Some((crossed.auc, crossed.interval)),
        // The folds of a part of the rows are too small for an AUC of each.
        false => auc(&kept(&crossed.scores), &outcomes, scenarios.as_deref(), Confidence::P95)
            .ok()
            .map(|found| (found.auc, found.interval)),
    });
    Finding::Estimated(RocFigures {
        auc_in_sample: found.auc,
        auc_in_sample_95: ends(found.interval),
        auc_cross_validated: held_out.map(|(auc, _)| auc),
        auc_cross_validated_95: held_out.map_or([0.0, 1.0], |(_, interval)| ends(interval)),
        curves,
    })
}

/// At most [`ROC_POINTS`] points, evenly spaced along the curve, with both ends.
fn thin(points: &[RocPoint]) -> Vec<[f64; 2]> {
    let length = |point: &RocPoint| point.false_positive_rate + point.true_positive_rate;
    let mut kept: Vec<[f64; 2]> = Vec::new();
    let mut next = 0.0;
    for (i, point) in points.iter().enumerate() {
        if length(point) >= next || i + 1 == points.len() {
            kept.push([point.false_positive_rate, point.true_positive_rate]);
            next = length(point) + 2.0 / ROC_POINTS as f64;
        }
    }
    kept
}
