//! Error types with their locations.

use std::fmt;
use std::io;
use std::path::{Path, PathBuf};

use robogate_core::SpaceError;

use crate::{SCHEMA_VERSION, SchemaVersion};

/// Where a row is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum RowPlace {
    /// A row of a table, counted from 0.
    Row(u64),
    /// A line of a text file, counted from 1, as editors show it.
    Line(u64),
}

impl Default for RowPlace {
    fn default() -> Self {
        Self::Row(0)
    }
}

impl fmt::Display for RowPlace {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Row(row) => write!(f, "row {row}"),
            Self::Line(line) => write!(f, "line {line}"),
        }
    }
}

/// The reason why a record could not be written or read.
#[derive(Debug, thiserror::Error)]
pub enum DictionaryError {
    /// The operating system returned an error.
    #[error("cannot {action} {}: {source}{}", path.display(), io_hint(source))]
    Io {
        /// The file.
        path: PathBuf,
        /// The attempted action.
        action: &'static str,
        /// The error of the operating system.
        source: io::Error,
    },
    /// The file is not a dictionary, or is truncated.
    #[error("{}: not a readable dictionary: {reason}", path.display())]
    NotADictionary {
        /// The file.
        path: PathBuf,
        /// The problem, with a hint.
        reason: String,
    },
    /// The journal of another campaign.
    #[error("{}: the journal belongs to another campaign: it names the plan with the SHA-256 {found}, but this folder's plan.json has {expected}\nHint: restore the journal or the plan of this run; episodes of two campaigns cannot be mixed", path.display())]
    OtherPlan {
        /// The journal.
        path: PathBuf,
        /// The SHA-256 (hex) that the journal names.
        found: String,
        /// The SHA-256 (hex) of the plan.
        expected: String,
    },
    /// A part of a dictionary has changed since it was written.
    #[error("{}: {place} is damaged: {reason}\nHint: restore the file from a backup, or run its campaign again", path.display())]
    Damaged {
        /// The file.
        path: PathBuf,
        /// The affected rows or part.
        place: String,
        /// The problem.
        reason: String,
    },
    /// The file was written by another version of robogate.
    #[error("{}: its schema version is {found}. Expected {SCHEMA_VERSION}\nHint: {}; the file was not changed", path.display(), other_version_hint(*found))]
    OtherSchema {
        /// The file.
        path: PathBuf,
        /// The version.
        found: SchemaVersion,
    },
    /// A parameter or measure has the name of another column.
    #[error("`{column}` is the name of another column of the dictionary\nHint: rename the parameter or measure")]
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
        /// The type of the column.
        found: &'static str,
        /// The requested type.
        wanted: &'static str,
    },
    /// A value that does not fit its column, or that contradicts another value.
    #[error("{}: {place}, column `{column}`: {value} {reason}", path.display())]
    Value {
        /// The file.
        path: PathBuf,
        /// The row.
        place: RowPlace,
        /// The column.
        column: String,
        /// The offending value.
        value: String,
        /// The problem, with a hint.
        reason: String,
    },
    /// A requested parameter that does not fit the space.
    #[error("episode {index}: parameter `{parameter}` {reason}")]
    Parameter {
        /// The episode's index.
        index: u64,
        /// The parameter.
        parameter: String,
        /// The problem.
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
    /// A seed that does not belong to the episode.
    #[error("episode {index}: its seed does not match the campaign's seed and this index")]
    ForeignSeed {
        /// The episode's index.
        index: u64,
    },
    /// An episode whose record does not fit into one frame.
    #[error("episode {index}: its record is larger than 4 GiB")]
    TooLarge {
        /// The episode's index.
        index: u64,
    },
    /// Two episodes of different campaigns in one dictionary.
    #[error("episode {index} belongs to a campaign with seed {found}. Expected seed {expected}, as in the dictionary")]
    ForeignCampaign {
        /// The episode's index.
        index: u64,
        /// The campaign's seed.
        found: u64,
        /// The dictionary's seed.
        expected: u64,
    },
    /// An index that is not larger than the previous one.
    #[error("episode {index} follows episode {previous}. Expected each index once, in increasing order")]
    Order {
        /// The episode's index.
        index: u64,
        /// The previous index.
        previous: u64,
    },
    /// The file is not a readable journal.
    #[error("{}: not a readable journal: {reason}", path.display())]
    NotAJournal {
        /// The file.
        path: PathBuf,
        /// The problem.
        reason: String,
    },
    /// A record before the journal's end has changed since it was written.
    #[error("{}: the record at byte {offset} is damaged: {reason}\nHint: to keep the {intact} episodes before it and run the others again, truncate the file there (truncate -s {offset})", path.display())]
    DamagedJournal {
        /// The file.
        path: PathBuf,
        /// Start of the record, in bytes from the file's start.
        offset: u64,
        /// The number of intact records before it.
        intact: u64,
        /// The problem.
        reason: String,
    },
    /// The journal already contains this episode.
    #[error("{} already contains episode {index}", path.display())]
    Duplicate {
        /// The journal.
        path: PathBuf,
        /// The episode's index.
        index: u64,
    },
    /// Another process writes to the journal.
    #[error("{} is in use by another process\nHint: only one process at a time can run or resume a campaign", path.display())]
    Locked {
        /// The journal.
        path: PathBuf,
    },
    /// An earlier write failed and could not be undone.
    #[error("{}: no more episodes can be recorded after a failed write\nHint: free disk space, then resume the campaign", path.display())]
    Broken {
        /// The journal.
        path: PathBuf,
    },
    /// The file is not valid JSON, or does not have the published structure.
    #[error("{}: {source}", path.display())]
    Json {
        /// The file.
        path: PathBuf,
        /// The problem with line and column.
        source: serde_json::Error,
    },
    /// The totals of a published file contradict its rows.
    #[error("{}: {reason}", path.display())]
    Published {
        /// The file.
        path: PathBuf,
        /// The contradiction.
        reason: String,
    },
    /// Results of another tool that cannot be imported.
    #[error("{} cannot be imported: {reason}", path.display())]
    Results {
        /// The file.
        path: PathBuf,
        /// The problem and its position, with a hint.
        reason: String,
    },
    /// A mapping of columns that is not valid.
    #[error("{origin}: {reason}")]
    Mapping {
        /// The mapping file, or the option.
        origin: String,
        /// The problem and its position, with a hint.
        reason: String,
    },
    /// The parameter space is not valid.
    #[error(transparent)]
    Space(#[from] SpaceError),
}

impl DictionaryError {
    /// The error of an operation on a file, such as `read`.
    pub fn io(path: &Path, action: &'static str) -> impl FnOnce(io::Error) -> Self {
        move |source| Self::Io { path: path.to_owned(), action, source }
    }

    pub(crate) fn json(path: &Path, source: serde_json::Error) -> Self {
        match source.io_error_kind() {
            // An error of the meter keeps its text.
            Some(io::ErrorKind::InvalidData) => {
                Self::Results { path: path.to_owned(), reason: io::Error::from(source).to_string() }
            }
            Some(kind) => Self::io(path, "read")(kind.into()),
            // Python's json module writes NaN for a missing number, which is not valid JSON.
            None if source.to_string().starts_with("expected value") => Self::Results {
                path: path.to_owned(),
                reason: format!("{source}\nHint: JSON has no NaN or Infinity; write null in their place"),
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
            "\nHint: free disk space, then try again; everything recorded before is intact"
        }
        io::ErrorKind::PermissionDenied | io::ErrorKind::ReadOnlyFilesystem => {
            "\nHint: choose a folder with write permission"
        }
        io::ErrorKind::NotFound => "\nHint: check the path",
        _ => "",
    }
}

/// What to do with a dictionary of another schema version.
fn other_version_hint(found: SchemaVersion) -> &'static str {
    if found > SCHEMA_VERSION {
        "upgrade robogate"
    } else {
        "run the campaign again, or use the version of robogate that wrote it"
    }
}
