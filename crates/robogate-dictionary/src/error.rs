//! What can go wrong, and where.

use std::fmt;
use std::io;
use std::path::{Path, PathBuf};

use robogate_core::SpaceError;

use crate::{SCHEMA_VERSION, SchemaVersion};

/// A row of a table, counted from 0 as indices are.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Row(pub u64);

impl fmt::Display for Row {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "row {}", self.0)
    }
}

/// Why a record could not be written or read.
#[derive(Debug, thiserror::Error)]
pub enum DictionaryError {
    /// The operating system refused an operation.
    #[error("cannot {action} {}: {source}{}", path.display(), io_hint(source))]
    Io {
        /// The file.
        path: PathBuf,
        /// What was tried.
        action: &'static str,
        /// Its answer.
        source: io::Error,
    },
    /// The file is not a dictionary, or is truncated.
    #[error("{}: not a readable dictionary: {reason}", path.display())]
    NotADictionary {
        /// The file.
        path: PathBuf,
        /// What is wrong with it, with a hint.
        reason: String,
    },
    /// A part of a dictionary changed after it was written.
    #[error("{}: {place} is damaged: {reason}\nhint: restore the file from a backup, or run its campaign again", path.display())]
    Damaged {
        /// The file.
        path: PathBuf,
        /// Which rows or which part.
        place: String,
        /// What is wrong.
        reason: String,
    },
    /// Written by a later version of the tool.
    #[error("{}: schema version {found} is newer than {known}, the newest that this version of robogate reads\nhint: upgrade robogate; the file was not changed", path.display(), known = SCHEMA_VERSION)]
    NewerSchema {
        /// The file.
        path: PathBuf,
        /// Its version.
        found: SchemaVersion,
    },
    /// A parameter or measure has the name of another column.
    #[error("`{column}` is the name of another column of the dictionary\nhint: rename the parameter or measure")]
    ColumnClash {
        /// The name.
        column: String,
    },
    /// The requested column does not exist.
    #[error("{}: no column `{column}`. Expected one of {columns}", path.display())]
    NoSuchColumn {
        /// The file.
        path: PathBuf,
        /// The requested name.
        column: String,
        /// The names of all columns.
        columns: String,
    },
    /// A column holds another kind of value than was requested.
    #[error("{}: column `{column}` holds {found}. Expected {wanted}", path.display())]
    ColumnKind {
        /// The file.
        path: PathBuf,
        /// The column.
        column: String,
        /// What it holds.
        found: &'static str,
        /// What was requested.
        wanted: &'static str,
    },
    /// A value that its column cannot hold, or that contradicts another.
    #[error("{}: {row}, column `{column}`: {value} {reason}", path.display())]
    Value {
        /// The file.
        path: PathBuf,
        /// The row, counted from 0.
        row: Row,
        /// The column.
        column: String,
        /// The offending value.
        value: String,
        /// What is wrong with it, with a hint.
        reason: String,
    },
    /// A requested parameter that does not fit the space.
    #[error("episode {index}: parameter `{parameter}` {reason}")]
    Parameter {
        /// The episode's index.
        index: u64,
        /// The parameter.
        parameter: String,
        /// What is wrong with it.
        reason: String,
    },
    /// A weight that is negative or not finite.
    #[error("episode {index}: importance weight {weight} is out of range. Expected a finite number, 0 or more")]
    Weight {
        /// The episode's index.
        index: u64,
        /// The weight.
        weight: f64,
    },
    /// The seed of another episode.
    #[error("episode {index}: its seed is not the one that its campaign gives to this index")]
    ForeignSeed {
        /// The episode's index.
        index: u64,
    },
    /// Two episodes of different campaigns in one dictionary.
    #[error(
        "episode {index} belongs to a campaign with seed {found}. Expected seed {expected}, that of the dictionary"
    )]
    ForeignCampaign {
        /// The episode's index.
        index: u64,
        /// Its campaign's seed.
        found: u64,
        /// The dictionary's.
        expected: u64,
    },
    /// An index that does not rise.
    #[error("episode {index} follows episode {previous}. Expected each index once, in rising order")]
    Order {
        /// The episode's index.
        index: u64,
        /// The one before it.
        previous: u64,
    },
    /// The file is not a journal that can be read.
    #[error("{}: not a readable journal: {reason}", path.display())]
    NotAJournal {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        reason: String,
    },
    /// A record before the journal's end changed after it was written.
    #[error("{}: the record at byte {offset} is damaged: {reason}\nhint: to keep the {intact} episodes before it and run the others again, truncate the file there (truncate -s {offset})", path.display())]
    DamagedJournal {
        /// The file.
        path: PathBuf,
        /// Where the record begins, in bytes from the file's start.
        offset: u64,
        /// How many records before it are intact.
        intact: u64,
        /// What is wrong.
        reason: String,
    },
    /// The journal already holds this episode.
    #[error("{} already holds episode {index}", path.display())]
    Duplicate {
        /// The journal.
        path: PathBuf,
        /// The episode's index.
        index: u64,
    },
    /// Another process writes to the journal.
    #[error("{} is in use by another process\nhint: only one process at a time can run or resume a campaign", path.display())]
    Locked {
        /// The journal.
        path: PathBuf,
    },
    /// An earlier write failed and could not be undone.
    #[error("{}: no more episodes can be recorded after a failed write\nhint: free disk space, then resume the campaign", path.display())]
    Broken {
        /// The journal.
        path: PathBuf,
    },
    /// The file is not valid JSON, or not of the published form.
    #[error("{}: {source}", path.display())]
    Json {
        /// The file.
        path: PathBuf,
        /// What and where (line and column).
        source: serde_json::Error,
    },
    /// The totals of a published file contradict its rows.
    #[error("{}: {reason}", path.display())]
    Published {
        /// The file.
        path: PathBuf,
        /// What contradicts what.
        reason: String,
    },
    /// Results of another tool that cannot be imported.
    #[error("{} cannot be imported: {reason}", path.display())]
    Results {
        /// The file.
        path: PathBuf,
        /// What is wrong and where, with a hint.
        reason: String,
    },
    /// A mapping of columns that is not valid.
    #[error("{origin}: {reason}")]
    Mapping {
        /// The mapping file, or the option.
        origin: String,
        /// What is wrong and where, with a hint.
        reason: String,
    },
    /// The parameter space is not valid.
    #[error(transparent)]
    Space(#[from] SpaceError),
}

impl DictionaryError {
    pub(crate) fn io(path: &Path, action: &'static str) -> impl FnOnce(io::Error) -> Self {
        move |source| Self::Io { path: path.to_owned(), action, source }
    }

    pub(crate) fn json(path: &Path, source: serde_json::Error) -> Self {
        match source.io_error_kind() {
            // An error of the meter keeps its text.
            Some(io::ErrorKind::InvalidData) => {
                Self::Results { path: path.to_owned(), reason: io::Error::from(source).to_string() }
            }
            Some(kind) => Self::io(path, "read")(kind.into()),
            // Python's json module writes NaN for a missing number; other readers of JSON do not accept it.
            None if source.to_string().starts_with("expected value") => Self::Results {
                path: path.to_owned(),
                reason: format!("{source}\nhint: JSON has no NaN or Infinity; write null in their place"),
            },
            None => Self::Json { path: path.to_owned(), source },
        }
    }

    pub(crate) fn results(path: &Path, reason: impl Into<String>) -> Self {
        Self::Results { path: path.to_owned(), reason: reason.into() }
    }

    pub(crate) fn not_a_dictionary(path: &Path, reason: impl Into<String>) -> Self {
        Self::NotADictionary { path: path.to_owned(), reason: reason.into() }
    }
}

fn io_hint(source: &io::Error) -> &'static str {
    match source.kind() {
        io::ErrorKind::StorageFull | io::ErrorKind::QuotaExceeded => {
            "\nhint: free disk space, then try again; everything recorded before is intact"
        }
        io::ErrorKind::PermissionDenied | io::ErrorKind::ReadOnlyFilesystem => {
            "\nhint: choose a folder with write permission"
        }
        io::ErrorKind::NotFound => "\nhint: check the path",
        _ => "",
    }
}
