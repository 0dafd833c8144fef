//! Errors of keys and evidence.

use std::fmt;
use std::io;
use std::path::{Path, PathBuf};

use robogate_dictionary::DictionaryError;

use crate::GateError;

/// An error in writing or reading evidence or a key.
#[derive(Debug, thiserror::Error)]
pub enum EvidenceError {
    /// An error of the operating system.
    #[error("cannot {action} {}: {source}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// The operation that failed.
        action: &'static str,
        /// The error.
        source: io::Error,
    },
    /// The path exists already.
    #[error("{} already exists\nHint: {hint}", path.display())]
    Exists {
        /// The path.
        path: PathBuf,
        /// How to resolve it.
        hint: &'static str,
    },
    /// A private key that other users can read.
    #[error("{} can be read by other users (mode {mode:03o}), so its signatures prove nothing\nHint: chmod 600 {}, or create a new key if it was exposed", path.display(), path.display())]
    KeyMode {
        /// The key's file.
        path: PathBuf,
        /// The permission bits of the file.
        mode: u32,
    },
    /// A file that is not a key.
    #[error("{}: not a {what}: {reason}", path.display())]
    NotAKey {
        /// The file.
        path: PathBuf,
        /// What was expected.
        what: &'static str,
        /// The problem, with a hint.
        reason: String,
    },
    /// No random numbers for a new key.
    #[error("the operating system returned no random numbers for the key: {0}")]
    Random(String),
    /// An invalid path in the folder.
    #[error(
        "`{0}` is not a valid path in the evidence. Expected letters, digits, dot, dash, underscore and single slashes"
    )]
    Name(String),
    /// Two files with the same path.
    #[error("two files have the path `{0}` in the evidence")]
    Twice(String),
    /// A file that does not belong to the rows.
    #[error("{0}\nHint: evidence must contain the files of the run. Remove this file, or use that of the run")]
    Contradicts(Problem),
    /// Another question than that of the gate, without the user's consent.
    #[error(
        "the {} differ from those that the run's gate was asked\nHint: leave out the options that change them, or add --reasked: verification then reports it in its first line", changed.join(", ")
    )]
    Reasked {
        /// The parts that differ.
        changed: Vec<String>,
    },
    /// An error of the gate.
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

    /// Replaces the path of the temporary folder in the error by the path that the user gave.
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

/// A problem in a folder of evidence.
#[derive(Debug, Clone, PartialEq, Eq, serde::Serialize)]
pub struct Problem {
    /// The path of the file in the folder.
    pub file: String,
    /// The problem.
    pub reason: String,
}

impl Problem {
    /// A problem in this file.
    pub fn new(file: impl Into<String>, reason: impl Into<String>) -> Self {
        Self { file: file.into(), reason: reason.into() }
    }
}

impl fmt::Display for Problem {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}: {}", self.file, self.reason)
    }
}
