//! The risk model for scoring: coefficients per unit and their covariance.

use robogate_stats::logistic::Fit;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::form::Form;
use crate::table::ParameterColumn;

/// A logistic model of P(failure) in the parameters' own units: p = 1 / (1 + exp(-(intercept + Σ coefficient · x))),
/// where x is the value of a numeric parameter, its logarithm, or the penalty of a categorical one.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Scoring {
    /// Log-odds of failure at x = 0.
    pub intercept: f64,
    /// The parameters that have a coefficient.
    pub terms: Vec<ScoringTerm>,
    /// Covariance of the intercept and the coefficients, row by row.
    pub covariance: Vec<f64>,
    /// The largest variance x' V x of the log-odds among the rows. Beyond it the model extrapolates.
    pub max_variance: f64,
}

/// One term of a scoring model.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ScoringTerm {
    /// The parameter. The penalties of a categorical one are in the `penalties` of the risk model.
    pub parameter: String,
    /// Log-odds per unit, per unit of penalty, or per unit of the logarithm.
    pub coefficient: f64,
    /// Whether the natural logarithm of the parameter enters the model.
    #[serde(default)]
    pub log: bool,
}

impl Scoring {
    pub(super) fn of(fit: &Fit, parameters: &[ParameterColumn], columns: &[&[f64]], form: &Form) -> Self {
        let raw = fit.raw_coefficients();
        let size = raw.len();
        // The intercept, then the columns that have a coefficient.
        let estimated = |i: &usize| *i == 0 || fit.terms.get(i - 1).is_some_and(|term| term.coefficient().is_some());
        let kept: Vec<usize> = (0..size).filter(estimated).collect();
        let at = |i: usize, j: usize| fit.raw_covariance()[i * size + j];
        let variance = |row: usize| {
            let x = |i: usize| if i == 0 { 1.0 } else { columns[i - 1][row] };
            kept.iter().map(|i| kept.iter().map(|j| x(*i) * x(*j) * at(*i, *j)).sum::<f64>()).sum::<f64>()
        };
        let rows = columns.first().map_or(0, |column| column.len());
        Self {
            intercept: raw[0],
            terms: kept[1..]
                .iter()
                .map(|i| ScoringTerm {
                    parameter: parameters[i - 1].name.clone(),
                    coefficient: raw[*i],
                    log: form.log[i - 1],
                })
                .collect(),
            covariance: kept.iter().flat_map(|i| kept.iter().map(move |j| at(*i, *j))).collect(),
            max_variance: (0..rows).map(variance).fold(0.0, f64::max),
        }
    }
}
