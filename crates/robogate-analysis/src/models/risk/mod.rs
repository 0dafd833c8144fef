//! The risk model: P(failure) from all parameters. The paper's logistic model, with categorical parameters coded as penalties, is for
//! interpretation; [`Predictor`] predicts.
//!
//! The paper's model has this form but does not define the penalties. Here the penalty of a level is its failure rate,
//! shrunk towards the overall rate with the weight of ten episodes: (f + 10 p) / (n + 10), with f failures in n
//! episodes of the level and the overall rate p, from training rows only; or the log-odds of that rate. In
//! cross-validation, the penalties of each fold come from the other folds. Cross-validation also chooses between both
//! codings, and between a linear and a logarithmic scale of each number ([`form`]).
//!
//! If scenarios have several episodes, all episodes of a scenario are in one fold, so that a held-out episode is of a
//! scenario that the model has not seen. The intervals of AUC and calibration count scenarios.
//!
//! Limitation: in sample, the penalties are computed from the outcomes that they predict. The in-sample AUC is therefore
//! too high. The cross-validated figures have no such bias. The tests of the penalties are
//! likelihood-ratio tests of the levels ([`levels`]). If rows come in clusters, these count clusters or are left out.
//! Source for the coding: Micci-Barreca (2001), SIGKDD Explorations 3(1).

mod calibration;
mod flexible;
mod form;
mod levels;
mod penalties;
mod roc;
mod scoring;

use std::collections::BTreeSet;

use robogate_stats::Confidence;
use robogate_stats::clusters::Clusters;
use robogate_stats::logistic::{Data, Options, RegressionError, Scale, fit};
use robogate_stats::roc::{RocError, cross_validate, stratified_folds};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

pub use calibration::{CalibrationFigures, ReliabilityBin};
pub use flexible::{Predictor, PredictorColumn};
pub use penalties::{Penalty, PenaltyLevel};
pub use roc::{RocCurve, RocFigures};
pub use scoring::{Scoring, ScoringTerm};

use super::{Regression, why};
use crate::Finding;
use crate::labels::parameter_label;
use crate::table::{EpisodeTable, ParameterColumn, Sample};
use crate::task::TaskAnalysis;
use calibration::calibrated;
use form::Form;
use penalties::Coding;
use roc::roc_figures;

/// Number of folds of the cross-validation.
const FOLDS: usize = 5;

/// P(failure) from the parameters.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct RiskModel {
    /// Whether its features are those of the paper's model. Otherwise the same form is fitted to the dataset's
    /// parameters.
    pub paper_features: bool,
    /// The regression with coefficients per standard deviation. A positive one raises the probability of failure.
    pub regression: Regression,
    /// Whether a penalty is the log-odds of the failure rate of its level, otherwise the rate. Chosen by
    /// cross-validation.
    #[serde(default)]
    pub logit_penalties: bool,
    /// The parameters whose logarithm enters the model. Chosen by cross-validation.
    #[serde(default)]
    pub logarithmic: Vec<String>,
    /// The penalties of each categorical parameter, from all rows.
    pub penalties: Vec<Penalty>,
    /// The same model for scoring: coefficients per unit and their covariance.
    pub scoring: Scoring,
    /// Discrimination: how well it separates failures from successes.
    pub roc: Finding<RocFigures>,
    /// Calibration in sample.
    pub calibration_in_sample: Finding<CalibrationFigures>,
    /// Calibration on held-out rows.
    pub calibration_cross_validated: Finding<CalibrationFigures>,
    /// The calibrated model without an assumption about the shape of the effects. It gives the predictions for single episodes, and
    /// the risk in the reference of a monitor.
    pub predictor: Finding<Predictor>,
}

/// A predicted probability of failure for each row, from cross-validation if possible.
pub(crate) struct Scored {
    pub(crate) p: Vec<f64>,
    pub(crate) unseen: bool,
}

pub(crate) fn risk(table: &EpisodeTable, base: &Sample, task: &TaskAnalysis) -> Finding<(RiskModel, Scored)> {
    if base.parameters.is_empty() && base.len() > 0 {
        return Finding::not("the dataset has no parameter");
    }
    let failed: Vec<bool> = base.success.iter().map(|s| !s).collect();
    let of_row = base.clusters().map(Clusters::of_row);
    let weights = base.weights.as_deref();
    let form = Form::choose(&base.parameters, &failed, weights, of_row);
    let names: Vec<String> = base.parameters.iter().zip(&form.log).map(|(p, log)| feature(p, *log)).collect();
    let all: Vec<usize> = (0..base.len()).collect();
    let coding = Coding::learn(&base.parameters, &failed, weights, &all, &form);
    let columns = coding.columns(&base.parameters, &all);
    let slices: Vec<&[f64]> = columns.iter().map(Vec::as_slice).collect();
    let options = Options { scale: Scale::Standardized, ..Options::for_rows(weights.is_some()) };
    let whole = match Data::new(&slices, &failed, weights).and_then(|data| fit(data.clustered(of_row)?, options)) {
        Ok(whole) => whole,
        Err(error) => return Finding::not(why(&error, &names)),
    };
    let Some(p) = whole.probabilities(&slices) else {
        return Finding::not("the columns do not match the model");
    };
    let scoring = Scoring::of(&whole, &base.parameters, &slices, &form);
    let mut regression = Regression::of(&whole, "failure", &names, true);
    levels::replace_tests(&mut regression, base, &slices, &failed);
    drop(slices);
    drop(columns);
    let folds = stratified_folds(&failed, of_row, FOLDS, 0);
    let fewest = fewest(&failed, of_row);
    let crossed = if fewest < FOLDS {
        let units = if of_row.is_some() { "clusters" } else { "episodes" };
        Err(format!("the rarer outcome has {fewest} {units}, fewer than the {FOLDS} folds"))
    } else {
        cross_validate::<CrossValidationError>(&failed, of_row, &folds, Confidence::P95, |train, test| {
            let coding = Coding::learn(&base.parameters, &failed, weights, train, &form);
            let columns = coding.columns(&base.parameters, train);
            let slices: Vec<&[f64]> = columns.iter().map(Vec::as_slice).collect();
            let outcomes: Vec<bool> = train.iter().map(|row| failed[*row]).collect();
            let of_train: Option<Vec<f64>> = weights.map(|of| train.iter().map(|row| of[*row]).collect());
            let fitted = fit(Data::new(&slices, &outcomes, of_train.as_deref())?, Options::default())?;
            drop(slices);
            drop(columns);
            let columns = coding.columns(&base.parameters, test);
            let slices: Vec<&[f64]> = columns.iter().map(Vec::as_slice).collect();
            Ok(fitted.probabilities(&slices).unwrap_or_default())
        })
        .map_err(|error| match error {
            CrossValidationError::Fit(error) => why(&error, &names),
            CrossValidationError::Roc(error) => error.to_string(),
        })
    };
    let (predictor, predicted) = match flexible::predictor(&base.parameters, &failed, weights, of_row) {
        Finding::Estimated((predictor, p)) => (Finding::Estimated(predictor), Some(p)),
        Finding::CannotBeEstimated { because } => (Finding::CannotBeEstimated { because }, None),
    };
    // Ranks have no weights, so an AUC is that of the rows whose points were sampled from the operating space.
    let chosen = |at: usize| weights.is_some() && table.is_focused(base.rows[at] as usize);
    let sampled: Vec<usize> = (0..base.len()).filter(|at| !chosen(*at)).collect();
    let paper = task.risk_parameters;
    let model = RiskModel {
        paper_features: !paper.is_empty()
            && base.parameters.len() == paper.len()
            && paper.iter().all(|n| base.parameter(n).is_some()),
        regression,
        logit_penalties: form.logit,
        logarithmic: base
            .parameters
            .iter()
            .zip(&form.log)
            .filter(|(_, log)| **log)
            .map(|(p, _)| p.name.clone())
            .collect(),
        penalties: coding.penalties(&base.parameters),
        scoring,
        roc: roc_figures(&p, &failed, &sampled, of_row, crossed.as_ref().ok()),
        calibration_in_sample: calibrated(&p, &failed, weights, of_row),
        calibration_cross_validated: match &crossed {
            Ok(crossed) => calibrated(&crossed.scores, &failed, weights, of_row),
            Err(because) => Finding::not(because.clone()),
        },
        predictor,
    };
    let scored = match (predicted, crossed) {
        (Some(p), _) => Scored { p, unseen: true },
        (None, Ok(crossed)) => Scored { p: crossed.scores, unseen: true },
        (None, Err(_)) => Scored { p, unseen: false },
    };
    Finding::Estimated((model, scored))
}

/// The number of rows that have the rarer outcome, or of scenarios that have it in a row.
fn fewest(failed: &[bool], scenarios: Option<&[usize]>) -> usize {
    let with = |outcome: bool| {
        let rows = (0..failed.len()).filter(|row| failed[*row] == outcome);
        match scenarios {
            Some(of) => rows.map(|row| of[row]).collect::<BTreeSet<usize>>().len(),
            None => rows.count(),
        }
    };
    with(true).min(with(false))
}

/// The error of a cross-validation as text.
enum CrossValidationError {
    Fit(RegressionError),
    Roc(RocError),
}

impl From<RegressionError> for CrossValidationError {
    fn from(error: RegressionError) -> Self {
        Self::Fit(error)
    }
}

impl From<RocError> for CrossValidationError {
    fn from(error: RocError) -> Self {
        Self::Roc(error)
    }
}

fn feature(parameter: &ParameterColumn, log: bool) -> String {
    let plain = parameter_label(&parameter.name);
    match (parameter.is_numeric(), log) {
        (true, false) => plain,
        (true, true) => format!("log {plain}"),
        (false, _) => format!("{plain} penalty"),
    }
}
