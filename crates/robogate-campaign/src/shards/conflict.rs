//! Records of shards for which two processes computed different results.
//!
//! A scheduler may run a failed shard again. It then finds the committed file and succeeds, so the first failure alone would not
//! be noticed.

use serde::{Deserialize, Serialize};

use super::{Shard, ShardError, ShardRound, Shards, file, get, put, shard_name, store};
use crate::RunError;
use crate::folder;

/// The content of a record, with the SHA-256 of both results.
#[derive(Debug, Serialize, Deserialize)]
struct Conflict {
    version: u32,
    committed: String,
    computed: String,
}

impl Conflict {
    const VERSION: u32 = 1;
}

impl Shards {
    /// Records that a process computed another result than the committed one for the shard file `name`.
    pub(super) fn record_conflict(&self, name: &str, committed: &str, computed: &str) -> Result<(), ShardError> {
        let (committed, computed) = (committed.to_owned(), computed.to_owned());
        let marker = file::conflict_name(name);
        let path = self.store.place(&marker);
        let record = Conflict { version: Conflict::VERSION, committed, computed };
        let text = folder::document_bytes(&record).map_err(|source| RunError::Unreadable { path, source })?;
        // If a record exists, this is a third result. One is sufficient.
        put(&*self.store, &marker, &text)?;
        Ok(())
    }

    /// Rejects a shard with a record of another result.
    pub(super) fn check_conflict(&self, round: ShardRound, shard: Shard) -> Result<(), ShardError> {
        self.check_record(&shard_name(round, shard))
    }

    /// Rejects a campaign with a record of another result for any shard. `files` is that of [`Self::files`].
    pub(super) fn check_conflicts(&self, files: &[String]) -> Result<(), ShardError> {
        let mut contradicted = files.iter().filter_map(|file| file::contradicted(file));
        contradicted.try_for_each(|shard| self.check_record(&format!("{}/{shard}", store::SHARDS)))
    }

    /// Rejects the shard file `name` if there is a record of another result.
    fn check_record(&self, name: &str) -> Result<(), ShardError> {
        let marker = file::conflict_name(name);
        let Some(text) = get(&*self.store, &marker)? else { return Ok(()) };
        let (path, marker) = (self.store.place(name), self.store.place(&marker));
        let Conflict { version, committed, computed } = folder::parse(&marker, &text)?;
        crate::run::known_version(&marker, version, Conflict::VERSION)?;
        Err(ShardError::Contradicted { path, marker, committed, computed })
    }
}
