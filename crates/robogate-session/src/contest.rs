//! A contest of policies: all run the same scenarios round by round, and worse ones leave.
//!
//! Each policy has a campaign of its own in a folder below that of the contest. Between its rounds, the campaign waits like an
//! interrupted one; after its last round it is finished like any other. A contest that was interrupted therefore continues where
//! it was. The folder of the contest records its question before the first episode, and another question is refused.

use std::ops::ControlFlow;
use std::path::{Path, PathBuf};

use anyhow::{Context, anyhow};
use robogate_campaign::folder::{DICTIONARY, PLAN};
use robogate_campaign::{
    Completion, Event, ExecuteError, Executor, Plan, Round, RunError, resume_in_rounds, start_in_rounds,
};
use robogate_core::budget::Budget;
use robogate_core::{Episode, Outcome, Scenario, TaskSpec};
use robogate_dictionary::{Dictionary, Entry, LostEpisode, Provenance, files, read_regular_text};
use robogate_gate::{RankingGuarantee, RankingOutcome};
use robogate_stats::contest::{ContestError, Dropped, Elimination, Schedule};
use serde::{Deserialize, Serialize};

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
    /// Its folder.
    pub folder: PathBuf,
    /// The policies.
    pub contestants: Vec<Contestant>,
    /// The plan of each campaign: a suite with its largest number of rounds.
    pub plan: Plan,
    /// What is compared.
    pub by: RankingOutcome,
    /// What the error bounds.
    pub guarantee: RankingGuarantee,
    /// The error probability, over all pairs and rounds.
    pub error: f64,
}

/// The question of a contest: what its answer depends on, apart from the plan, which each campaign records.
#[derive(Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Question {
    /// Version of the format.
    format: u32,
    /// The names of the policies, in their order.
    policies: Vec<String>,
    guarantee: RankingGuarantee,
    error: f64,
    /// What is compared.
    #[serde(default, skip_serializing_if = "RankingOutcome::is_success")]
    by: RankingOutcome,
}

impl Question {
    const FORMAT: u32 = 1;

    /// Rejects a file with another question.
    fn check(&self, path: &Path) -> Result<(), Failure> {
        let text = read_regular_text(path).with_context(|| format!("cannot read {}", path.display())).or_request()?;
        let recorded: Self = Budget::FILE
            .json(text.as_bytes())
            .with_context(|| format!("{}: not the question of a contest\nHint: choose another --out", path.display()))
            .or_request()?;
        let parts = [
            ("format", recorded.format.to_string(), self.format.to_string()),
            ("policies", recorded.policies.join(","), self.policies.join(",")),
            ("guarantee", recorded.guarantee.name().to_owned(), self.guarantee.name().to_owned()),
            ("error", recorded.error.to_string(), self.error.to_string()),
            ("by", recorded.by.name().to_owned(), self.by.name().to_owned()),
        ];
        let other = parts.iter().filter(|(_, recorded, asked)| recorded != asked);
        let other: Vec<String> =
            other.map(|(part, recorded, asked)| format!("{part} {recorded} instead of {asked}")).collect();
        if other.is_empty() {
            return Ok(());
        }
        Err(anyhow!(
            "{} has another question than this contest: {}\nHint: choose another --out, or repeat the options of that contest",
            path.display(),
            other.join("; ")
        ))
        .or_request()
    }
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
    /// The file in the folder with the question: names of the policies, guarantee and error.
    pub const QUESTION: &'static str = "question.json";

    /// The tests before the first round.
    ///
    /// # Errors
    /// A number of policies or rounds that cannot be tested.
    pub fn elimination(&self) -> Result<Elimination, Failure> {
        let suite = self.plan.suite.as_ref().ok_or_else(|| anyhow!("a contest needs a suite")).or_request()?;
        let schedule = Schedule { per_look: suite.scenarios(), looks: suite.rounds };
        let all = Elimination::new(self.contestants.len(), schedule, self.guarantee.of_test(), self.error)?;
        let task = self.contestants.first().map(|of| of.subject.task());
        Ok(all.with_top(task.map_or(1, |task| top(task, self.by))))
    }

    /// Writes the question before the first episode. Rejects a folder with another question, or with episodes and no question.
    fn ask(&self) -> Result<(), Failure> {
        let question = Question {
            format: Question::FORMAT,
            policies: self.contestants.iter().map(|of| of.name.clone()).collect(),
            guarantee: self.guarantee,
            error: self.error,
            by: self.by,
        };
        let path = self.folder.join(Self::QUESTION);
        if path.is_file() {
            return question.check(&path);
        }
        if let Some(begun) = self.contestants.iter().find(|of| of.folder.join(PLAN).is_file()) {
            return Err(anyhow!(
                "{} has episodes, but the question of their contest is missing: {}\nHint: choose another --out",
                begun.folder.display(),
                path.display()
            ))
            .or_request();
        }
        let text = serde_json::to_string_pretty(&question).or_broken()? + "\n";
        files::create_folders(&self.folder)
            .and_then(|()| files::write(&path, text))
            .with_context(|| format!("cannot write {}", path.display()))
            .or_broken()
    }

    /// Runs the rounds until one policy is left or all rounds are used. Episodes that are recorded already do not run again.
    ///
    /// # Errors
    /// A folder of another contest or question, or infrastructure: the recorded episodes are kept.
    pub fn run(
        &self,
        workers: Workers<'_>,
        events: &mut dyn FnMut(&Event),
        after_round: &mut AfterRound<'_>,
    ) -> Result<ContestEnd, Failure> {
        let mut elimination = self.elimination()?;
        self.ask()?;
        let mut invalid = vec![0; self.contestants.len()];
        while !elimination.is_over() {
            let round = elimination.looks();
            let left = elimination.best_set();
            let mut columns = vec![None; self.contestants.len()];
            for &at in &left {
                let contestant = &self.contestants[at];
                match contestant.advance((&self.plan, self.by), round, Then::Waits, workers, events)? {
                    Advance::Round(scores) => {
                        invalid[at] += scores.iter().filter(|score| score.is_none()).count() as u64;
                        columns[at] = Some(scores);
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
            let blocks: Vec<Vec<Option<u32>>> = (0..scenarios).map(row).collect();
            let dropped = elimination.look(&blocks)?;
            let over = elimination.is_over();
            for at in left.into_iter().filter(|at| over || dropped.iter().any(|out| out.policy == *at)) {
                let contestant = &self.contestants[at];
                if let Advance::Interrupted(done) =
                    contestant.advance((&self.plan, self.by), round, Then::Finishes, workers, events)?
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
    /// The score in each scenario, see [`score`].
    Round(Vec<Option<u32>>),
    /// The user stopped it after this many episodes.
    Interrupted(u64),
}

impl Contestant {
    /// Runs the campaign up to the end of a round.
    fn advance(
        &self,
        (plan, by): (&Plan, RankingOutcome),
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
        let mut scores = None;
        let completion = workers.carry(&self.folder, &self.subject, events, |executor, events| {
            let until = Until { executor, end: indices.end };
            let mut after = |done: &Round<'_>| {
                if done.number == round {
                    scores = Some(done.entries.iter().map(|entry| score(self.subject.task(), entry, by)).collect());
                }
                let ends = then == Then::Finishes && done.number == round;
                if ends { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
            };
            self.campaign(plan, provenance, begun, &until, events, &mut after)
        })?;
        match (scores, completion) {
            (Some(scores), _) => Ok(Advance::Round(scores)),
            // A finished campaign does not run again.
            (None, Completion::Finished { .. }) => Ok(Advance::Round(self.recorded(indices, by)?)),
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
            start_in_rounds(&self.folder, plan, provenance, &[], executor, events, after)
        }
    }

    /// The scores of these episodes of a finished campaign.
    fn recorded(&self, indices: std::ops::Range<u64>, by: RankingOutcome) -> Result<Vec<Option<u32>>, Failure> {
        let path = self.folder.join(DICTIONARY);
        let dictionary = Dictionary::open(&path).or_broken()?;
        let mut found = Vec::new();
        for entry in dictionary.entries() {
            let entry = entry.or_broken()?;
            if indices.contains(&entry.index()) {
                found.push(score(self.subject.task(), &entry, by));
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

/// The score of a success.
fn top(task: &TaskSpec, by: RankingOutcome) -> u32 {
    match by {
        RankingOutcome::Success => 1,
        RankingOutcome::Stage => task.stages.len() as u32 + 1,
    }
}

/// How far an episode went, up to [`top`]. `None` if it is invalid, or if it did not count its stages.
fn score(task: &TaskSpec, entry: &Entry, by: RankingOutcome) -> Option<u32> {
    let episode = &entry.episode;
    let success = match &episode.outcome {
        Outcome::Invalid(_) => return None,
        outcome => matches!(outcome, Outcome::Success),
    };
    match by {
        RankingOutcome::Success => Some(u32::from(success)),
        RankingOutcome::Stage => {
            task.stage_share(success, &episode.measures).map(|share| (share * f64::from(top(task, by))).round() as u32)
        }
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
