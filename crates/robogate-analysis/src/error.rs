//! Errors of an analysis.

use std::path::{Path, PathBuf};

use robogate_dictionary::DictionaryError;

/// Why there is no analysis.
#[derive(Debug, thiserror::Error)]
pub enum AnalysisError {
    /// The dictionary cannot be read.
    #[error(transparent)]
    Dictionary(#[from] DictionaryError),
    /// Not a dictionary in any supported form.
    #[error(
        "{}: {reason}\nhint: expected a run's folder, a dictionary (Parquet) or a published JSON dictionary",
        path.display()
    )]
    NotADictionary {
        /// The path as given.
        path: PathBuf,
        /// What is wrong with it.
        reason: String,
    },
    /// A folder without a finished run.
    #[error(
        "{}: the folder has no dictionary.parquet\nhint: resume an interrupted run with `robogate resume {0}`",
        path.display()
    )]
    NoDictionaryInFolder {
        /// The folder.
        path: PathBuf,
    },
    /// The system refused to read or write a file.
    #[error("cannot {action} {}: {source}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// The operation that failed.
        action: &'static str,
        /// The system's error.
        source: std::io::Error,
    },
    /// Dictionaries that do not form a study.
    #[error("these dictionaries do not form a study: {reason}")]
    NoStudy {
        /// What does not match.
        reason: String,
    },
    /// A pair of parameters that cannot be mapped.
    #[error("`{name}` is not a valid parameter of a pair: {reason}\nhint: expected two of {known}")]
    Pair {
        /// The name as given.
        name: String,
        /// What is wrong with it.
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
