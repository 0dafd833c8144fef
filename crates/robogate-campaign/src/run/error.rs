//! The errors of a run.

use std::io;
use std::path::{Path, PathBuf};

use robogate_core::DesignError;
use robogate_dictionary::DictionaryError;

use crate::folder::PLAN;
use crate::{ExecuteError, PlanError};

/// The reason why a campaign could not be completed. Episodes recorded before are intact.
#[derive(Debug, thiserror::Error)]
pub enum RunError {
    /// The operating system returned an error.
    #[error("cannot {action} {}: {source}{}", path.display(), io_hint(source))]
    Io {
        /// The file or folder.
        path: PathBuf,
        /// The attempted action.
        action: &'static str,
        /// The error of the operating system.
        source: io::Error,
    },
    /// The folder contains other files.
    #[error("{} is not empty (it contains `{name}`) and is not a robogate run\nHint: choose an empty or new folder", dir.display())]
    NotEmpty {
        /// The folder.
        dir: PathBuf,
        /// A file in the folder.
        name: String,
    },
    /// The folder already contains a run.
    #[error("{}", already_a_run(dir, *finished))]
    AlreadyARun {
        /// The folder.
        dir: PathBuf,
        /// Whether it is finished.
        finished: bool,
    },
    /// The folder contains a campaign in shards.
    #[error(
        "{} contains a campaign in shards\nHint: `robogate plan {0} --next` prints the missing shards, and `robogate merge {0}` merges them", dir.display()
    )]
    InShards {
        /// The folder.
        dir: PathBuf,
    },
    /// The folder contains no run.
    #[error("{} is not a robogate run: it has no {PLAN}\nHint: check the path, or start a run with `robogate run --out DIR`", dir.display())]
    NotARun {
        /// The folder.
        dir: PathBuf,
    },
    /// Another process uses the folder.
    #[error("{} is in use by another process\nHint: only one process at a time can run or resume a campaign", dir.display())]
    Locked {
        /// The folder.
        dir: PathBuf,
    },
    /// A file of the run cannot be parsed.
    #[error("{}: {source}\nHint: robogate writes this file, and it must not be edited; restore it from a copy", path.display())]
    Unreadable {
        /// The file.
        path: PathBuf,
        /// The problem and its position.
        source: serde_json::Error,
    },
    /// A file of the run was written by another version of robogate.
    #[error("{}: its format version is {found}. Expected {expected}\nHint: {}; nothing was changed", path.display(), version_hint(*found, *expected))]
    OtherVersion {
        /// The file.
        path: PathBuf,
        /// The version of the file.
        found: u32,
        /// The version of this robogate.
        expected: u32,
    },
    /// The present setup differs from that of the run.
    #[error(
        "the run was started with another {what}: {recorded}, now {present}\nHint: resume it with the original {what}, or start a new run; episodes of both cannot be compared"
    )]
    Mismatch {
        /// The differing item.
        what: String,
        /// The value in the recorded run.
        recorded: String,
        /// The present value.
        present: String,
    },
    /// The journal contains an episode that is not in the plan.
    #[error("{}: episode {index} does not match the plan\nHint: the journal belongs to another run, or was started on another platform", path.display())]
    ForeignEpisode {
        /// The journal.
        path: PathBuf,
        /// The episode's index.
        index: u64,
    },
    /// The executor returned an episode that it was not given.
    #[error("the executor returned episode {index}, which it was not given")]
    UnexpectedEpisode {
        /// The episode's index.
        index: u64,
    },
    /// The episode is not recorded.
    #[error("{} has no record of episode {index}. The campaign has at most {episodes} episodes, counted from 0; one that is unfinished, or a gate that stopped early, lacks some of them", dir.display())]
    NoSuchEpisode {
        /// The run's folder.
        dir: PathBuf,
        /// The requested index.
        index: u64,
        /// Episodes of the whole campaign.
        episodes: u64,
    },
    /// Not all episodes could be run.
    #[error(transparent)]
    Execute(#[from] ExecuteError),
    /// The plan is invalid or does not fit the space.
    #[error(transparent)]
    Plan(#[from] PlanError),
    /// The scenarios have no nominal twins.
    #[error(transparent)]
    Suite(#[from] robogate_core::SuiteError),
    /// The sampler cannot draw the points.
    #[error(transparent)]
    Design(#[from] DesignError),
    /// The dictionary or journal cannot be written or read.
    #[error(transparent)]
    Dictionary(#[from] DictionaryError),
}

impl RunError {
    pub(crate) fn io(path: &Path, action: &'static str) -> impl FnOnce(io::Error) -> Self {
        move |source| Self::Io { path: path.to_owned(), action, source }
    }
}

fn already_a_run(dir: &Path, finished: bool) -> String {
    let dir = dir.display();
    if finished {
        format!("{dir} already contains a finished run\nHint: choose another folder")
    } else {
        format!(
            "{dir} contains an unfinished run\nHint: resume it with `robogate resume {dir}`, or choose another folder"
        )
    }
}

fn io_hint(source: &io::Error) -> &'static str {
    match source.kind() {
        io::ErrorKind::StorageFull | io::ErrorKind::QuotaExceeded => {
            "\nHint: free space on that disk, then resume; recorded episodes are intact"
        }
        io::ErrorKind::PermissionDenied | io::ErrorKind::ReadOnlyFilesystem => {
            "\nHint: choose a folder with write permission"
        }
        _ => "",
    }
}

/// What to do with a file of another version.
fn version_hint(found: u32, expected: u32) -> &'static str {
    if found > expected {
        "upgrade robogate"
    } else {
        "start the run again, or use the version of robogate that wrote it"
    }
}
