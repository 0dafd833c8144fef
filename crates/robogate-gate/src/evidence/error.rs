//! What can be wrong with keys and evidence.

use std::fmt;
use std::io;
use std::path::{Path, PathBuf};

use robogate_dictionary::DictionaryError;

use crate::GateError;

/// Why evidence or a key could not be written or read.
#[derive(Debug, thiserror::Error)]
pub enum EvidenceError {
    /// The operating system refused.
    #[error("cannot {action} {}: {source}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// What was tried.
        action: &'static str,
        /// What it answered.
        source: io::Error,
    },
    /// There is something already.
    #[error("{} is there already\nhint: {hint}", path.display())]
    Exists {
        /// The path.
        path: PathBuf,
        /// What to do.
        hint: &'static str,
    },
    /// A private key that others can read.
    #[error("{} can be read by others (mode {mode:03o}): a key that others may know signs nothing\nhint: chmod 600 {}, or make a new one if it was exposed", path.display(), path.display())]
    KeyMode {
        /// The key's file.
        path: PathBuf,
        /// Its permission bits.
        mode: u32,
    },
    /// Not a key.
    #[error("{} is no {what}: {reason}", path.display())]
    NotAKey {
        /// The file.
        path: PathBuf,
        /// What was expected.
        what: &'static str,
        /// What is wrong, with a hint.
        reason: String,
    },
    /// No randomness for a new key.
    #[error("the operating system gave no random numbers for a key: {0}")]
    Random(String),
    /// A name in the folder that no file can have.
    #[error(
        "`{0}` is no name for a file of the evidence\nhint: letters, digits, dot, dash, underscore and single slashes"
    )]
    Name(String),
    /// Two files in one place.
    #[error("two files would stand at `{0}` in the evidence")]
    Twice(String),
    /// A file beside the rows is not the one that they come from.
    #[error(
        "{0}\nhint: evidence holds the files that the rows were measured with; leave the file out or give the run's own"
    )]
    Contradicts(Problem),
    /// The gate cannot answer.
    #[error(transparent)]
    Gate(#[from] GateError),
    /// The rows cannot be read.
    #[error(transparent)]
    Dictionary(#[from] DictionaryError),
}

impl EvidenceError {
    pub(super) fn io(path: &Path, action: &'static str) -> impl FnOnce(io::Error) -> Self {
        move |source| Self::Io { path: path.to_owned(), action, source }
    }

    /// The error with the path that the user gave in place of the one where files stand until all are there.
    pub(super) fn at(self, partial: &Path, to: &Path) -> Self {
        match self {
            Self::Io { path, action, source } => {
                let path = path.strip_prefix(partial).map_or_else(|_| path.clone(), |name| to.join(name));
                Self::Io { path, action, source }
            }
            other => other,
        }
    }
}

/// One thing that is wrong with a folder of evidence.
#[derive(Debug, Clone, PartialEq, Eq, serde::Serialize)]
pub struct Problem {
    /// The file, as it is called in the folder.
    pub file: String,
    /// What is wrong with it.
    pub reason: String,
}

impl Problem {
    pub(super) fn new(file: impl Into<String>, reason: impl Into<String>) -> Self {
        Self { file: file.into(), reason: reason.into() }
    }
}

impl fmt::Display for Problem {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}: {}", self.file, self.reason)
    }
}
