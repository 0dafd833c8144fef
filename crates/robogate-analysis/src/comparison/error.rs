//! Errors of a comparison.

use std::path::PathBuf;

use crate::AnalysisError;

/// An error that prevents a comparison.
#[derive(Debug, thiserror::Error)]
pub enum ComparisonError {
    /// One of the dictionaries cannot be read.
    #[error(transparent)]
    Analysis(#[from] AnalysisError),
    /// Fewer than two dictionaries.
    #[error("expected at least two dictionaries, found {found}\nHint: analyze a single one with `robogate analyze`")]
    TooFew {
        /// The number of dictionaries.
        found: usize,
    },
    /// Two dictionaries with the same rows.
    #[error("{} and {} have the same rows\nHint: remove one of them", first.display(), second.display())]
    SameTwice {
        /// The first path.
        first: PathBuf,
        /// The second path.
        second: PathBuf,
    },
    /// The number of names differs from the number of dictionaries.
    #[error(
        "--names: found {given} names for {datasets} dictionaries\nHint: give one name for each in their order, or leave out --names"
    )]
    Names {
        /// Names given.
        given: usize,
        /// Dictionaries given.
        datasets: usize,
    },
    /// Two dictionaries with one name.
    #[error("--names: `{name}` is given twice. Expected a different name for each dictionary")]
    NameTwice {
        /// The name.
        name: String,
    },
    /// A name that no dictionary has.
    #[error("no dictionary is named `{name}`. Expected one of: {known}")]
    NoSuchName {
        /// The name as given.
        name: String,
        /// The names of the dictionaries.
        known: String,
    },
    /// A setting outside its range.
    #[error("{setting} is out of range: {value}. Expected {expected}")]
    Setting {
        /// The setting.
        setting: &'static str,
        /// Its value.
        value: f64,
        /// Its range.
        expected: &'static str,
    },
    /// A pair of parameters that cannot be compared together.
    #[error("`{name}` is not a valid parameter of a pair: {reason}\nHint: expected two of {known}")]
    Pair {
        /// The problem.
        name: String,
        /// What is wrong with it.
        reason: String,
        /// The names of the shared parameters.
        known: String,
    },
    /// Dictionaries of different tasks.
    #[error(
        "`{first}` ran the task {task} and `{second}` the task {other}\nHint: their success rates are of different things; compare runs of one task"
    )]
    DifferentTasks {
        /// Name of the first.
        first: String,
        /// Its task.
        task: String,
        /// Name of the second.
        second: String,
        /// Its task.
        other: String,
    },
    /// Dictionaries of different spaces.
    #[error(
        "`{first}` and `{second}` have different parameter spaces: {difference}\nHint: with --common only rows in the shared ranges are compared"
    )]
    DifferentSpaces {
        /// Name of the first.
        first: String,
        /// Name of the second.
        second: String,
        /// The differences.
        difference: String,
    },
    /// No rows in the shared part of the spaces.
    #[error("`{name}` has no valid row in the shared part of the spaces\nHint: compare runs whose spaces overlap")]
    NothingShared {
        /// The dataset.
        name: String,
    },
    /// Episodes that do not follow from their seeds.
    #[error(
        "the episodes of `{name}` make no pairs: {why}\nHint: let the reset of the environment set everything that varies from its seed; \
         without --paired they are compared as independent runs"
    )]
    NoPairs {
        /// The dataset.
        name: String,
        /// What does not repeat.
        why: String,
    },
    /// Two dictionaries that did not run the same scenarios.
    #[error(
        "`{first}` and `{second}` did not run the same scenarios: {difference}\nHint: pairs need runs with the same \
         plan, space and --seed; without --paired they are compared as independent runs"
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
