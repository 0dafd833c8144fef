//! Whether what a suite asks for means something in this world.

use std::collections::BTreeMap;
use std::fmt;

use robogate_core::{Assignment, Parameter, ParameterSpace, Spread, Suite};
use robogate_physics::Gripper;

use super::{ParameterError, SceneParameters};

/// What one or more scenarios of a suite ask for and this world cannot be.
#[derive(Debug, Clone, PartialEq)]
pub struct SuiteMisfit {
    /// What is wrong.
    pub error: ParameterError,
    /// The scenarios in which it is.
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

/// Everything that this world cannot be, each mistake once with all scenarios that make it; nothing where every
/// parameter of every scenario means something here over its whole range, and to this gripper where one is given.
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
                    // A drawn parameter of a suite is one of a space: the suite was checked for that.
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
