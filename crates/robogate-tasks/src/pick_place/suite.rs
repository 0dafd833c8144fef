//! Checks a suite against the task's parameters.

use std::collections::BTreeMap;
use std::fmt;

use robogate_core::{Assignment, Parameter, ParameterSpace, Spread, Suite};
use robogate_physics::Gripper;

use super::{ParameterError, SceneParameters};

/// A parameter that the task does not accept, with the scenarios that use it.
#[derive(Debug, Clone, PartialEq)]
pub struct SuiteMisfit {
    /// The problem.
    pub error: ParameterError,
    /// The scenarios that have it.
    pub cases: Vec<String>,
}

impl fmt::Display for SuiteMisfit {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.cases.as_slice() {
            [one] => write!(f, "scenario `{one}`: {}", self.error),
            [first, rest @ ..] => write!(f, "scenario `{first}` and {} more: {}", rest.len(), self.error),
            [] => self.error.fmt(f),
        }
    }
}

/// All problems of a suite, each once with all affected scenarios. The list is empty if the task accepts every
/// parameter of every scenario over its whole range and all apply to this gripper.
pub fn check_suite(suite: &Suite, gripper: Option<&Gripper>) -> Vec<SuiteMisfit> {
    let mut found: BTreeMap<String, SuiteMisfit> = BTreeMap::new();
    for case in suite.cases() {
        for (name, spread) in &case.parameters {
            let checked = match spread {
                Spread::Fixed(value) => {
                    let one: Assignment = [(name.clone(), value.clone())].into_iter().collect();
                    SceneParameters::from_assignment(&one, gripper).map(drop)
                }
                Spread::Drawn(domain) => {
                    let parameter = Parameter { name: name.clone(), domain: domain.clone() };
                    // The suite has checked that a sampled parameter is valid in a space.
                    match ParameterSpace::new(suite.name(), vec![parameter]) {
                        Ok(space) => SceneParameters::check_space(&space, gripper),
                        Err(_) => Ok(()),
                    }
                }
            };
            if let Err(error) = checked {
                let misfit =
                    found.entry(format!("{name} {error}")).or_insert_with(|| SuiteMisfit { error, cases: Vec::new() });
                misfit.cases.push(case.id.clone());
            }
        }
    }
    found.into_values().collect()
}
