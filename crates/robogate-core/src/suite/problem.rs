//! What can be wrong with a suite.

use std::fmt;

/// Why a suite is none.
#[derive(Debug, Clone, PartialEq)]
pub enum SuiteError {
    /// Not TOML, or not of the right form; the text has line, column and key.
    Syntax(String),
    /// It can be read and is wrong: everything that is, at least one.
    Problems(Vec<SuiteProblem>),
}

impl std::error::Error for SuiteError {}

impl fmt::Display for SuiteError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Syntax(text) => f.write_str(text),
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

/// One thing that is wrong in a suite.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum SuiteProblem {
    /// A form that this version does not know.
    #[error("schema = {found}, and this robogate reads schema {known}")]
    Schema {
        /// The file's.
        found: u32,
        /// Ours.
        known: u32,
    },
    /// A word that is missing or can be none.
    #[error("{what} is {text:?}; it must be made of letters, digits, `_`, `-` and `.`")]
    Word {
        /// Whose it is.
        what: String,
        /// What stands there.
        text: String,
    },
    /// No scenario at all.
    #[error("there is no scenario")]
    Empty,
    /// A group without a scenario.
    #[error("group `{group}` has no scenario")]
    EmptyGroup {
        /// The group.
        group: String,
    },
    /// A group twice in its category.
    #[error("group `{group}` of category `{category}` is there twice")]
    DuplicateGroup {
        /// The group.
        group: String,
        /// Its category.
        category: String,
    },
    /// Two scenarios of one id.
    #[error("scenario id `{id}` is there twice")]
    DuplicateId {
        /// The id.
        id: String,
    },
    /// A parameter that one scenario has and another has not.
    #[error(
        "scenario `{case}` has no `{parameter}`, which others have: give it there, or in the defaults of its group or of the suite"
    )]
    Missing {
        /// The scenario.
        case: String,
        /// The parameter.
        parameter: String,
    },
    /// A parameter that is a number here and a word there.
    #[error("`{parameter}` is a {one} in scenario `{first}` and a {other} in `{case}`")]
    Mixed {
        /// The parameter.
        parameter: String,
        /// What it is first.
        one: &'static str,
        /// Where.
        first: String,
        /// What it is then.
        other: &'static str,
        /// Where.
        case: String,
    },
    /// A value or range that is none.
    #[error("{place}: {error}")]
    Value {
        /// Whose defaults, or which scenario.
        place: String,
        /// What is wrong.
        error: crate::SpaceError,
    },
    /// The parameters make no space together.
    #[error(transparent)]
    Space(crate::SpaceError),
}
