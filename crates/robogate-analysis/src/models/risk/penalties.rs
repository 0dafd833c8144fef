//! Penalties: numeric codes of categorical parameters.
//!
//! Source: Micci-Barreca (2001), SIGKDD Explorations 3(1).

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

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
    /// Its failure rate, shrunk towards the overall one.
    pub penalty: f64,
}

/// The penalties of all categorical parameters, computed from some of the rows.
pub(super) struct Coding(Vec<Option<Vec<f64>>>);

impl Coding {
    pub(super) fn learn(parameters: &[ParameterColumn], failed: &[bool], rows: &[usize]) -> Self {
        let overall = rows.iter().filter(|row| failed[**row]).count() as f64 / rows.len().max(1) as f64;
        let learn = |parameter: &ParameterColumn| match &parameter.kind {
            ParameterKind::Categorical { levels } => {
                let mut counts = vec![(0.0, 0.0); levels.len()];
                for row in rows {
                    let level = &mut counts[parameter.values[*row] as usize];
                    level.0 += f64::from(u8::from(failed[*row]));
                    level.1 += 1.0;
                }
                Some(counts.iter().map(|(f, n)| (f + PRIOR * overall) / (n + PRIOR)).collect())
            }
            ParameterKind::Continuous { .. } | ParameterKind::Integer { .. } => None,
        };
        Self(parameters.iter().map(learn).collect())
    }

    pub(super) fn columns(&self, parameters: &[ParameterColumn], rows: &[usize]) -> Vec<Vec<f64>> {
        let column = |(parameter, penalties): (&ParameterColumn, &Option<Vec<f64>>)| match penalties {
            Some(penalties) => rows.iter().map(|row| penalties[parameter.values[*row] as usize]).collect(),
            None => rows.iter().map(|row| parameter.values[*row]).collect(),
        };
        parameters.iter().zip(&self.0).map(column).collect()
    }

    pub(super) fn penalties(&self, parameters: &[ParameterColumn]) -> Vec<Penalty> {
        parameters
            .iter()
            .zip(&self.0)
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
