//! Errors of an analysis.

use std::path::{Path, PathBuf};

use robogate_dictionary::DictionaryError;

/// An error that prevents an analysis.
#[derive(Debug, thiserror::Error)]
pub enum AnalysisError {
    /// A dictionary that cannot be read.
    #[error(transparent)]
    Dictionary(#[from] DictionaryError),
    /// A file that is not a dictionary in any supported format.
    #[error(
        "{}: {reason}\nHint: expected a run's folder, a dictionary (Parquet) or a published JSON dictionary",
        path.display()
    )]
    NotADictionary {
        /// The path as given.
        path: PathBuf,
        /// The problem.
        reason: String,
    },
    /// A folder without a finished run.
    #[error(
        "{}: the folder has no dictionary.parquet\nHint: resume an interrupted run with `robogate resume {0}`",
        path.display()
    )]
    NoDictionaryInFolder {
        /// The folder.
        path: PathBuf,
    },
    /// An error of the operating system.
    #[error("cannot {action} {}: {source}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// The operation that failed.
        action: &'static str,
        /// The error.
        source: std::io::Error,
    },
    /// A file of real trials or settings that cannot be used.
    #[error("{}:{line}: {reason}", path.display())]
    Trials {
        /// The file.
        path: PathBuf,
        /// The line, from 1.
        line: u64,
        /// The problem.
        reason: String,
    },
    /// Trials and a simulation from which nothing can be concluded together.
    #[error("no transfer from this simulation: {reason}")]
    NoTransfer {
        /// The reason.
        reason: String,
    },
    /// A learner cannot predict the rows of another dictionary.
    #[error("{}: no predictions: {reason}", path.display())]
    NoPrediction {
        /// The dictionary that the learner is fitted to.
        path: PathBuf,
        /// The reason.
        reason: String,
    },
    /// A target rate out of range.
    #[error("the target rate {found} is out of range. Expected a number between 0 and 1, for example 0.9")]
    TargetRate {
        /// The rate as given.
        found: f64,
    },
    /// A column of groups that does not exist.
    #[error("--groups: unknown column `{name}`. Expected one of {}", known.join(", "))]
    Groups {
        /// The name as given.
        name: String,
        /// The names of the columns.
        known: Vec<String>,
    },
    /// A pair of parameters that cannot be mapped.
    #[error("`{name}` is not a valid parameter of a pair: {reason}\nHint: expected two of {known}")]
    Pair {
        /// The name as given.
        name: String,
        /// The problem.
        reason: &'static str,
        /// The names of the parameters.
        known: String,
    },
}

impl AnalysisError {
    pub(crate) fn io(path: &Path, action: &'static str) -> impl FnOnce(std::io::Error) -> Self {
        let path = path.to_owned();
        move |source| Self::Io { path, action, source }
    }
}
