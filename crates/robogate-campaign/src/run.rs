//! Runs a campaign in its folder: start, interrupt, resume, finish.
//!
//! ```text
//! DIR/plan.json            everything the run depends on; written first, never changed
//! DIR/journal.rgj          the episodes of an unfinished run
//! DIR/lost_episodes.jsonl  attempts that an infrastructure fault lost, if there were any
//! DIR/boundary.json        the boundary found by the first stage
//! DIR/prior.json           the episodes from which the risk model of the active stage starts, if the plan has a prior
//! DIR/active.json          the models of the active stage
//! DIR/dictionary.parquet   the episodes in order of index
//! DIR/summary.json         the summary; written last, then the journal is deleted
//! ```
//!
//! A process that is killed at any moment leaves one of three states: no `plan.json` (nothing has happened), a journal
//! (resume it), or a summary without a journal (finished). Files are replaced atomically. At most the incomplete last
//! record of the journal is lost.

use std::io;
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use robogate_core::{DesignError, Episode, ParameterSpace};
use robogate_dictionary::{
    Dictionary, DictionaryError, DictionaryWriter, Entry, Journal, Platform, Provenance, Recovery, read_text,
};
use robogate_risk::RiskError;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::Value;

use crate::active::{Chooser, Opened};
use crate::folder::{self, ACTIVE, BOUNDARY, DICTIONARY, Folder, JOURNAL, LAYOUT, LOST, PLAN, PRIOR, SUMMARY};
use crate::invalid::MostlyInvalid;
use crate::summary::Summing;
use crate::{
    ActiveReport, ActiveStage, Bins, BoundaryReport, Event, ExecuteError, Executor, OutcomeCounts, Plan, PlanError,
    Points, Prior, Round, RunAgain, Stage, SuiteStage, Summary, Warning,
};

/// The content of `plan.json`: everything that the results of a run depend on.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Settings {
    /// The version of the file format.
    pub version: u32,
    /// The plan of the campaign.
    pub plan: Plan,
    /// Tool, engine, robot, policy, space and platform. The dictionary stores it as well.
    pub provenance: Provenance,
}

impl Settings {
    /// The version of the file format that is written, and the newest one that is read.
    pub const VERSION: u32 = 2;

    /// The settings of a new run. This function fills in `plan`, `seed` and `fidelity` of `provenance`.
    pub(crate) fn new(plan: &Plan, provenance: Provenance) -> serde_json::Result<Self> {
        let (seed, fidelity) = (plan.seed, plan.fidelity);
        let provenance = Provenance { plan: serde_json::to_value(plan)?, seed, fidelity, ..provenance };
        Ok(Self { version: Self::VERSION, plan: plan.clone(), provenance })
    }

    /// Parses the content of the file `path`.
    pub(crate) fn parse(path: &Path, text: &[u8]) -> Result<Self, RunError> {
        /// The version alone, because a later format may differ in everything else.
        #[derive(Deserialize)]
        struct Version {
            version: u32,
        }
        let Version { version } = folder::parse(path, text)?;
        known_version(path, version, Self::VERSION)?;
        let settings: Self = folder::parse(path, text)?;
        // The provenance, which the dictionary stores, contains the plan as well. Both must agree.
        let plan = serde_json::from_value::<Plan>(settings.provenance.plan.clone());
        let same =
            settings.provenance.seed == settings.plan.seed && settings.provenance.fidelity == settings.plan.fidelity;
        if !plan.is_ok_and(|plan| plan == settings.plan) || !same {
            let source = serde::de::Error::custom(
                "`plan` and `provenance.plan`, `provenance.seed` or `provenance.fidelity` contradict each other",
            );
            return Err(RunError::Unreadable { path: path.to_owned(), source });
        }
        Ok(settings)
    }

    /// Rejects `present` settings that would give other results than these recorded ones.
    pub(crate) fn same(&self, present: &Self) -> Result<(), RunError> {
        same_origin(&self.provenance, &present.provenance)?;
        let present = Self { provenance: present.provenance.clone().as_known_in(&self.provenance), ..present.clone() };
        let values = [self, &present].map(|settings| serde_json::to_value(settings).unwrap_or_default());
        let [recorded, present] = &values;
        for part in ["plan", "provenance"] {
            if let Some((what, recorded, present)) = difference(part.to_owned(), &recorded[part], &present[part]) {
                return Err(RunError::Mismatch { what, recorded, present });
            }
        }
        Ok(())
    }
}

/// How a run ended.
#[derive(Debug, Clone, PartialEq)]
pub enum Completion {
    /// Every episode ran and every file is written.
    Finished {
        /// The summary of the campaign.
        summary: Box<Summary>,
        /// The boundary found by the first stage, if there was a second stage.
        boundary: Option<Box<BoundaryReport>>,
    },
    /// The run was stopped. [`resume`] continues it.
    Interrupted {
        /// The number of recorded episodes.
        done: u64,
        /// Episodes of the whole campaign.
        episodes: u64,
    },
}

/// Starts a campaign in the folder `dir`, which must be empty or not exist, and runs it.
///
/// This function fills in `plan` and `seed` of `provenance`.
pub fn start(
    dir: &Path,
    plan: &Plan,
    provenance: Provenance,
    executor: &dyn Executor,
    events: &mut dyn FnMut(&Event),
) -> Result<Completion, RunError> {
    start_in_rounds(dir, plan, provenance, executor, events, &mut |_| ControlFlow::Continue(()))
}

/// Starts a campaign whose plan names `prior`, like [`start`].
pub fn start_from(
    dir: &Path,
    plan: &Plan,
    provenance: Provenance,
    prior: &Prior,
    executor: &dyn Executor,
    events: &mut dyn FnMut(&Event),
) -> Result<Completion, RunError> {
    let (folder, settings) = begin(dir, plan, provenance, Some(prior))?;
    Run::new(folder, settings, executor, events, &mut |_| ControlFlow::Continue(()))?.run()
}

/// Starts a plan that runs a suite, like [`start`], and calls `after_round` after each round.
///
/// `after_round` gets the rounds in order, each once it is completely recorded. The campaign is finished after the
/// round on which it breaks, or after the plan's last round. Except for the plan itself, the files are then those of a
/// plan with this number of rounds. If the plan has no suite, `after_round` is never called.
///
/// The result of `after_round` must depend only on the entries. Otherwise an interrupted run could end differently from
/// an uninterrupted one.
pub fn start_in_rounds(
    dir: &Path,
    plan: &Plan,
    provenance: Provenance,
    executor: &dyn Executor,
    events: &mut dyn FnMut(&Event),
    after_round: &mut AfterRound<'_>,
) -> Result<Completion, RunError> {
    let (folder, settings) = begin(dir, plan, provenance, None)?;
    Run::new(folder, settings, executor, events, after_round)?.run()
}

/// Creates the folder of a campaign with its prior and its plan.
fn begin(
    dir: &Path,
    plan: &Plan,
    provenance: Provenance,
    prior: Option<&Prior>,
) -> Result<(Folder, Settings), RunError> {
    plan.check(&provenance.space)?;
    std::fs::create_dir_all(dir).map_err(RunError::io(dir, "create"))?;
    let folder = Folder::lock(dir)?;
    let names = folder.names()?;
    not_in_shards(dir)?;
    if names.iter().any(|name| name == PLAN) {
        return Err(RunError::AlreadyARun { dir: dir.to_owned(), finished: is_finished(&folder) });
    }
    if let Some(name) = names.first() {
        return Err(RunError::NotEmpty { dir: dir.to_owned(), name: name.clone() });
    }
    let settings =
        Settings::new(plan, provenance).map_err(|source| RunError::Unreadable { path: dir.join(PLAN), source })?;
    match (&settings.plan.active, prior) {
        (Some(ActiveStage { prior: Some(named), .. }), Some(prior)) => {
            let path = folder.path(PRIOR);
            let text = prior.document().map_err(|source| RunError::Unreadable { path: path.clone(), source })?;
            Prior::parse(&path, &text, named)?;
            folder.write_bytes(PRIOR, &text)?;
        }
        (Some(ActiveStage { prior: Some(_), .. }), None) => return Err(RunError::NoPrior),
        _ if folder.has(PRIOR) => folder.remove(PRIOR)?,
        _ => {}
    }
    folder.write(PLAN, &settings)?;
    Ok((folder, settings))
}

/// Resumes the campaign in `dir`. The resulting files are byte-identical to those of an uninterrupted run. A finished
/// campaign does not change.
///
/// `provenance` describes the present setup. If its tool, engine, robot, policy, world, space or platform differ from
/// those of the recorded run, the function returns an error, because the remaining episodes would belong to another
/// campaign.
pub fn resume(
    dir: &Path,
    provenance: &Provenance,
    executor: &dyn Executor,
    events: &mut dyn FnMut(&Event),
) -> Result<Completion, RunError> {
    resume_in_rounds(dir, provenance, executor, events, &mut |_| ControlFlow::Continue(()))
}

/// Resumes a run of [`start_in_rounds`], like [`resume`]. `after_round` gets every round again, from the first on. It
/// is not called if the campaign is finished.
pub fn resume_in_rounds(
    dir: &Path,
    provenance: &Provenance,
    executor: &dyn Executor,
    events: &mut dyn FnMut(&Event),
    after_round: &mut AfterRound<'_>,
) -> Result<Completion, RunError> {
    let settings = settings(dir)?;
    let folder = Folder::lock(dir)?;
    if let Some(finished) = finished(&folder, events)? {
        return Ok(finished);
    }
    not_in_shards(dir)?;
    same_origin(&settings.provenance, provenance)?;
    settings.plan.check(&settings.provenance.space)?;
    Run::new(folder, settings, executor, events, after_round)?.run()
}

/// Reads the settings of the run in `dir`, which are needed to create workers for [`resume`] or a replay.
pub fn settings(dir: &Path) -> Result<Settings, RunError> {
    if !dir.join(PLAN).is_file() {
        return Err(RunError::NotARun { dir: dir.to_owned() });
    }
    let path = dir.join(PLAN);
    let text = read_text(&path).map_err(RunError::io(&path, "read"))?;
    Settings::parse(&path, text.as_bytes())
}

/// Reads episode `index` of the run in `dir`, finished or not: its scenario and its outcome, for a replay.
pub fn recorded(dir: &Path, index: u64) -> Result<Entry, RunError> {
    let settings = settings(dir)?;
    let folder = Folder::lock(dir)?;
    let missing = || RunError::NoSuchEpisode { dir: dir.to_owned(), index, episodes: settings.plan.episodes() };
    if index >= settings.plan.episodes() {
        return Err(missing());
    }
    if folder.has(JOURNAL) {
        let (mut journal, _) = Journal::open(&folder.path(JOURNAL), &folder.plan_hash()?)?;
        return journal.read(index)?.ok_or_else(missing);
    }
    if !folder.has(DICTIONARY) {
        return Err(missing());
    }
    for entry in Dictionary::open(&folder.path(DICTIONARY))?.entries() {
        let entry = entry?;
        if entry.index() == index {
            return Ok(entry);
        }
    }
    Err(missing())
}

/// The journal is deleted last. A summary without a journal means that all files are complete.
fn is_finished(folder: &Folder) -> bool {
    folder.has(SUMMARY) && folder.has(DICTIONARY) && !folder.has(JOURNAL)
}

/// The result of a finished run, if the folder contains one.
pub(crate) fn finished(folder: &Folder, events: &mut dyn FnMut(&Event)) -> Result<Option<Completion>, RunError> {
    if !is_finished(folder) {
        return Ok(None);
    }
    let path = folder.path(SUMMARY);
    let summary: Summary = folder::read(&path)?;
    known_version(&path, summary.version, Summary::VERSION)?;
    let boundary = if folder.has(BOUNDARY) { Some(folder::read(&folder.path(BOUNDARY))?) } else { None };
    events(&Event::Finished { already: true, summary: Box::new(summary.clone()) });
    Ok(Some(Completion::Finished { summary: Box::new(summary), boundary }))
}

/// Rejects a campaign in shards, which one process alone must not run.
fn not_in_shards(dir: &Path) -> Result<(), RunError> {
    if dir.join(LAYOUT).exists() { Err(RunError::InShards { dir: dir.to_owned() }) } else { Ok(()) }
}

pub(crate) fn known_version(path: &Path, found: u32, known: u32) -> Result<(), RunError> {
    if found > known {
        return Err(RunError::NewerVersion { path: path.to_owned(), found, known });
    }
    Ok(())
}

/// Rejects a setup that differs from the one of the recorded run.
pub(crate) fn same_origin(recorded: &Provenance, present: &Provenance) -> Result<(), RunError> {
    let text = |value: &Option<String>| value.clone().unwrap_or_else(|| "unknown".to_owned());
    let of = |p: &Provenance| {
        [
            ("tool", p.tool.name.clone()),
            ("tool version", p.tool.version.clone()),
            ("dictionary schema", p.schema_version.to_string()),
            ("engine", p.engine.name.clone()),
            ("engine version", text(&p.engine.version)),
            ("engine build", text(&p.engine.build_sha256)),
            ("robot", p.robot.name.clone()),
            ("robot files", text(&p.robot.sha256)),
            ("policy", p.policy.clone()),
        ]
    };
    for ((what, recorded), (_, present)) in of(recorded).into_iter().zip(of(present)) {
        if recorded != present {
            return Err(RunError::Mismatch { what: what.to_owned(), recorded, present });
        }
    }
    // Files of version 0.2 do not record the C library, the CPU and the build. Properties that are not recorded are not
    // compared.
    let known = |p: &Provenance| {
        let platform = p.platform.as_ref().map_or_else(|| vec![("platform", text(&None))], Platform::properties);
        let build = p.build.as_ref().map(|build| ("source files of robogate", build.source_sha256.clone()));
        platform.into_iter().chain(build).collect::<Vec<_>>()
    };
    let properties = known(present);
    for (what, recorded) in known(recorded) {
        let found = properties.iter().find(|(name, _)| *name == what);
        let present = found.map_or_else(|| text(&None), |(_, value)| value.clone());
        if recorded != present {
            return Err(RunError::Mismatch { what: what.to_owned(), recorded, present });
        }
    }
    let task = |p: &Provenance| serde_json::to_value(&*p.task).unwrap_or_default();
    let worlds = [("world", recorded.world.clone(), present.world.clone()), ("task", task(recorded), task(present))];
    for (name, recorded, present) in worlds {
        if let Some((what, recorded, present)) = difference(name.to_owned(), &recorded, &present) {
            return Err(RunError::Mismatch { what, recorded, present });
        }
    }
    if recorded.space != present.space {
        let name = |space: &ParameterSpace| format!("`{}`", space.name());
        let (recorded, present) = (name(&recorded.space), name(&present.space));
        return Err(RunError::Mismatch { what: "parameter space".to_owned(), recorded, present });
    }
    Ok(())
}

/// The first difference between two settings: its name and both values.
fn difference(name: String, recorded: &Value, present: &Value) -> Option<(String, String, String)> {
    match (recorded, present) {
        (Value::Object(a), Value::Object(b)) => a.keys().chain(b.keys()).find_map(|key| {
            let of = |object: &serde_json::Map<String, Value>| object.get(key).cloned().unwrap_or_default();
            difference(format!("{name}.{key}"), &of(a), &of(b))
        }),
        _ if recorded == present => None,
        _ => Some((name, recorded.to_string(), present.to_string())),
    }
}

/// The closure that gets each round and decides whether another one follows.
pub type AfterRound<'a> = dyn FnMut(&Round<'_>) -> ControlFlow<()> + 'a;

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
        if recovery.without_plan {
            events(&Event::warning(Warning::JournalWithoutPlan));
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
        let (foresight, prior) =
            if self.chosen.is_empty() { (self.executor.foresight()?, self.prior()?) } else { (None, None) };
        let Some(mut chooser) = Chooser::new(&self.settings.plan, &self.space, foresight, prior.as_ref())? else {
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

    /// The episodes from which the risk model starts, if the plan has a prior.
    fn prior(&self) -> Result<Option<Prior>, RunError> {
        let Some(named) = self.settings.plan.active.as_ref().and_then(|stage| stage.prior.as_ref()) else {
            return Ok(None);
        };
        let path = self.folder.path(PRIOR);
        let text = read_text(&path).map_err(RunError::io(&path, "read"))?;
        Prior::parse(&path, text.as_bytes(), named).map(Some)
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
            if (self.after_round)(&Round { number, entries: &entries }).is_break() {
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
            lost => self.folder.append(LOST, lost),
        }
    }

    fn stage_finished(&mut self, stage: Stage, outcomes: OutcomeCounts) -> Result<(), RunError> {
        self.journal.sync()?;
        if let Some(warning) = self.invalid_so_far.warning() {
            (self.events)(&Event::warning(warning));
        }
        (self.events)(&Event::StageFinished { stage, outcomes });
        Ok(())
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
            let stage = match &plan.suite {
                // An earlier process may have run more rounds, if its closure decided differently.
                Some(suite) if entry.index() >= rounds * suite.scenarios() => break,
                Some(_) => Stage::Suite,
                None if entry.index() < plan.uniform.episodes => Stage::Uniform,
                None if plan.active.is_some() => Stage::Active,
                None => Stage::Boundary,
            };
            summing.add(stage, &entry);
            writer.push(&entry)?;
        }
        let summary = summing.finish(plan, rounds, writer.finish()?.dataset_hash);
        let summary = Summary { run_again: RunAgain::of(&self.folder)?, ..summary };
        self.folder.write(SUMMARY, &summary)?;
        Ok(summary)
    }
}

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
    #[error("{} is not empty (it contains `{name}`) and is not a robogate run\nhint: choose an empty or new folder", dir.display())]
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
        "{} contains a campaign in shards\nhint: `robogate plan {0} --next` prints the missing shards, and `robogate merge {0}` merges them", dir.display()
    )]
    InShards {
        /// The folder.
        dir: PathBuf,
    },
    /// The folder contains no run.
    #[error("{} is not a robogate run: it has no {PLAN}\nhint: check the path, or start a run with `robogate run --out DIR`", dir.display())]
    NotARun {
        /// The folder.
        dir: PathBuf,
    },
    /// Another process uses the folder.
    #[error("{} is in use by another process\nhint: only one process at a time can run or resume a campaign", dir.display())]
    Locked {
        /// The folder.
        dir: PathBuf,
    },
    /// A file of the run cannot be parsed.
    #[error("{}: {source}\nhint: robogate writes this file, and it must not be edited; restore it from a copy", path.display())]
    Unreadable {
        /// The file.
        path: PathBuf,
        /// The problem and its position.
        source: serde_json::Error,
    },
    /// A file of the run was written by a later version of robogate.
    #[error("{} has format version {found}, but this robogate reads versions up to {known}\nhint: upgrade robogate; nothing was changed", path.display())]
    NewerVersion {
        /// The file.
        path: PathBuf,
        /// The version of the file.
        found: u32,
        /// The newest known version.
        known: u32,
    },
    /// The present setup differs from that of the run.
    #[error(
        "the run was started with another {what}: {recorded}, now {present}\nhint: resume it with the original {what}, or start a new run; episodes of both cannot be compared"
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
    #[error("{}: episode {index} does not match the plan\nhint: the journal belongs to another run, or was started on another platform", path.display())]
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
    #[error("{} has no record of episode {index}. The campaign has {episodes} episodes, counted from 0; an unfinished campaign lacks some of them", dir.display())]
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
    /// The plan names a prior that was not given.
    #[error(
        "the plan has `active.prior`, whose episodes are not given\nhint: remove it from the plan, and add --prior RUN"
    )]
    NoPrior,
    /// No model can be fitted to the prior.
    #[error("prior: {source}\nhint: choose another run, or leave out --prior")]
    Prior {
        /// The reason.
        source: RiskError,
    },
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
        format!("{dir} already contains a finished run\nhint: choose another folder")
    } else {
        format!(
            "{dir} contains an unfinished run\nhint: resume it with `robogate resume {dir}`, or choose another folder"
        )
    }
}

fn io_hint(source: &io::Error) -> &'static str {
    match source.kind() {
        io::ErrorKind::StorageFull | io::ErrorKind::QuotaExceeded => {
            "\nhint: free space on that disk, then resume; recorded episodes are intact"
        }
        io::ErrorKind::PermissionDenied | io::ErrorKind::ReadOnlyFilesystem => {
            "\nhint: choose a folder with write permission"
        }
        _ => "",
    }
}
