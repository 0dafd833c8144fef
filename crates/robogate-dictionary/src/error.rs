//! What can go wrong, and where.

use std::fmt;
use std::io;
use std::path::{Path, PathBuf};

use robogate_core::SpaceError;

use crate::{SCHEMA_VERSION, SchemaVersion};

/// Where in a table something is: a row counted from 0, as indices are.
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
    /// The operating system refused.
    #[error("cannot {action} {}: {source}{}", path.display(), io_hint(source))]
    Io {
        /// The file.
        path: PathBuf,
        /// What was tried.
        action: &'static str,
        /// What it answered.
        source: io::Error,
    },
    /// Not a dictionary, or no longer one.
    #[error("{} is not a readable dictionary: {reason}", path.display())]
    NotADictionary {
        /// The file.
        path: PathBuf,
        /// What is wrong with it, with a hint.
        reason: String,
    },
    /// A part of a dictionary does not hold what was written to it.
    #[error("{}: {place} is damaged: {reason}\nhint: restore the file from a copy, or write it again from the journal of its campaign", path.display())]
    Damaged {
        /// The file.
        path: PathBuf,
        /// Which rows or which part.
        place: String,
        /// What is wrong.
        reason: String,
    },
    /// Written by a later version of the tool.
    #[error("{} has schema version {found}, and this robogate reads {known} at most\nhint: upgrade robogate; nothing was changed", path.display(), known = SCHEMA_VERSION)]
    NewerSchema {
        /// The file.
        path: PathBuf,
        /// Its version.
        found: SchemaVersion,
    },
    /// A parameter or measure under the name of a column that means something else.
    #[error("`{column}` is the name of another column of the dictionary\nhint: rename the parameter or measure")]
    ColumnClash {
        /// The name.
        column: String,
    },
    /// No column of that name.
    #[error("{} has no column `{column}`\nhint: its columns are {columns}", path.display())]
    NoSuchColumn {
        /// The file.
        path: PathBuf,
        /// The name asked for.
        column: String,
        /// The names there are.
        columns: String,
    },
    /// A column holds something else than was asked for.
    #[error("{}: column `{column}` holds {found}, not {wanted}", path.display())]
    ColumnKind {
        /// The file.
        path: PathBuf,
        /// The column.
        column: String,
        /// What it holds.
        found: &'static str,
        /// What was asked for.
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
    /// A weight that is none.
    #[error("episode {index} has the importance weight {weight}\nhint: a weight is a finite number, 0 or more")]
    Weight {
        /// The episode's index.
        index: u64,
        /// The weight.
        weight: f64,
    },
    /// The seed of another episode.
    #[error("episode {index} does not carry its own seed\nhint: it must be that of its campaign at its index")]
    ForeignSeed {
        /// The episode's index.
        index: u64,
    },
    /// Two episodes of different campaigns in one dictionary.
    #[error("episode {index} is of the campaign with seed {found}, the dictionary of {expected}")]
    ForeignCampaign {
        /// The episode's index.
        index: u64,
        /// Its campaign's seed.
        found: u64,
        /// The dictionary's.
        expected: u64,
    },
    /// The same episode twice, or one before its turn.
    #[error("episode {index} follows episode {previous}\nhint: a dictionary holds each index once, in rising order")]
    Order {
        /// The episode's index.
        index: u64,
        /// The one before it.
        previous: u64,
    },
    /// Not a journal.
    #[error("{} is not a journal of episodes: {reason}", path.display())]
    NotAJournal {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        reason: String,
    },
    /// A record before the journal's end does not hold what was written to it.
    #[error("{}: the record at byte {offset} is damaged: {reason}\nhint: to keep the {intact} episodes before it and run the others again, cut the file there (truncate -s {offset})", path.display())]
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
    /// The journal holds that episode already.
    #[error("{} holds episode {index} already", path.display())]
    Duplicate {
        /// The journal.
        path: PathBuf,
        /// The episode's index.
        index: u64,
    },
    /// Another process writes to the journal.
    #[error("{} is in use by another process\nhint: a campaign is run or resumed by one process at a time", path.display())]
    Locked {
        /// The journal.
        path: PathBuf,
    },
    /// An earlier write failed and could not be undone.
    #[error("{}: no further episode can be recorded after a failed write\nhint: make room, then resume the campaign", path.display())]
    Broken {
        /// The journal.
        path: PathBuf,
    },
    /// Not JSON, or not of the published form.
    #[error("{}: {source}", path.display())]
    Json {
        /// The file.
        path: PathBuf,
        /// What and where (line and column).
        source: serde_json::Error,
    },
    /// A whole of a published file contradicts its rows.
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
    /// A mapping of columns that is none.
    #[error("{origin}: {reason}")]
    Mapping {
        /// The mapping file, or the option.
        origin: String,
        /// What is wrong and where, with a hint.
        reason: String,
    },
    /// The parameter space is none.
    #[error(transparent)]
    Space(#[from] SpaceError),
}

impl DictionaryError {
    pub(crate) fn io(path: &Path, action: &'static str) -> impl FnOnce(io::Error) -> Self {
        move |source| Self::Io { path: path.to_owned(), action, source }
    }

    pub(crate) fn json(path: &Path, source: serde_json::Error) -> Self {
        match source.io_error_kind() {
            // A refusal by our own meter keeps its words.
            Some(io::ErrorKind::InvalidData) => {
                Self::Results { path: path.to_owned(), reason: io::Error::from(source).to_string() }
            }
            Some(kind) => Self::io(path, "read")(kind.into()),
            // What Python's json module writes for a missing number, and no other JSON reader takes.
            None if source.to_string().starts_with("expected value") => Self::Results {
                path: path.to_owned(),
                reason: format!("{source}\nhint: JSON has no NaN or Infinity; write null where they stand"),
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
            "\nhint: make room on that disk, then go on; what was recorded before is intact"
        }
        io::ErrorKind::PermissionDenied | io::ErrorKind::ReadOnlyFilesystem => {
            "\nhint: choose a folder that you may write to"
        }
        io::ErrorKind::NotFound => "\nhint: check the path",
        _ => "",
    }
}
