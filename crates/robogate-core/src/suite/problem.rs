//! Errors in a suite file.

use std::fmt;

/// The reason why a suite is invalid.
#[derive(Debug, Clone, PartialEq)]
pub enum SuiteError {
    /// Invalid TOML or an invalid structure. The text has line, column and key.
    Syntax(String),
    /// The file can be read, but its content is invalid. Lists all problems, at least one.
    Problems(Vec<SuiteProblem>),
    /// Nominal twins of scenarios without a parameter that has a nominal value.
    NoNominal {
        /// The task.
        task: String,
    },
}

impl std::error::Error for SuiteError {}

impl fmt::Display for SuiteError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Syntax(text) => f.write_str(text),
            Self::NoNominal { task } => write!(
                f,
                "the task {task} declares a nominal value for none of these parameters, so the scenarios have no nominal \
                 twins\nHint: declare `nominal` for the parameters in the task of the environment"
            ),
            Self::Problems(problems) => {
                for (i, problem) in problems.iter().enumerate() {
                    if i > 0 {
                        f.write_str("\n")?;
                    }
                    problem.fmt(f)?;
                }
                Ok(())
            }
        }
    }
}

/// One problem in a suite.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum SuiteProblem {
    /// An unsupported version of the file format.
    #[error("schema = {found} is not supported: this version of robogate reads schema {known}")]
    Schema {
        /// The version in the file.
        found: u32,
        /// The supported version.
        known: u32,
    },
    /// A name that is missing or invalid.
    #[error("{what} is {text:?}; expected letters, digits, `_`, `-` and `.`")]
    Word {
        /// What the name belongs to.
        what: String,
        /// The text in the file.
        text: String,
    },
    /// A published success rate that is not a fraction.
    #[error("the published success rate of {policy} is {success}; expected a fraction from 0 to 1")]
    Published {
        /// The policy.
        policy: String,
        /// The rate in the file.
        success: f64,
    },
    /// The suite has no scenario.
    #[error("the suite has no scenario; expected at least one")]
    Empty,
    /// A group without a scenario.
    #[error("group `{group}` has no scenario")]
    EmptyGroup {
        /// The group.
        group: String,
    },
    /// A group that is listed twice in its category.
    #[error("group `{group}` of category `{category}` is defined twice")]
    DuplicateGroup {
        /// The group.
        group: String,
        /// The category.
        category: String,
    },
    /// Two scenarios with the same id.
    #[error("scenario id `{id}` is used twice")]
    DuplicateId {
        /// The id.
        id: String,
    },
    /// A parameter that is set in one scenario and missing in another.
    #[error(
        "scenario `{case}` has no `{parameter}`, but other scenarios do: set it in the scenario, or in the defaults of its group or of the suite"
    )]
    Missing {
        /// The scenario.
        case: String,
        /// The parameter.
        parameter: String,
    },
    /// A parameter that is a number in one scenario and a word in another.
    #[error("`{parameter}` is a {one} in scenario `{first}` and a {other} in `{case}`")]
    Mixed {
        /// The parameter.
        parameter: String,
        /// The kind in the first scenario.
        one: &'static str,
        /// The first scenario.
        first: String,
        /// The kind in the other scenario.
        other: &'static str,
        /// The other scenario.
        case: String,
    },
    /// An invalid value or range.
    #[error("{place}: {error}")]
    Value {
        /// Where the value is: defaults or a scenario.
        place: String,
        /// The problem.
        error: crate::SpaceError,
    },
    /// A parameter that should be constant differs between scenarios or is sampled.
    #[error(
        "`{parameter}` varies over the scenarios of the suite: a parameter belongs either to the scenarios or to the unit"
    )]
    Varies {
        /// The parameter.
        parameter: String,
    },
    /// The parameters do not form a valid space.
    #[error(transparent)]
    Space(crate::SpaceError),
}
