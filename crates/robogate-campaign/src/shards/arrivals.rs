//! The episodes of a campaign in shards while it runs.

use std::collections::BTreeSet;

use robogate_dictionary::Entry;

use super::{Shard, ShardError, ShardRound, Shards};

impl Shards {
    /// Reads the shards that were committed since `known` was empty, and adds them to it. The order is that of the rounds
    /// and shards.
    ///
    /// # Errors
    /// A shard that cannot be read. Shards before it stay in `known`, and their episodes are passed to `sink`.
    pub fn arrivals(
        &self,
        known: &mut BTreeSet<(ShardRound, u32)>,
        sink: &mut dyn FnMut(&Entry),
    ) -> Result<(), ShardError> {
        for (round, shards) in self.committed(&self.files()?)? {
            let fresh: Vec<u32> = shards.into_iter().filter(|shard| !known.contains(&(round, *shard))).collect();
            if fresh.is_empty() {
                continue;
            }
            let division = self.division(round);
            for index in fresh {
                let shard = Shard::new(index, self.shards())?;
                self.read(round, shard, &division.of(shard))?.iter().flatten().for_each(&mut *sink);
                known.insert((round, index));
            }
        }
        Ok(())
    }

    /// Reads the entry of one episode from its shard. `None` if the shard is not committed.
    ///
    /// # Errors
    /// The shard cannot be read.
    pub fn recorded(&self, index: u64) -> Result<Option<Entry>, ShardError> {
        for (round, shards) in self.committed(&self.files()?)? {
            if !round.indices(self.plan()).contains(&index) {
                continue;
            }
            let division = self.division(round);
            for number in shards {
                let shard = Shard::new(number, self.shards())?;
                let indices = division.of(shard);
                if indices.contains(&index) {
                    let entries = self.read(round, shard, &indices)?.unwrap_or_default();
                    return Ok(entries.into_iter().find(|entry| entry.index() == index));
                }
            }
        }
        Ok(None)
    }
}
