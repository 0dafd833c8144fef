//! Attempts that infrastructure faults lost while a shard ran, in a file beside the shard.

use robogate_dictionary::{LostEpisode, hex};

use super::{ShardError, Shards, file, get, put, store};
use crate::RunError;
use crate::folder::json_lines;

/// The ending of such a file, after the name of the shard's file and a hash of its content.
const LOST: &str = ".lost";

impl Shards {
    /// Stores the attempts of the process that ran the shard file `name`. Each process has its own file, named by its content.
    pub(super) fn store_lost(&self, name: &str, lost: &[LostEpisode]) -> Result<(), ShardError> {
        if lost.is_empty() {
            return Ok(());
        }
        let path = self.store.place(name);
        let lines = json_lines(lost).map_err(|source| RunError::Unreadable { path, source })?;
        let name = format!("{name}.{}{LOST}", &hex(&file::sha256(&lines))[..16]);
        put(&*self.store, &name, &lines)?;
        Ok(())
    }

    /// The attempts of all shards. `files` is that of [`Self::files`].
    pub(super) fn lost(&self, files: &[String]) -> Result<Vec<LostEpisode>, ShardError> {
        let of_shard = |name: &&String| {
            let shard = name.strip_suffix(LOST).and_then(|name| name.rsplit_once('.'));
            shard.is_some_and(|(shard, _)| file::parse_name(shard).is_some())
        };
        let mut lost = Vec::new();
        for name in files.iter().filter(of_shard) {
            let text = get(&*self.store, &format!("{}/{name}", store::SHARDS))?.unwrap_or_default();
            lost.extend(LostEpisode::parse(&String::from_utf8_lossy(&text)));
        }
        Ok(lost)
    }
}
