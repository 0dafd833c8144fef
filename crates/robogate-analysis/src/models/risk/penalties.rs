//! Penalties: numeric codes of categorical parameters.
//!
//! Source: Micci-Barreca (2001), SIGKDD Explorations 3(1).

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::form::Form;
use crate::table::{ParameterColumn, ParameterKind};

/// Weight, in episodes, of the overall failure rate in the penalty of a level.
const PRIOR: f64 = 10.0;

/// The penalties of one categorical parameter.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Penalty {
    /// The parameter.
    pub parameter: String,
    /// Its levels.
    pub levels: Vec<PenaltyLevel>,
}

/// The penalty of one level.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct PenaltyLevel {
    /// The level.
    pub level: String,
    /// Its failure rate, shrunk towards the overall one, or the log-odds of that rate: see the model's coding.
    pub penalty: f64,
}

/// The columns of a model: the penalties of all categorical parameters, computed from some of the rows, and the scales of
/// the numeric ones.
pub(super) struct Coding {
    penalties: Vec<Option<Vec<f64>>>,
    log: Vec<bool>,
}

impl Coding {
    /// `weights` are the sampling weights of all rows.
    pub(super) fn learn(
        parameters: &[ParameterColumn],
        failed: &[bool],
        weights: Option<&[f64]>,
        rows: &[usize],
        form: &Form,
    ) -> Self {
        let weight = |row: usize| weights.map_or(1.0, |weights| weights[row]);
        let of_failed = |row: &usize| if failed[*row] { weight(*row) } else { 0.0 };
        let all: f64 = rows.iter().map(|row| weight(*row)).sum();
        let overall = rows.iter().map(of_failed).sum::<f64>() / all.max(f64::MIN_POSITIVE);
        let learn = |parameter: &ParameterColumn| match &parameter.kind {
            ParameterKind::Categorical { levels } => {
                let mut counts = vec![(0.0, 0.0); levels.len()];
                for row in rows {
                    let level = &mut counts[parameter.values[*row] as usize];
                    level.0 += of_failed(row);
                    level.1 += weight(*row);
                }
                let rate = |(f, n): &(f64, f64)| (f + PRIOR * overall) / (n + PRIOR);
                // An overall rate of 0 or 1 has no log-odds; the fit then rejects the rows.
                let code = |p: f64| if form.logit && p > 0.0 && p < 1.0 { (p / (1.0 - p)).ln() } else { p };
                Some(counts.iter().map(|level| code(rate(level))).collect())
            }
            ParameterKind::Continuous { .. } | ParameterKind::Integer { .. } => None,
        };
        Self { penalties: parameters.iter().map(learn).collect(), log: form.log.clone() }
    }

    pub(super) fn columns(&self, parameters: &[ParameterColumn], rows: &[usize]) -> Vec<Vec<f64>> {
        let column = |((parameter, penalties), log): ((&ParameterColumn, &Option<Vec<f64>>), &bool)| match penalties {
            Some(penalties) => rows.iter().map(|row| penalties[parameter.values[*row] as usize]).collect(),
            None if *log => rows.iter().map(|row| parameter.values[*row].ln()).collect(),
            None => rows.iter().map(|row| parameter.values[*row]).collect(),
        };
        parameters.iter().zip(&self.penalties).zip(&self.log).map(column).collect()
    }

    pub(super) fn penalties(&self, parameters: &[ParameterColumn]) -> Vec<Penalty> {
        parameters
            .iter()
            .zip(&self.penalties)
            .filter_map(|(parameter, penalties)| {
                let ParameterKind::Categorical { levels } = &parameter.kind else { return None };
                let levels = levels.iter().zip(penalties.as_ref()?);
                Some(Penalty {
                    parameter: parameter.name.clone(),
                    levels: levels
                        .map(|(level, penalty)| PenaltyLevel { level: level.clone(), penalty: *penalty })
                        .collect(),
                })
            })
            .collect()
    }
}
