//! Why there is no comparison.

use std::path::PathBuf;

use crate::AnalysisError;

/// Why there is no comparison.
#[derive(Debug, thiserror::Error)]
pub enum ComparisonError {
    /// One of the dictionaries cannot be read.
    #[error(transparent)]
    Analysis(#[from] AnalysisError),
    /// Nothing to compare with.
    #[error(
        "a comparison needs at least two dictionaries (found {found})\nhint: `robogate analyze` looks at a single one"
    )]
    TooFew {
        /// How many there are.
        found: usize,
    },
    /// A dictionary beside itself.
    #[error("{} and {} hold the same rows\nhint: a dictionary compared with itself says nothing; name another one", first.display(), second.display())]
    SameTwice {
        /// The first path.
        first: PathBuf,
        /// The second path.
        second: PathBuf,
    },
    /// Not one name for each dictionary.
    #[error("{given} names for {dictionaries} dictionaries\nhint: give one name for each, in their order, or none")]
    Names {
        /// Names given.
        given: usize,
        /// Dictionaries given.
        dictionaries: usize,
    },
    /// Two dictionaries of one name.
    #[error("two dictionaries cannot both be named `{name}`")]
    NameTwice {
        /// The name.
        name: String,
    },
    /// A name that no dictionary has.
    #[error("there is no dictionary named `{name}`\nhint: the names are {known}")]
    NoSuchName {
        /// The name as given.
        name: String,
        /// The names there are.
        known: String,
    },
    /// A setting outside its range.
    #[error("{what} is {value}, but must be {must}")]
    Setting {
        /// The setting.
        what: &'static str,
        /// Its value.
        value: f64,
        /// What it must be.
        must: &'static str,
    },
    /// A pair of parameters that cannot be looked at together.
    #[error("`{name}` cannot be one of a pair: {reason}\nhint: the shared parameters are {known}")]
    Pair {
        /// The name as given.
        name: String,
        /// What is wrong with it.
        reason: String,
        /// The names there are.
        known: String,
    },
    /// Two dictionaries that did not run the same scenarios.
    #[error(
        "`{first}` and `{second}` did not run the same scenarios: {difference}\nhint: runs pair where plan, space and \
         --seed are the same; without --paired they are compared as independent"
    )]
    NotTheSameDesign {
        /// Name of the first.
        first: String,
        /// Name of the second.
        second: String,
        /// The first difference, with its row.
        difference: String,
    },
}
