//! The progress of a campaign in shards.

use schemars::JsonSchema;
use serde::Serialize;

use super::{Shard, ShardError, ShardRound, Shards, division};
use crate::OutcomeCounts;
use crate::run::AfterRound;

/// The progress of a campaign in shards.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
pub struct ShardStatus {
    /// The version of the document.
    pub version: u32,
    /// The number of shards of each round.
    pub shards: u32,
    /// The number of episodes of all rounds of the plan. A gate may need fewer.
    pub episodes: u64,
    /// The number of episodes in committed shards.
    pub done: u64,
    /// Whether all rounds are complete.
    pub complete: bool,
    /// The rounds in order.
    pub rounds: Vec<RoundStatus>,
}

impl ShardStatus {
    /// The version of the document that is written.
    pub const VERSION: u32 = 1;
}

/// The progress of one round.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
pub struct RoundStatus {
    /// The round.
    pub round: ShardRound,
    /// Its state.
    pub state: RoundState,
    /// The number of its episodes.
    pub episodes: u64,
    /// The number of episodes in committed shards.
    pub done: u64,
    /// The number of committed shards.
    pub committed: u32,
    /// The missing shards, in increasing order.
    pub missing: Vec<u32>,
    /// The outcomes of the episodes in committed shards.
    pub outcomes: OutcomeCounts,
}

/// The state of a round.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum RoundState {
    /// Every shard is committed.
    Complete,
    /// Its missing shards can run.
    Open,
    /// It opens when the rounds before it are complete.
    Waiting,
}

impl Shards {
    /// Reads all committed shards and counts their outcomes.
    ///
    /// `after_round` is that of [`Self::open_round`]. Rounds after the one on which it breaks are left out. As there, two
    /// different results for a shard are an error.
    pub fn status(&self, mut after_round: Option<&mut AfterRound<'_>>) -> Result<ShardStatus, ShardError> {
        let files = self.files()?;
        self.check_conflicts(&files)?;
        let committed = self.committed(&files)?;
        let lost = if after_round.is_some() { self.lost(&files)? } else { Vec::new() };
        let mut rounds: Vec<RoundStatus> = Vec::new();
        for round in ShardRound::all(self.plan()) {
            if self.is_over(round)? {
                break;
            }
            let missing = self.missing(&committed, round);
            let before = rounds.iter().all(|before| before.state == RoundState::Complete);
            let state = match (missing.is_empty(), before) {
                (true, _) => RoundState::Complete,
                (false, true) => RoundState::Open,
                (false, false) => RoundState::Waiting,
            };
            let indices = round.indices(self.plan());
            let episodes = indices.end - indices.start;
            let mut outcomes = OutcomeCounts::default();
            if let Some(there) = committed.get(&round) {
                let division = self.division(round);
                for shard in self.all_shards().filter(|shard| there.contains(&shard.index())) {
                    for entry in self.read(round, shard, &division.of(shard))?.into_iter().flatten() {
                        outcomes.add(&entry.episode.outcome);
                    }
                }
            }
            rounds.push(RoundStatus {
                round,
                state,
                episodes,
                done: outcomes.total(),
                committed: self.shards() - missing.len() as u32,
                missing,
                outcomes,
            });
            if let (Some(decide), RoundState::Complete, ShardRound::Suite(number)) = (&mut after_round, state, round)
                && self.decide(round, number, &lost, *decide)?.is_break()
            {
                break;
            }
        }
        Ok(ShardStatus {
            version: ShardStatus::VERSION,
            shards: self.shards(),
            episodes: self.plan().episodes(),
            done: rounds.iter().map(|round| round.done).sum(),
            complete: rounds.iter().all(|round| round.state == RoundState::Complete),
            rounds,
        })
    }

    /// The number of episodes of a shard in `round`.
    pub fn episodes_of(&self, round: ShardRound, shard: Shard) -> u64 {
        let indices = round.indices(self.plan());
        division::size(indices.end - indices.start, shard)
    }
}
