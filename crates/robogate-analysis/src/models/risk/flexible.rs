//! The model that predicts: calibrated, without an assumption about the shape of the effects.

use robogate_stats::Confidence;
use robogate_stats::boosting::Monotone;
use robogate_stats::flexible::{Calibrated, Flexible, Learner, Scorer, Training};
use robogate_stats::parallel::all_processors;
use robogate_stats::roc::{RocError, cross_validate, stratified_folds};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::calibration::{CalibrationFigures, calibrated};
use super::{FOLDS, fewest};
use crate::Finding;
use crate::rate::ends;
use crate::table::{ParameterColumn, ParameterKind};

/// Rows of the fit. Of more, every n-th is used.
const MOST_ROWS: usize = 20_000;
/// Fewest rows of the rarer outcome, or scenarios with it.
const FEWEST: usize = 10;
/// Most columns, which count each category: those that a monitor reads.
const MOST_COLUMNS: usize = 256;

/// A calibrated model of P(success): the mean of gradient boosting and of a logistic model on splines and products, chosen by
/// cross-validation.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Predictor {
    /// Rows that it was fitted to.
    pub rows: u64,
    /// Share of the boosting in the mean of the log-odds; the rest is the spline model.
    pub boosting_share: f64,
    /// Whether a monotone curve calibrates it, otherwise a line.
    pub calibrated_by_curve: bool,
    /// Mean AUC over five held-out folds. `None` if no fold has both outcomes.
    pub auc_cross_validated: Option<f64>,
    /// Its 95 % interval.
    pub auc_cross_validated_95: [f64; 2],
    /// Calibration on held-out rows.
    pub calibration_cross_validated: Finding<CalibrationFigures>,
    /// The columns of a row, in the order of the model.
    #[serde(skip)]
    pub columns: Vec<PredictorColumn>,
    /// The model. `None` if it was read from a file.
    #[serde(skip)]
    pub model: Option<Scorer>,
}

/// A column of a row.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct PredictorColumn {
    /// The parameter.
    pub parameter: String,
    /// The category whose presence is 1. `None` for the value of a number.
    pub category: Option<String>,
}

/// Fits the model and predicts P(failure) for each row: by a model that was not fitted to it.
pub(super) fn predictor(
    parameters: &[ParameterColumn],
    failed: &[bool],
    weights: Option<&[f64]>,
    scenarios: Option<&[usize]>,
) -> Finding<(Predictor, Vec<f64>)> {
    let step = failed.len().div_ceil(MOST_ROWS).max(1);
    let rows: Vec<usize> = (0..failed.len()).step_by(step).collect();
    let success: Vec<bool> = rows.iter().map(|row| !failed[*row]).collect();
    let of_scenario = scenarios.map(|of| rows.iter().map(|row| of[*row]).collect::<Vec<usize>>());
    let rarer = fewest(&success, of_scenario.as_deref());
    if rarer < FEWEST {
        let units = if of_scenario.is_some() { "clusters" } else { "episodes" };
        return Finding::not(format!("the rarer outcome has {rarer} {units}, fewer than {FEWEST}"));
    }
    let columns: Vec<PredictorColumn> = parameters.iter().flat_map(columns).collect();
    if columns.len() > MOST_COLUMNS {
        let n = columns.len();
        return Finding::not(format!("the parameters have {n} numbers and categories, more than {MOST_COLUMNS}"));
    }
    let values: Vec<Vec<f64>> = parameters
        .iter()
        .flat_map(|parameter| coded(parameter, rows.iter().map(|row| parameter.values[*row])))
        .collect();
    let numbers: Vec<usize> = (0..columns.len()).filter(|at| columns[*at].category.is_none()).collect();
    let training = Training {
        columns: &values,
        outcomes: &success,
        constraints: &vec![Monotone::Free; columns.len()],
        interacting: &numbers,
    };
    let folds = stratified_folds(&success, of_scenario.as_deref(), FOLDS, 0);
    let how = (Learner::Chosen, Calibrated::LineOrCurve);
    let model = match Flexible::fit(training, &folds, how, all_processors()) {
        Ok(model) => model,
        Err(error) => return Finding::not(error.to_string()),
    };
    let failure = |log_odds: f64| 1.0 / (1.0 + log_odds.exp());
    let held_out: Vec<f64> = model.held_out().iter().map(|log_odds| failure(*log_odds)).collect();
    let failures: Vec<bool> = success.iter().map(|success| !success).collect();
    let crossed = cross_validate::<RocError>(&failures, of_scenario.as_deref(), &folds, Confidence::P95, |_, test| {
        Ok(test.iter().map(|row| held_out[*row]).collect())
    });
    let of_rows = weights.map(|of| rows.iter().map(|row| of[*row]).collect::<Vec<f64>>());
    let choice = model.choice();
    let predictor = Predictor {
        rows: rows.len() as u64,
        boosting_share: choice.boosting_share,
        calibrated_by_curve: choice.curve,
        auc_cross_validated: crossed.as_ref().ok().map(|crossed| crossed.auc),
        auc_cross_validated_95: crossed.map_or([0.0, 1.0], |crossed| ends(crossed.interval)),
        calibration_cross_validated: calibrated(&held_out, &failures, of_rows.as_deref(), of_scenario.as_deref()),
        columns,
        model: Some(model.scorer().clone()),
    };
    // The rows between those of the fit are not fitted either.
    let mut p = vec![0.0; failed.len()];
    let coded: Vec<Vec<f64>> = match step {
        1 => values,
        _ => parameters.iter().flat_map(|parameter| coded(parameter, parameter.values.iter().copied())).collect(),
    };
    let mut row = vec![0.0; coded.len()];
    for (at, p) in p.iter_mut().enumerate() {
        *p = match at % step {
            0 => held_out[at / step],
            _ => {
                row.iter_mut().zip(&coded).for_each(|(value, column)| *value = column[at]);
                failure(model.log_odds(&row))
            }
        };
    }
    Finding::Estimated((predictor, p))
}

fn columns(parameter: &ParameterColumn) -> Vec<PredictorColumn> {
    let of = |category| PredictorColumn { parameter: parameter.name.clone(), category };
    match &parameter.kind {
        ParameterKind::Categorical { levels } => levels.iter().map(|level| of(Some(level.clone()))).collect(),
        _ => vec![of(None)],
    }
}

fn coded(parameter: &ParameterColumn, values: impl Iterator<Item = f64> + Clone) -> Vec<Vec<f64>> {
    match &parameter.kind {
        ParameterKind::Categorical { levels } => (0..levels.len())
            .map(|level| values.clone().map(|v| f64::from(u8::from(v as usize == level))).collect())
            .collect(),
        _ => vec![values.collect()],
    }
}
