//! The form of the risk model: coding of levels and scale of each number, chosen by cross-validation.

use std::collections::BTreeMap;

use robogate_stats::logistic::{Data, Options, fit};
use robogate_stats::roc::stratified_folds;

use super::fewest;
use super::penalties::Coding;
use crate::table::{ParameterColumn, ParameterKind};

/// Rows that choose the form.
const MOST_ROWS: usize = 20_000;
/// Folds.
const FOLDS: usize = 5;
/// Fewest rows of the rarer outcome for a choice, or scenarios with it.
const FEWEST: usize = 30;
/// Smallest ratio of the ends of a range for which a logarithm can matter.
const RATIO: f64 = 3.0;
/// Smallest improvement of the mean log loss, in standard errors of the difference.
const STANDARD_ERRORS: f64 = 2.0;

/// The form of a model.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Form {
    /// Whether a penalty is the log-odds of the failure rate of its level, otherwise the rate.
    pub(super) logit: bool,
    /// Whether the logarithm of each parameter enters the model.
    pub(super) log: Vec<bool>,
}

impl Form {
    /// The published form: rates and linear scales.
    pub(super) fn plain(parameters: &[ParameterColumn]) -> Self {
        Self { logit: false, log: vec![false; parameters.len()] }
    }

    /// The form with the smallest cross-validated log loss. One choice after the other replaces the plain form if its
    /// improvement is at least two standard errors. `scenarios` is the scenario of each row, if these have repeats: all rows
    /// of a scenario are then in one fold, and the standard errors are those of scenarios.
    pub(super) fn choose(
        parameters: &[ParameterColumn],
        failed: &[bool],
        weights: Option<&[f64]>,
        scenarios: Option<&[usize]>,
    ) -> Self {
        let mut form = Self::plain(parameters);
        let step = failed.len().div_ceil(MOST_ROWS).max(1);
        let rows: Vec<usize> = (0..failed.len()).step_by(step).collect();
        let outcomes: Vec<bool> = rows.iter().map(|row| failed[*row]).collect();
        let scenarios: Option<Vec<usize>> = scenarios.map(|of| rows.iter().map(|row| of[*row]).collect());
        if fewest(&outcomes, scenarios.as_deref()) < FEWEST {
            return form;
        }
        let folds = stratified_folds(&outcomes, scenarios.as_deref(), FOLDS, 0);
        let Some(mut best) = losses(parameters, (failed, weights), &rows, &folds, &form) else { return form };
        let mut offer = |candidate: Self, form: &mut Self| {
            let Some(found) = losses(parameters, (failed, weights), &rows, &folds, &candidate) else { return };
            let n = best.len() as f64;
            let gain: Vec<f64> = best.iter().zip(&found).map(|(a, b)| a - b).collect();
            let mean = gain.iter().sum::<f64>() / n;
            // The deviations of each scenario together, because they are not independent.
            let mut apart: BTreeMap<usize, f64> = BTreeMap::new();
            for (at, gain) in gain.iter().enumerate() {
                let scenario = scenarios.as_ref().map_or(at, |of| of[at]);
                *apart.entry(scenario).or_default() += gain - mean;
            }
            let variance = apart.values().map(|sum| sum.powi(2)).sum::<f64>() / n;
            if mean > STANDARD_ERRORS * (variance / n).sqrt() {
                *form = candidate;
                best = found;
            }
        };
        for (at, parameter) in parameters.iter().enumerate() {
            let ParameterKind::Continuous { low, high, .. } = parameter.kind else { continue };
            if low > 0.0 && high > RATIO * low && parameter.values.iter().all(|v| *v > 0.0) {
                let mut candidate = form.clone();
                candidate.log[at] = true;
                offer(candidate, &mut form);
            }
        }
        if parameters.iter().any(|parameter| !parameter.is_numeric()) {
            offer(Self { logit: true, ..form.clone() }, &mut form);
        }
        form
    }
}

/// The cross-validated log loss of each row. `None` if a fold cannot be fitted.
fn losses(
    parameters: &[ParameterColumn],
    (failed, weights): (&[bool], Option<&[f64]>),
    rows: &[usize],
    folds: &[usize],
    form: &Form,
) -> Option<Vec<f64>> {
    let mut losses = vec![0.0; rows.len()];
    for fold in 0..FOLDS {
        let of = |held: bool| -> Vec<usize> {
            rows.iter().zip(folds).filter(|(_, f)| (**f == fold) == held).map(|(row, _)| *row).collect()
        };
        let (train, test) = (of(false), of(true));
        let coding = Coding::learn(parameters, failed, weights, &train, form);
        let columns = coding.columns(parameters, &train);
        let slices: Vec<&[f64]> = columns.iter().map(Vec::as_slice).collect();
        let outcomes: Vec<bool> = train.iter().map(|row| failed[*row]).collect();
        let of_train: Option<Vec<f64>> = weights.map(|of| train.iter().map(|row| of[*row]).collect());
        let fitted = fit(Data::new(&slices, &outcomes, of_train.as_deref()).ok()?, Options::default()).ok()?;
        let columns = coding.columns(parameters, &test);
        let slices: Vec<&[f64]> = columns.iter().map(Vec::as_slice).collect();
        let p = fitted.probabilities(&slices)?;
        let places = (0..rows.len()).filter(|at| folds[*at] == fold);
        for ((at, row), p) in places.zip(&test).zip(p) {
            // A wrong prediction with certainty would decide alone.
            let of_outcome = if failed[*row] { p } else { 1.0 - p };
            losses[at] = -of_outcome.max(1e-6).ln() * weights.map_or(1.0, |of| of[*row]);
        }
    }
    Some(losses)
}
