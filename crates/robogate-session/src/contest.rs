//! A contest of policies: all run the same scenarios round by round, and worse ones leave.
//!
//! Each policy has a campaign of its own in a folder below that of the contest. Between its rounds, the campaign waits like an
//! interrupted one; after its last round it is finished like any other. A contest that was interrupted therefore continues where
//! it was.

use std::ops::ControlFlow;
use std::path::PathBuf;

use anyhow::anyhow;
use robogate_campaign::folder::{DICTIONARY, PLAN};
use robogate_campaign::{
    Completion, Event, ExecuteError, Executor, LostEpisode, Plan, Round, RunError, resume_in_rounds, start_in_rounds,
};
use robogate_core::{Episode, Outcome, Scenario};
use robogate_dictionary::{Dictionary, Entry, Provenance};
use robogate_stats::contest::{ContestError, Dropped, Elimination, Guarantee, Schedule};

use crate::failure::{Failure, FailureKind, OrFailure};
use crate::subject::Subject;
use crate::workers::Workers;

/// A policy of a contest.
pub struct Contestant {
    /// Its name in the contest.
    pub name: String,
    /// Environment and policy.
    pub subject: Subject,
    /// The folder of its campaign.
    pub folder: PathBuf,
}

/// A contest before its first round.
pub struct Contest {
    /// The policies.
    pub contestants: Vec<Contestant>,
    /// The plan of each campaign: a suite with its largest number of rounds.
    pub plan: Plan,
    /// What the error bounds.
    pub guarantee: Guarantee,
    /// The error probability, over all pairs and rounds.
    pub error: f64,
}

/// How a contest ended.
pub enum ContestEnd {
    /// All rounds that were needed ran.
    Finished {
        /// The tests of all pairs.
        elimination: Elimination,
        /// The invalid episodes of each policy.
        invalid: Vec<u64>,
    },
    /// The user stopped it.
    Interrupted {
        /// The policy that ran.
        name: String,
        /// The recorded episodes of this policy.
        done: u64,
    },
}

/// What happens after each round: its number, counted from 1, the tests so far, and the policies that leave.
pub type AfterRound<'a> = dyn FnMut(u64, &Elimination, &[Dropped]) + 'a;

impl From<ContestError> for Failure {
    fn from(error: ContestError) -> Self {
        Self { kind: FailureKind::Request, error: error.into() }
    }
}

impl Contest {
    /// The tests before the first round.
    ///
    /// # Errors
    /// A number of policies or rounds that cannot be tested.
    pub fn elimination(&self) -> Result<Elimination, Failure> {
        let suite = self.plan.suite.as_ref().ok_or_else(|| anyhow!("a contest needs a suite")).or_request()?;
        let schedule = Schedule { per_look: suite.scenarios(), looks: suite.rounds };
        Ok(Elimination::new(self.contestants.len(), schedule, self.guarantee, self.error)?)
    }

    /// Runs the rounds until one policy is left or all rounds are used. Episodes that are recorded already do not run again.
    ///
    /// # Errors
    /// A folder of another contest, or infrastructure: the recorded episodes are kept.
    pub fn run(
        &self,
        workers: Workers<'_>,
        events: &mut dyn FnMut(&Event),
        after_round: &mut AfterRound<'_>,
    ) -> Result<ContestEnd, Failure> {
        let mut elimination = self.elimination()?;
        let mut invalid = vec![0; self.contestants.len()];
        while !elimination.is_over() {
            let round = elimination.looks();
            let left = elimination.best_set();
            let mut columns = vec![None; self.contestants.len()];
            for &at in &left {
                let contestant = &self.contestants[at];
                match contestant.advance(&self.plan, round, Then::Waits, workers, events)? {
                    Advance::Round(outcomes) => {
                        invalid[at] += outcomes.iter().filter(|outcome| outcome.is_none()).count() as u64;
                        columns[at] = Some(outcomes);
                    }
                    Advance::Interrupted(done) => {
                        return Ok(ContestEnd::Interrupted { name: contestant.name.clone(), done });
                    }
                }
            }
            let scenarios = columns.iter().flatten().map(Vec::len).max().unwrap_or(0);
            let row = |scenario: usize| {
                columns.iter().map(|column| column.as_ref()?.get(scenario).copied().flatten()).collect()
            };
            let blocks: Vec<Vec<Option<bool>>> = (0..scenarios).map(row).collect();
            let dropped = elimination.look(&blocks)?;
            let over = elimination.is_over();
            for at in left.into_iter().filter(|at| over || dropped.iter().any(|out| out.policy == *at)) {
                let contestant = &self.contestants[at];
                if let Advance::Interrupted(done) =
                    contestant.advance(&self.plan, round, Then::Finishes, workers, events)?
                {
                    return Ok(ContestEnd::Interrupted { name: contestant.name.clone(), done });
                }
            }
            after_round(round + 1, &elimination, &dropped);
        }
        Ok(ContestEnd::Finished { elimination, invalid })
    }
}

/// What a campaign does after a round.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Then {
    Waits,
    Finishes,
}

/// The end of a round of one policy.
enum Advance {
    /// Whether each scenario succeeded. `None` for an invalid episode.
    Round(Vec<Option<bool>>),
    /// The user stopped it after this many episodes.
    Interrupted(u64),
}

impl Contestant {
    /// Runs the campaign up to the end of a round.
    fn advance(
        &self,
        plan: &Plan,
        round: u64,
        then: Then,
        workers: Workers<'_>,
        events: &mut dyn FnMut(&Event),
    ) -> Result<Advance, Failure> {
        let suite = plan.suite.as_ref().ok_or_else(|| anyhow!("a contest needs a suite")).or_request()?;
        let begun = self.folder.join(PLAN).is_file();
        if begun && robogate_campaign::settings(&self.folder)?.plan != *plan {
            return Err(anyhow!(
                "{} has another plan than this contest\nHint: choose another --out, or repeat the options of that contest",
                self.folder.display()
            ))
            .or_request();
        }
        let provenance = self.subject.provenance(suite.suite.space().clone())?;
        if !begun {
            self.subject.register(&self.folder, &provenance);
        }
        let indices = round * suite.scenarios()..(round + 1) * suite.scenarios();
        let mut outcomes = None;
        let completion = workers.carry(&self.folder, &self.subject, events, |executor, events| {
            let until = Until { executor, end: indices.end };
            let mut after = |done: &Round<'_>| {
                if done.number == round {
                    outcomes = Some(done.entries.iter().map(outcome).collect());
                }
                let ends = then == Then::Finishes && done.number == round;
                if ends { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
            };
            self.campaign(plan, provenance, begun, &until, events, &mut after)
        })?;
        match (outcomes, completion) {
            (Some(outcomes), _) => Ok(Advance::Round(outcomes)),
            // A finished campaign does not run again.
            (None, Completion::Finished { .. }) => Ok(Advance::Round(self.recorded(indices)?)),
            (None, Completion::Interrupted { done, .. }) => Ok(Advance::Interrupted(done)),
        }
    }

    fn campaign(
        &self,
        plan: &Plan,
        provenance: Provenance,
        begun: bool,
        executor: &dyn Executor,
        events: &mut dyn FnMut(&Event),
        after: &mut robogate_campaign::AfterRound<'_>,
    ) -> Result<Completion, RunError> {
        if begun {
            resume_in_rounds(&self.folder, &provenance, executor, events, after)
        } else {
            start_in_rounds(&self.folder, plan, provenance, executor, events, after)
        }
    }

    /// The outcomes of these episodes of a finished campaign.
    fn recorded(&self, indices: std::ops::Range<u64>) -> Result<Vec<Option<bool>>, Failure> {
        let path = self.folder.join(DICTIONARY);
        let dictionary = Dictionary::open(&path).or_broken()?;
        let mut found = Vec::new();
        for entry in dictionary.entries() {
            let entry = entry.or_broken()?;
            if indices.contains(&entry.index()) {
                found.push(outcome(&entry));
            }
        }
        if found.len() as u64 == indices.end - indices.start {
            return Ok(found);
        }
        Err(anyhow!(
            "{} ends before episode {}, which this contest needs\nHint: choose another --out",
            path.display(),
            indices.end
        ))
        .or_request()
    }
}

/// Whether an episode succeeded. `None` if it is invalid.
fn outcome(entry: &Entry) -> Option<bool> {
    match &entry.episode.outcome {
        Outcome::Invalid(_) => None,
        outcome => Some(matches!(outcome, Outcome::Success)),
    }
}

/// An executor that leaves the episodes from `end` on to a later call.
struct Until<'a> {
    executor: &'a dyn Executor,
    end: u64,
}

impl Executor for Until<'_> {
    fn parallelism(&self) -> usize {
        self.executor.parallelism()
    }

    fn execute(
        &self,
        scenario: &(dyn Fn(usize) -> Option<Scenario> + Sync),
        receive: &mut dyn FnMut(Episode) -> ControlFlow<()>,
    ) -> Result<(), ExecuteError> {
        let end = self.end;
        self.executor.execute(&|at| scenario(at).filter(|scenario| scenario.index < end), receive)
    }

    fn take_lost(&self) -> Vec<LostEpisode> {
        self.executor.take_lost()
    }
}
