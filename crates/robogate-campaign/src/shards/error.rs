//! Errors of campaigns in shards.

use std::io;
use std::path::PathBuf;

use robogate_dictionary::DictionaryError;

use super::{ShardNameError, ShardRound};
use crate::RunError;

/// The reason why a shard could not be run or merged. Committed shards are intact.
#[derive(Debug, thiserror::Error)]
pub enum ShardError {
    /// An error that a campaign on one machine can have as well.
    #[error(transparent)]
    Run(#[from] RunError),
    /// The text does not name a shard.
    #[error(transparent)]
    Name(#[from] ShardNameError),
    /// The points of a round of the active stage are not chosen yet.
    #[error(
        "the points of round {round} are not chosen yet\nHint: `robogate plan {} --next` prints its shards; the first one that runs chooses them", dir.display()
    )]
    NotChosen {
        /// The folder.
        dir: PathBuf,
        /// The round.
        round: ShardRound,
    },
    /// The store returned an error.
    #[error("cannot {action} {}: {source}{}", place.display(), io_hint(source))]
    Store {
        /// The file or folder.
        place: PathBuf,
        /// The attempted action.
        action: &'static str,
        /// The error of the store.
        source: io::Error,
    },
    /// The folder contains a run of one machine.
    #[error(
        "{} contains a run that is not divided into shards\nHint: continue it with `robogate resume {0}`, or choose another folder",
        dir.display()
    )]
    SingleRun {
        /// The folder.
        dir: PathBuf,
    },
    /// The folder contains no campaign in shards.
    #[error(
        "{} contains no campaign in shards\nHint: check the path, or run the first shard with `robogate run --shard 0/N --out {0}`",
        dir.display()
    )]
    NotInShards {
        /// The folder.
        dir: PathBuf,
    },
    /// The folder was divided into another number of shards.
    #[error(
        "{} is divided into {shards} shards, but --shard names one of {asked}\nHint: use --shard K/{shards}; the first shard of a folder fixes their number",
        dir.display()
    )]
    OtherCount {
        /// The folder.
        dir: PathBuf,
        /// The number of shards of the folder.
        shards: u32,
        /// The requested number of shards.
        asked: u32,
    },
    /// The plan was changed after the campaign was divided.
    #[error(
        "{} was changed after the first shard was run\nHint: robogate writes this file, and it must not be edited; restore it from a copy",
        path.display()
    )]
    PlanChanged {
        /// The plan.
        path: PathBuf,
    },
    /// A shard file whose name does not belong to the campaign.
    #[error(
        "{} is not a shard of this campaign, which is divided into {shards} shards\nHint: move the file to another folder",
        path.display()
    )]
    ForeignFile {
        /// The file.
        path: PathBuf,
        /// The number of shards of the campaign.
        shards: u32,
    },
    /// A shard file has changed since it was committed.
    #[error("{} is damaged: {reason}\nHint: delete the file and run this shard again", path.display())]
    Damaged {
        /// The file.
        path: PathBuf,
        /// The problem.
        reason: String,
    },
    /// A shard of another plan, or of another build.
    #[error(
        "{} belongs to another campaign: its plan, policy, engine or version of robogate differ from plan.json\nHint: delete the file and run this shard again",
        path.display()
    )]
    OtherPlan {
        /// The file.
        path: PathBuf,
    },
    /// A shard under the name of another one.
    #[error("{} contains shard {found}\nHint: restore its name, or delete the file and run this shard again", path.display())]
    Misnamed {
        /// The file.
        path: PathBuf,
        /// The shard that it contains.
        found: String,
    },
    /// Two different results for the same file.
    #[error(
        "{} exists with another content: SHA-256 {committed}, and this process computed {computed}. The existing file was kept\nHint: the same shard must give the same bytes on every machine; check that policy and simulator are deterministic",
        path.display()
    )]
    Conflict {
        /// The file.
        path: PathBuf,
        /// The SHA-256 of the existing content.
        committed: String,
        /// The SHA-256 of the content of this process.
        computed: String,
    },
    /// A committed shard for which another process computed a different result.
    #[error(
        "{} is contradicted: its SHA-256 is {committed}, and another process computed {computed} for the same shard\nHint: the same shard must give the same bytes on every machine; find out why policy or simulator are not deterministic. Then delete {} to keep the committed shard",
        path.display(), marker.display()
    )]
    Contradicted {
        /// The committed shard.
        path: PathBuf,
        /// The file that records the other result.
        marker: PathBuf,
        /// The SHA-256 of the committed shard.
        committed: String,
        /// The SHA-256 of the other result.
        computed: String,
    },
    /// Shards are missing.
    #[error(
        "{} of {shards} shards of round {round} are missing: {}\nHint: `robogate plan {} --next` prints the commands that run them",
        missing.len(), listed(missing), dir.display()
    )]
    Missing {
        /// The folder.
        dir: PathBuf,
        /// The first incomplete round.
        round: ShardRound,
        /// The number of shards.
        shards: u32,
        /// The missing shards of this round.
        missing: Vec<u32>,
    },
    /// The result of an earlier merge has changed.
    #[error("{source}\nHint: if the shards are still there, delete {} and merge them again", path.display())]
    DamagedResult {
        /// The dictionary.
        path: PathBuf,
        /// The problem.
        source: Box<DictionaryError>,
    },
    /// The output folder contains another run.
    #[error("{} contains another run\nHint: choose an empty or new folder with --out", dir.display())]
    OtherRun {
        /// The output folder.
        dir: PathBuf,
    },
}

impl From<DictionaryError> for ShardError {
    fn from(error: DictionaryError) -> Self {
        Self::Run(error.into())
    }
}

/// The first numbers of a list.
fn listed(numbers: &[u32]) -> String {
    const MOST: usize = 20;
    let first: Vec<String> = numbers.iter().take(MOST).map(ToString::to_string).collect();
    let more = if numbers.len() > MOST { ", ..." } else { "" };
    format!("{}{more}", first.join(", "))
}

fn io_hint(source: &io::Error) -> &'static str {
    match source.kind() {
        io::ErrorKind::StorageFull | io::ErrorKind::QuotaExceeded => {
            "\nHint: free space on that disk, then run the shard again"
        }
        io::ErrorKind::PermissionDenied | io::ErrorKind::ReadOnlyFilesystem => {
            "\nHint: choose a folder with write permission"
        }
        io::ErrorKind::Unsupported => "\nHint: shards need a file system with hard links, such as ext4, XFS or NFS",
        _ => "",
    }
}
