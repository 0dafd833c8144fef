//! Why there is no analysis.

use std::path::{Path, PathBuf};

use robogate_dictionary::DictionaryError;

/// Why there is no analysis.
#[derive(Debug, thiserror::Error)]
pub enum AnalysisError {
    /// The dictionary cannot be read.
    #[error(transparent)]
    Dictionary(#[from] DictionaryError),
    /// Not a dictionary of any form that is understood.
    #[error("{}: {reason}\nhint: give a run's folder, a dictionary (Parquet) or a published JSON dictionary", path.display())]
    NotADictionary {
        /// The path as given.
        path: PathBuf,
        /// What is wrong with it.
        reason: String,
    },
    /// A folder that holds no finished run.
    #[error("{}: no dictionary.parquet in this folder\nhint: a run that is not finished goes on with `robogate resume {0}`", path.display())]
    NoDictionaryInFolder {
        /// The folder.
        path: PathBuf,
    },
    /// The system refused a file.
    #[error("cannot {action} {}: {source}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// What was tried.
        action: &'static str,
        /// What the system said.
        source: std::io::Error,
    },
    /// Dictionaries that do not make one experiment.
    #[error("these dictionaries make no study: {reason}")]
    NoStudy {
        /// What does not fit.
        reason: String,
    },
    /// A pair of parameters that cannot be mapped.
    #[error("`{name}` cannot be one of a pair: {reason}\nhint: the parameters are {known}")]
    Pair {
        /// The name as given.
        name: String,
        /// What is wrong with it.
        reason: &'static str,
        /// The names there are.
        known: String,
    },
}

impl AnalysisError {
    pub(crate) fn io(path: &Path, action: &'static str) -> impl FnOnce(std::io::Error) -> Self {
        let path = path.to_owned();
        move |source| Self::Io { path, action, source }
    }
}
