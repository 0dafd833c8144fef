//! Merges the shards of a campaign to the files of a run on one machine.

use std::cell::RefCell;
use std::ops::ControlFlow;
use std::path::Path;

use robogate_core::{Episode, Fault, FaultKind, Scenario};
use robogate_dictionary::{
    Dictionary, DictionaryError, Entry, Journal, LostEpisode, Platform, Provenance, SCHEMA_VERSION, Tool, files,
};

use super::{DirectoryStore, OpenRound, ShardError, ShardRound, ShardStore, Shards, Stored, put};
use crate::folder::{DICTIONARY, Folder, JOURNAL, PLAN};
use crate::run::{AfterRound, Run, finished, is_finished, same_origin};
use crate::{Bins, Completion, Event, ExecuteError, Executor, OutcomeCounts, Round, RunError};

impl Shards {
    /// Merges all shards into the folder `out`, which may be the campaign's own folder. The files are byte-identical to
    /// those of a run on one machine. A finished merge does not change. If its dictionary is damaged, this is an error.
    ///
    /// All entries are appended to a journal, and the code that finishes any run does the rest. An interrupted merge
    /// can be repeated.
    ///
    /// `events` hears of each round and episode while the shards are read, and then the events of the run that finishes.
    /// `after_round` is that of [`Self::open_round`].
    pub fn merge(
        &self,
        out: &Path,
        events: &mut dyn FnMut(&Event),
        mut after_round: Option<&mut AfterRound<'_>>,
    ) -> Result<Completion, ShardError> {
        self.same_tool()?;
        let files = self.files()?;
        self.check_conflicts(&files)?;
        let (rounds, open) = self.rounds(&files, after_round.as_deref_mut())?;
        if let Some(OpenRound { round, missing }) = open {
            return Err(ShardError::Missing { dir: self.dir(), round, shards: self.shards(), missing });
        }
        let chosen = self.all_chosen()?;
        let folder = self.folder(out)?;
        if is_finished(&folder) {
            check_rows(&folder.path(DICTIONARY))?;
        }
        if let Some(finished) = finished(&folder, events)? {
            return Ok(finished);
        }
        self.fill_journal(&folder, &rounds, events)?;
        let mut all_rounds = |_: &Round<'_>| ControlFlow::Continue(());
        let after_round: &mut AfterRound<'_> = match after_round {
            Some(after_round) => after_round,
            None => &mut all_rounds,
        };
        // An interrupted merge may have written them.
        let lost = if folder.has(LostEpisode::FILE) { Vec::new() } else { self.lost(&files)? };
        let nothing_left = NothingLeft(RefCell::new(lost));
        let run = Run::new(folder, self.settings.clone(), &nothing_left, events, after_round)?;
        let completion = run.with_chosen(chosen).run()?;
        let leftovers = "remove unfinished files of";
        self.store.remove_leftovers().map_err(super::failed(&*self.store, "", leftovers))?;
        let store = DirectoryStore::new(out);
        store.remove_leftovers().map_err(super::failed(&store, "", leftovers))?;
        Ok(completion)
    }

    /// Rejects another version of robogate and another platform, which could write numbers differently.
    ///
    /// The C library and the CPU of this machine do not matter, because a merge runs no physics. Every process that
    /// joined the campaign has compared its own with those of the plan ([`Shards::begin`]).
    fn same_tool(&self) -> Result<(), RunError> {
        let recorded = &self.settings.provenance;
        let here = recorded.platform.clone().map(|platform| {
            let Platform { os, arch, .. } = Platform::here();
            Platform { os, arch, ..platform }
        });
        let present =
            Provenance { tool: Tool::robogate(), schema_version: SCHEMA_VERSION, platform: here, ..recorded.clone() };
        same_origin(recorded, &present)
    }

    /// Locks the output folder, with the plan of the campaign in it.
    fn folder(&self, out: &Path) -> Result<Folder, ShardError> {
        let store = DirectoryStore::new(out);
        store.check_free()?;
        files::create_folders(out).map_err(RunError::io(out, "create"))?;
        let folder = Folder::lock(out)?;
        if put(&store, PLAN, &self.plan_text)? == Stored::Exists && super::existing(&store, PLAN)? != self.plan_text {
            return Err(ShardError::OtherRun { dir: out.to_owned() });
        }
        Ok(folder)
    }

    /// Writes a journal with the entries of all shards. Each round and episode is an event.
    fn fill_journal(
        &self,
        folder: &Folder,
        rounds: &[ShardRound],
        events: &mut dyn FnMut(&Event),
    ) -> Result<(), ShardError> {
        // An interrupted merge left it, or a run with the same plan, whose episodes are the same.
        if folder.has(JOURNAL) {
            folder.remove(JOURNAL)?;
        }
        let mut journal = Journal::create(&folder.path(JOURNAL), &self.plan_hash).map_err(RunError::from)?;
        let mut bins = Bins::of(self.plan(), &self.space).map_err(RunError::from)?;
        for round in rounds {
            let stage = round.stage();
            let episodes = round.indices(self.plan());
            let mut outcomes = OutcomeCounts::default();
            events(&Event::StageStarted {
                stage,
                episodes: episodes.end - episodes.start,
                already_done: outcomes.clone(),
            });
            journal.extend(self.entries(*round).inspect(|entry| {
                let Ok(Entry { episode, .. }) = entry else { return };
                if *round == ShardRound::Uniform {
                    bins.add(&episode.scenario.requested, &episode.outcome);
                }
                outcomes.add(&episode.outcome);
                events(&Event::episode(stage, episode));
            }))?;
            events(&Event::StageFinished { stage, outcomes });
        }
        if rounds.contains(&ShardRound::Boundary) {
            // The boundary that the shards of the second stage used must follow from the first stage.
            self.store_boundary(&bins)?;
        }
        Ok(())
    }
}

/// Reads the dictionary of a finished merge, which has the hash of its rows.
fn check_rows(path: &Path) -> Result<(), ShardError> {
    let read =
        Dictionary::open(path).and_then(|dictionary| dictionary.entries().try_for_each(|entry| entry.map(|_| ())));
    read.map_err(|source| match source {
        DictionaryError::NotADictionary { .. } | DictionaryError::Damaged { .. } => {
            ShardError::DamagedResult { path: path.to_owned(), source: Box::new(source) }
        }
        other => other.into(),
    })
}

/// An executor for a run whose episodes are all recorded, with the attempts that its shards lost.
struct NothingLeft(RefCell<Vec<LostEpisode>>);

impl Executor for NothingLeft {
    fn parallelism(&self) -> usize {
        0
    }

    fn execute(
        &self,
        scenario: &(dyn Fn(usize) -> Option<Scenario> + Sync),
        _: &mut dyn FnMut(Episode) -> ControlFlow<()>,
    ) -> Result<(), ExecuteError> {
        match scenario(0) {
            None => Ok(()),
            Some(Scenario { index, .. }) => {
                Err(ExecuteError::Worker(Fault::new(FaultKind::Setup, format!("no shard has episode {index}"))))
            }
        }
    }

    fn take_lost(&self) -> Vec<LostEpisode> {
        self.0.take()
    }
}
