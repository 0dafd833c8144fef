//! Runs one shard and commits it.

use std::ops::ControlFlow;

use robogate_dictionary::LostEpisode;
use robogate_dictionary::frame::encode_frame;

use super::file::{self, Hash, Header};
use super::{OpenRound, Shard, ShardError, ShardRound, Shards, Stored, shard_name};
use crate::invalid::MostlyInvalid;
use crate::run::AfterRound;
use crate::{Event, Executor, OutcomeCounts, Points, RunError};

/// What a worker has to do for its shard.
#[derive(Debug)]
pub enum Assignment {
    /// The episodes of the shard in the open round.
    Run(Box<ShardTask>),
    /// Nothing: the shard of the open round is committed. Other shards of it are missing.
    Committed {
        /// The open round.
        round: ShardRound,
    },
    /// [`Shards::choose`] the points of this round first, then ask again.
    Choose {
        /// The open round, of the active stage.
        round: ShardRound,
    },
    /// Nothing: all rounds are complete.
    Complete,
}

/// The episodes of one shard.
#[derive(Debug)]
pub struct ShardTask {
    points: Points,
    indices: Vec<u64>,
    round: ShardRound,
    shard: Shard,
    plan: Hash,
}

/// The result of a shard that is not committed yet.
#[derive(Debug)]
pub struct ShardResult {
    round: ShardRound,
    shard: Shard,
    outcomes: OutcomeCounts,
    lost: Vec<LostEpisode>,
    bytes: Vec<u8>,
}

/// How the run of a shard ended.
#[derive(Debug)]
pub enum ShardEnd {
    /// Every episode ran. [`Shards::commit`] stores the result.
    Complete(ShardResult),
    /// The run was stopped. Its episodes are lost.
    Interrupted {
        /// The number of episodes that ran.
        done: u64,
        /// The number of episodes of the shard.
        episodes: u64,
    },
}

/// Whether a commit was the first one of its shard.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Commit {
    /// The shard is stored.
    First,
    /// Another process has stored the same bytes before.
    Duplicate,
}

impl Shards {
    /// What the worker of shard `index` has to do in the open round.
    ///
    /// `after_round` is that of [`Self::open_round`].
    pub fn assign(&self, index: u32, after_round: Option<&mut AfterRound<'_>>) -> Result<Assignment, ShardError> {
        let shard = Shard::new(index, self.shards())?;
        // Other shards may run while one of them has two results. A merge rejects these.
        let Some(OpenRound { round, missing }) = self.rounds(&self.files()?, after_round)?.1 else {
            return Ok(Assignment::Complete);
        };
        let indices = self.division(round).of(shard);
        if missing.binary_search(&index).is_err() {
            // A damaged file is reported as early as possible.
            self.read(round, shard, &indices)?;
            self.check_conflict(round, shard)?;
            return Ok(Assignment::Committed { round });
        }
        if let (ShardRound::Active(number), true) = (round, self.plan().active.is_some())
            && self.chosen(number)?.is_none()
        {
            return Ok(Assignment::Choose { round });
        }
        let points = self.points(round)?;
        Ok(Assignment::Run(Box::new(ShardTask { points, indices, round, shard, plan: self.plan_hash })))
    }

    /// Stores the result of a shard. If another process has stored the same bytes, nothing changes. Other bytes are an
    /// error, because a shard must not depend on the machine that runs it. They are recorded beside the shard.
    pub fn commit(&self, result: &ShardResult) -> Result<Commit, ShardError> {
        let name = shard_name(result.round, result.shard);
        // Before the shard, which other processes may use at once.
        self.store_lost(&name, &result.lost)?;
        match self.put_equal(&name, &result.bytes) {
            Ok(Stored::New) => Ok(Commit::First),
            Ok(Stored::Exists) => Ok(Commit::Duplicate),
            Err(error) => {
                if let ShardError::Conflict { committed, computed, .. } = &error {
                    // The conflict is the more important error of both.
                    let _ = self.record_conflict(&name, committed, computed);
                }
                Err(error)
            }
        }
    }
}

impl ShardTask {
    /// The round.
    pub fn round(&self) -> ShardRound {
        self.round
    }

    /// The number of episodes of the shard.
    pub fn episodes(&self) -> u64 {
        self.indices.len() as u64
    }

    /// The indices of its episodes in the campaign, in increasing order.
    pub fn indices(&self) -> &[u64] {
        &self.indices
    }

    /// Runs every episode of the shard. The records stay in memory until [`Shards::commit`].
    pub fn run(&self, executor: &dyn Executor, events: &mut dyn FnMut(&Event)) -> Result<ShardEnd, RunError> {
        let (stage, episodes) = (self.round.stage(), self.episodes());
        let mut outcomes = OutcomeCounts::default();
        events(&Event::Started { episodes, already_done: 0, threads: executor.parallelism() });
        events(&Event::StageStarted { stage, episodes, already_done: outcomes.clone() });
        let scenario = |i: usize| self.points.scenario(*self.indices.get(i)?);
        let mut frames: Vec<(u64, Vec<u8>)> = Vec::with_capacity(self.indices.len());
        let mut invalid = MostlyInvalid::default();
        let mut problem = None;
        executor.execute(&scenario, &mut |episode| {
            let index = episode.scenario.index;
            let mut frame = Vec::new();
            let recorded = match self.points.entry(episode) {
                Some(entry) => encode_frame(&entry, &mut frame).map(|()| entry).map_err(RunError::from),
                None => Err(RunError::UnexpectedEpisode { index }),
            };
            let entry = match recorded {
                Ok(entry) => entry,
                Err(error) => {
                    problem = Some(error);
                    return ControlFlow::Break(());
                }
            };
            frames.push((index, frame));
            outcomes.add(&entry.episode.outcome);
            events(&Event::episode(stage, &entry.episode));
            if let Some(warning) = invalid.add(&entry.episode.outcome) {
                events(&Event::warning(warning));
            }
            ControlFlow::Continue(())
        })?;
        if let Some(error) = problem {
            return Err(error);
        }
        frames.sort_unstable_by_key(|(index, _)| *index);
        let done = frames.len() as u64;
        if !frames.iter().map(|(index, _)| index).eq(&self.indices) {
            events(&Event::Interrupted { done, episodes });
            return Ok(ShardEnd::Interrupted { done, episodes });
        }
        if let Some(warning) = invalid.warning() {
            events(&Event::warning(warning));
        }
        events(&Event::StageFinished { stage, outcomes: outcomes.clone() });
        let header = Header { plan: self.plan, round: self.round, shard: self.shard, episodes };
        let bytes = file::encode(&header, frames.iter().map(|(_, frame)| frame.as_slice()));
        let lost = executor.take_lost();
        Ok(ShardEnd::Complete(ShardResult { round: self.round, shard: self.shard, outcomes, lost, bytes }))
    }
}

impl ShardResult {
    /// The round.
    pub fn round(&self) -> ShardRound {
        self.round
    }

    /// The outcomes of its episodes.
    pub fn outcomes(&self) -> &OutcomeCounts {
        &self.outcomes
    }
}
