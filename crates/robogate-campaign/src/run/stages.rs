//! The stages of a running campaign.

use std::num::NonZeroUsize;
use std::ops::ControlFlow;
use std::sync::Arc;
use std::thread;

use robogate_core::{Episode, ParameterSpace};
use robogate_dictionary::{DictionaryWriter, Entry, Journal, LostEpisode, Recovery};

use super::{AfterRound, Completion, RunError, Settings};
use crate::active::{Chooser, Opened};
use crate::folder::{ACTIVE, BOUNDARY, DICTIONARY, Folder, JOURNAL, SUMMARY};
use crate::invalid::MostlyInvalid;
use crate::summary::Summing;
use crate::{
    ActiveReport, Bins, BoundaryReport, Event, Executor, OutcomeCounts, Points, Round, RunAgain, Stage, SuiteStage,
    Summary, Warning,
};

/// A campaign that runs.
pub(crate) struct Run<'a> {
    folder: Folder,
    settings: Settings,
    space: Arc<ParameterSpace>,
    journal: Journal,
    /// The counts of the first stage along each continuous parameter.
    bins: Bins,
    executor: &'a dyn Executor,
    events: &'a mut dyn FnMut(&Event),
    after_round: &'a mut AfterRound<'a>,
    invalid_so_far: MostlyInvalid,
    /// The rounds of the active stage that other processes have chosen already.
    chosen: Vec<Opened>,
}

/// Whether a stage is complete.
#[derive(PartialEq, Eq)]
enum Progress {
    Complete,
    Stopped,
}

impl<'a> Run<'a> {
    pub(crate) fn new(
        folder: Folder,
        settings: Settings,
        executor: &'a dyn Executor,
        events: &'a mut dyn FnMut(&Event),
        after_round: &'a mut AfterRound<'a>,
    ) -> Result<Self, RunError> {
        let path = folder.path(JOURNAL);
        let plan = folder.plan_hash()?;
        let (journal, recovery) = if path.exists() {
            Journal::open(&path, &plan)?
        } else {
            (Journal::create(&path, &plan)?, Recovery::default())
        };
        let episodes = settings.plan.episodes();
        if let Some(index) = journal.indices().find(|index| *index >= episodes) {
            return Err(RunError::ForeignEpisode { path, index });
        }
        let space = Arc::new(settings.provenance.space.clone());
        let bins = Bins::of(&settings.plan, &space)?;
        events(&Event::Started { episodes, already_done: journal.len(), threads: executor.parallelism() });
        if recovery.dropped_bytes > 0 {
            events(&Event::warning(Warning::RecordCut { bytes: recovery.dropped_bytes }));
        }
        let invalid_so_far = MostlyInvalid::default();
        let chosen = Vec::new();
        Ok(Self { folder, settings, space, journal, bins, executor, events, after_round, invalid_so_far, chosen })
    }

    /// Uses these rounds of the active stage, the last one without points, in place of new models.
    pub(crate) fn with_chosen(self, chosen: Vec<Opened>) -> Self {
        Self { chosen, ..self }
    }

    pub(crate) fn run(mut self) -> Result<Completion, RunError> {
        let completion = self.stages();
        if !matches!(completion, Ok(Completion::Finished { .. })) {
            let synced = self.journal.sync();
            // After an error, that error is reported instead. Without this flush the record still survives everything
            // but a power failure.
            let completion = completion?;
            synced?;
            if let Completion::Interrupted { done, episodes } = completion {
                (self.events)(&Event::Interrupted { done, episodes });
            }
            return Ok(completion);
        }
        let Self { folder, journal, events, .. } = self;
        // Not every system can delete an open file.
        drop(journal);
        folder.remove(JOURNAL)?;
        if let Ok(Completion::Finished { summary, .. }) = &completion {
            events(&Event::Finished { already: false, summary: summary.clone() });
        }
        completion
    }

    fn stages(&mut self) -> Result<Completion, RunError> {
        if let Some(stage) = self.settings.plan.suite.clone() {
            return Ok(match self.suite(&stage)? {
                Some(rounds) => {
                    let summary = Box::new(self.finish(rounds)?);
                    Completion::Finished { summary, boundary: None }
                }
                None => self.interrupted(),
            });
        }
        let points = Points::uniform(&self.settings.plan, &self.space)?;
        if self.stage(&points)? == Progress::Stopped {
            return Ok(self.interrupted());
        }
        drop(points);
        let mut boundary = None;
        if self.settings.plan.boundary.episodes > 0 {
            let report = self.find_boundary()?;
            let points = Points::boundary(&self.settings.plan, &self.space, &report)?;
            if self.stage(&points)? == Progress::Stopped {
                return Ok(self.interrupted());
            }
            boundary = Some(Box::new(report));
        }
        if self.settings.plan.active.is_some() && self.active()? == Progress::Stopped {
            return Ok(self.interrupted());
        }
        Ok(Completion::Finished { summary: Box::new(self.finish(0)?), boundary })
    }

    /// Runs the rounds of the active stage, and writes the report on their models.
    fn active(&mut self) -> Result<Progress, RunError> {
        // The points that other processes have chosen need no model.
        let foresight = if self.chosen.is_empty() { self.executor.foresight()? } else { None };
        // A batch has more episodes in progress than there are processors for the models.
        let processors = thread::available_parallelism().unwrap_or(NonZeroUsize::MIN);
        let threads = NonZeroUsize::new(self.executor.parallelism()).unwrap_or(NonZeroUsize::MIN).min(processors);
        let Some(mut chooser) = Chooser::new(&self.settings.plan, &self.space, foresight, threads) else {
            return Ok(Progress::Complete);
        };
        let mut rounds = Vec::new();
        let (mut number, mut recorded) = (0, 0);
        loop {
            let first = chooser.rounds().get(number).map_or(self.settings.plan.episodes(), |round| round.start);
            for index in recorded..first {
                if let Some(entry) = self.journal.read(index)? {
                    chooser.add(&entry);
                }
            }
            recorded = first;
            let Opened { report: round, points } = match self.chosen.get(number) {
                Some(chosen) => chosen.clone(),
                None => chooser.open(number)?,
            };
            rounds.push(round);
            if points.is_empty() {
                break;
            }
            let points = Points::active(&self.settings.plan, first, points);
            if self.stage(&points)? == Progress::Stopped {
                return Ok(Progress::Stopped);
            }
            number += 1;
        }
        self.folder.write(ACTIVE, &ActiveReport::of(rounds))?;
        Ok(Progress::Complete)
    }

    fn interrupted(&self) -> Completion {
        Completion::Interrupted { done: self.journal.len(), episodes: self.settings.plan.episodes() }
    }

    /// Runs the episodes of one stage that are not in the journal yet.
    fn stage(&mut self, points: &Points) -> Result<Progress, RunError> {
        let stage = points.stage();
        let (mut outcomes, pending) = self.already_done(points)?;
        (self.events)(&Event::StageStarted { stage, episodes: points.len(), already_done: outcomes.clone() });
        if self.run_pending(points, &pending, &mut outcomes)? == Progress::Stopped {
            return Ok(Progress::Stopped);
        }
        self.stage_finished(stage, outcomes)?;
        Ok(Progress::Complete)
    }

    /// Runs the rounds of a suite that are not in the journal yet. Returns the number of rounds, or `None` if the run
    /// was stopped.
    fn suite(&mut self, suite: &SuiteStage) -> Result<Option<u64>, RunError> {
        let points = Points::suite(suite, self.settings.plan.seed);
        let stage = points.stage();
        let (mut outcomes, pending) = self.already_done(&points)?;
        (self.events)(&Event::StageStarted { stage, episodes: points.len(), already_done: outcomes.clone() });
        let mut rounds = 0;
        for number in 0..suite.rounds {
            let indices = suite.indices(number);
            let [first, end] = [indices.start, indices.end].map(|at| pending.partition_point(|index| *index < at));
            if self.run_pending(&points, &pending[first..end], &mut outcomes)? == Progress::Stopped {
                return Ok(None);
            }
            rounds = number + 1;
            let missing = |index| RunError::ForeignEpisode { path: self.folder.path(JOURNAL), index };
            let entries = indices
                .map(|index| self.journal.read(index)?.ok_or_else(|| missing(index)))
                .collect::<Result<Vec<Entry>, RunError>>()?;
            let lost = self.lost()?;
            if (self.after_round)(&Round { number, entries: &entries, lost: &lost }).is_break() {
                break;
            }
        }
        self.stage_finished(stage, outcomes)?;
        Ok(Some(rounds))
    }

    fn run_pending(
        &mut self,
        points: &Points,
        pending: &[u64],
        outcomes: &mut OutcomeCounts,
    ) -> Result<Progress, RunError> {
        let due = outcomes.total() + pending.len() as u64;
        let scenario = |i: usize| points.scenario(*pending.get(i)?);
        let executor = self.executor;
        let mut problem = None;
        let executed = executor.execute(&scenario, &mut |episode| match self
            .record_lost()
            .and_then(|()| self.record(points, episode, outcomes))
        {
            Ok(()) => ControlFlow::Continue(()),
            Err(error) => {
                problem = Some(error);
                ControlFlow::Break(())
            }
        });
        self.record_lost()?;
        executed?;
        if let Some(error) = problem {
            return Err(error);
        }
        Ok(if outcomes.total() < due { Progress::Stopped } else { Progress::Complete })
    }

    /// Records the attempts that infrastructure faults lost.
    fn record_lost(&self) -> Result<(), RunError> {
        match &*self.executor.take_lost() {
            [] => Ok(()),
            lost => self.folder.append(LostEpisode::FILE, lost),
        }
    }

    /// The attempts that infrastructure faults have lost, also those of earlier processes.
    fn lost(&self) -> Result<Vec<LostEpisode>, RunError> {
        LostEpisode::all(self.folder.dir()).map_err(RunError::io(&self.folder.path(LostEpisode::FILE), "read"))
    }

    fn stage_finished(&mut self, stage: Stage, outcomes: OutcomeCounts) -> Result<(), RunError> {
        if let Some(warning) = self.invalid_so_far.warning() {
            (self.events)(&Event::warning(warning));
        }
        // Who records beside the journal makes that safe first: the journal says which episodes need not run again.
        (self.events)(&Event::StageFinished { stage, outcomes });
        Ok(self.journal.sync()?)
    }

    /// Reads the episodes of a stage from the journal: their outcomes, and the missing indices.
    fn already_done(&mut self, points: &Points) -> Result<(OutcomeCounts, Vec<u64>), RunError> {
        let mut outcomes = OutcomeCounts::default();
        let mut pending = Vec::new();
        for index in points.indices() {
            let Some(entry) = self.journal.read(index)? else {
                pending.push(index);
                continue;
            };
            // The same settings give the same points. Otherwise the journal belongs to another campaign, or to a
            // platform with different rounding.
            if Some(&entry.episode.scenario) != points.scenario(index).as_ref() {
                return Err(RunError::ForeignEpisode { path: self.folder.path(JOURNAL), index });
            }
            self.count(points.stage(), &entry.episode, &mut outcomes);
        }
        Ok((outcomes, pending))
    }

    fn count(&mut self, stage: Stage, episode: &Episode, outcomes: &mut OutcomeCounts) {
        outcomes.add(&episode.outcome);
        if stage == Stage::Uniform {
            self.bins.add(&episode.scenario.requested, &episode.outcome);
        }
    }

    fn record(&mut self, points: &Points, episode: Episode, outcomes: &mut OutcomeCounts) -> Result<(), RunError> {
        let index = episode.scenario.index;
        let entry =
            points.entry(episode).ok_or_else(|| RunError::ForeignEpisode { path: self.folder.path(JOURNAL), index })?;
        let stage = points.stage();
        self.journal.append(&entry)?;
        self.count(stage, &entry.episode, outcomes);
        (self.events)(&Event::episode(stage, &entry.episode));
        if let Some(warning) = self.invalid_so_far.add(&entry.episode.outcome) {
            (self.events)(&Event::warning(warning));
        }
        Ok(())
    }

    fn find_boundary(&mut self) -> Result<BoundaryReport, RunError> {
        let report = BoundaryReport::find(&self.settings.plan.boundary, &self.space, &self.bins)?;
        self.folder.write(BOUNDARY, &report)?;
        (self.events)(&Event::BoundaryFound { boundary: report.clone() });
        if report.is_without_evidence() {
            (self.events)(&Event::warning(Warning::NoEvidence));
        }
        Ok(report)
    }

    /// Writes the dictionary and the summary. For a suite, `rounds` is the number of rounds to keep.
    fn finish(&mut self, rounds: u64) -> Result<Summary, RunError> {
        let plan = &self.settings.plan;
        let mut writer = DictionaryWriter::create(&self.folder.path(DICTIONARY), &self.settings.provenance)?;
        let mut summing = Summing::new(plan, &self.settings.provenance.task, &self.space)?;
        for entry in self.journal.ordered() {
            let entry = entry?;
            // An earlier process may have run more rounds, if its closure decided differently.
            if plan.suite.as_ref().is_some_and(|suite| entry.index() >= rounds * suite.scenarios()) {
                break;
            }
            summing.add(&entry);
            writer.push(&entry)?;
        }
        let summary = summing.finish(plan, rounds, writer.finish()?.dataset_hash);
        let summary = Summary { run_again: RunAgain::of(&self.lost()?), ..summary };
        self.folder.write(SUMMARY, &summary)?;
        Ok(summary)
    }
}
