//! Runs a campaign in its folder: start, interrupt, resume, finish.
//!
//! ```text
//! DIR/plan.json            everything the run depends on; written first, never changed
//! DIR/journal.rgj          the episodes of an unfinished run
//! DIR/lost_episodes.jsonl  attempts that an infrastructure fault lost, if there were any
//! DIR/boundary.json        the boundary found by the first stage
//! DIR/active.json          the models of the active stage
//! DIR/dictionary.parquet   the episodes in order of index
//! DIR/summary.json         the summary; written last, then the journal is deleted
//! ```
//!
//! A process that is killed at any moment leaves one of three states: no `plan.json` (nothing has happened), a journal
//! (resume it), or a summary without a journal (finished). Files are replaced atomically. At most the incomplete last
//! record of the journal is lost.

mod error;
mod origin;
mod stages;

use std::ops::ControlFlow;
use std::path::Path;

use robogate_dictionary::{Dictionary, Entry, Journal, Provenance, files, read_text};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

pub use self::error::RunError;
use self::origin::difference;
pub(crate) use self::origin::{known_version, same_origin};
pub(crate) use self::stages::Run;
use crate::folder::{self, BOUNDARY, DICTIONARY, Folder, JOURNAL, LAYOUT, PLAN, SUMMARY};
use crate::{BoundaryReport, Event, Executor, Plan, Round, Summary};

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
    /// The version of the file format.
    pub const VERSION: u32 = 2;

    /// The settings of a new run. This function fills in `plan` and `seed` of `provenance`.
    pub(crate) fn new(plan: &Plan, provenance: Provenance) -> serde_json::Result<Self> {
        let provenance = Provenance { plan: serde_json::to_value(plan)?, seed: plan.seed, ..provenance };
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
        let same = settings.provenance.seed == settings.plan.seed;
        if !plan.is_ok_and(|plan| plan == settings.plan) || !same {
            let source =
                serde::de::Error::custom("`plan` and `provenance.plan` or `provenance.seed` contradict each other");
            return Err(RunError::Unreadable { path: path.to_owned(), source });
        }
        Ok(settings)
    }

    /// Rejects `present` settings that would give other results than these recorded ones.
    pub(crate) fn same(&self, present: &Self) -> Result<(), RunError> {
        same_origin(&self.provenance, &present.provenance)?;
        let values = [self, present].map(|settings| serde_json::to_value(settings).unwrap_or_default());
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
    start_in_rounds(dir, plan, provenance, &[], executor, events, &mut |_| ControlFlow::Continue(()))
}

/// Starts a plan that runs a suite, like [`start`], and calls `after_round` after each round.
///
/// `after_round` gets the rounds in order, each once it is completely recorded. The campaign is finished after the
/// round on which it breaks, or after the plan's last round. Except for the plan itself, the files are then those of a
/// plan with this number of rounds. If the plan has no suite, `after_round` is never called.
///
/// The result of `after_round` must depend only on the entries. Otherwise an interrupted run could end differently from
/// an uninterrupted one.
///
/// `documents` (names and contents) are written before the plan: a folder with a plan has them.
pub fn start_in_rounds(
    dir: &Path,
    plan: &Plan,
    provenance: Provenance,
    documents: &[(&str, &[u8])],
    executor: &dyn Executor,
    events: &mut dyn FnMut(&Event),
    after_round: &mut AfterRound<'_>,
) -> Result<Completion, RunError> {
    let (folder, settings) = begin(dir, plan, provenance, documents)?;
    Run::new(folder, settings, executor, events, after_round)?.run()
}

/// Creates the folder of a campaign with these documents and its plan.
fn begin(
    dir: &Path,
    plan: &Plan,
    provenance: Provenance,
    documents: &[(&str, &[u8])],
) -> Result<(Folder, Settings), RunError> {
    plan.check(&provenance.space)?;
    files::create_folders(dir).map_err(RunError::io(dir, "create"))?;
    let folder = Folder::lock(dir)?;
    let names = folder.names()?;
    not_in_shards(dir)?;
    if names.iter().any(|name| name == PLAN) {
        return Err(RunError::AlreadyARun { dir: dir.to_owned(), finished: is_finished(&folder) });
    }
    // A process that was killed before it wrote the plan has left documents.
    if let Some(name) = names.iter().find(|name| !documents.iter().any(|(document, _)| document == name)) {
        return Err(RunError::NotEmpty { dir: dir.to_owned(), name: name.clone() });
    }
    let settings =
        Settings::new(plan, provenance).map_err(|source| RunError::Unreadable { path: dir.join(PLAN), source })?;
    for (name, content) in documents {
        folder.write_bytes(name, content)?;
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
pub(crate) fn is_finished(folder: &Folder) -> bool {
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
    // A truncated file is not a result.
    Dictionary::open(&folder.path(DICTIONARY))?;
    let boundary = if folder.has(BOUNDARY) { Some(folder::read(&folder.path(BOUNDARY))?) } else { None };
    events(&Event::Finished { already: true, summary: Box::new(summary.clone()) });
    Ok(Some(Completion::Finished { summary: Box::new(summary), boundary }))
}

/// Rejects a campaign in shards, which one process alone must not run.
///
/// # Errors
/// If the folder contains one.
pub fn not_in_shards(dir: &Path) -> Result<(), RunError> {
    if dir.join(LAYOUT).exists() { Err(RunError::InShards { dir: dir.to_owned() }) } else { Ok(()) }
}

/// The closure that gets each round and decides whether another one follows.
pub type AfterRound<'a> = dyn FnMut(&Round<'_>) -> ControlFlow<()> + 'a;
