//! The processing of incoming cycles.
//!
//! | cycle | processing |
//! |---|---|
//! | new | written to disk, then passed to the detectors, then acknowledged |
//! | duplicate (known id, same content) | acknowledged, not counted again |
//! | contradictory (known id, other content) | refused |
//! | out of order (older than the newest of its robot, on the sender's clock) | as new, in the order of arrival, and counted |
//! | late (older than that by more than `late_after_s`) | as out of order, and counted as late |
//! | malformed | refused, with its line and the problem; the rest of its batch is processed |
//!
//! Late cycles are processed, so that a robot whose clock once jumped ahead is still monitored.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;
use std::time::Instant;

use serde::Serialize;

use super::batch::{Batch, LISTED, TooManyLines};
use super::nearest::Episodes;
use super::newcomers::Newcomers;
use super::senders::{Found, Senders, Trouble};
use super::settings::ServiceSettings;
use super::store::{Kept, Store, StoreError};
use super::warnings::{HeardPeriods, Periods, Warnings};
use crate::warn::{WarnError, WarnFile};
use crate::{Alarm, Cycle, Monitor};

/// Number of cycles of a recipe after which its state is written.
const STATE_EVERY: u64 = 5_000;
/// Number of recipes whose states are written together before old cycles are deleted.
const STATES_AT_ONCE: usize = 8;
/// Maximum number of robots whose newest time is stored. Cycles of further robots are never late.
const MOST_ROBOTS: usize = 100_000;

/// The error of a batch of which no cycle was accepted.
#[derive(Debug, thiserror::Error)]
pub enum IntakeError {
    /// The store failed. No cycle of the batch was stored.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// A batch has too many lines. No cycle was stored.
    #[error(transparent)]
    TooManyLines(#[from] TooManyLines),
}

/// The result of a batch.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize)]
pub struct Taken {
    /// Number of new cycles, which are now on disk.
    pub accepted: u64,
    /// Number of known cycles.
    pub duplicates: u64,
    /// Accepted cycles that are older than the newest of their robot.
    pub out_of_order: u64,
    /// Those of them that are older by more than `late_after_s`.
    pub late: u64,
    /// Accepted cycles outside the validated region.
    pub outside: u64,
    /// How often ids are missing between accepted cycles.
    pub gaps: u64,
    /// Number of refused cycles.
    pub refused: u64,
    /// The first hundred refusals.
    pub refusals: Vec<Refused>,
}

/// Maximum length of a problem in a reply, in bytes. A problem can quote the line.
pub(super) const LONGEST_PROBLEM: usize = 300;

/// A refused cycle, or control period.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Refused {
    /// Its line, from 1.
    pub line: u64,
    /// The problem.
    pub because: String,
}

impl Refused {
    /// A refusal of a line, with the beginning of its problem.
    pub(super) fn new(line: u64, mut because: String) -> Self {
        because.truncate(because.floor_char_boundary(LONGEST_PROBLEM));
        Self { line, because }
    }
}

impl Taken {
    fn refuse(&mut self, line: u64, because: String) {
        self.refused += 1;
        // Twice as many, because the malformed lines are listed already and the first of all are wanted.
        if self.refusals.len() < 2 * LISTED {
            self.refusals.push(Refused { line, because });
        }
    }

    /// Adds the counts of another batch. Its refusals are not listed again.
    pub fn add(&mut self, other: &Self) {
        self.accepted += other.accepted;
        self.duplicates += other.duplicates;
        self.out_of_order += other.out_of_order;
        self.late += other.late;
        self.outside += other.outside;
        self.gaps += other.gaps;
        self.refused += other.refused;
    }
}

/// The progress of a recipe.
#[derive(Debug, Clone, Copy, Default)]
struct Progress {
    /// Its last cycle.
    last: u64,
    /// The last cycle in its state on disk.
    written: u64,
    /// Its cycles since then.
    since: u64,
}

/// The store and the monitor. All cycles pass through here.
#[derive(Debug)]
pub struct Intake {
    store: Store,
    monitor: Monitor,
    late_after_s: f64,
    newest_time: BTreeMap<String, f64>,
    progress: BTreeMap<String, Progress>,
    newest: u64,
    /// Alarms that are not on disk yet.
    unwritten: Vec<Alarm>,
    /// The sum of all results since the start.
    totals: Taken,
    senders: Senders,
    newcomers: Newcomers,
    /// The detector of warnings within episodes.
    warnings: Option<Warnings>,
    /// Simulated episodes, to compare cycles with: those of one recipe, and under `None` those of all others.
    episodes: BTreeMap<Option<String>, Arc<Episodes>>,
}

impl Intake {
    /// The same intake with simulated episodes for one recipe, or for all recipes without their own. The page compares
    /// failed cycles with them.
    #[must_use]
    pub fn with_episodes(mut self, recipe: Option<String>, episodes: Arc<Episodes>) -> Self {
        self.episodes.insert(recipe, episodes);
        self
    }

    /// The same intake with another limit on the new recipes of each sender in a network.
    #[must_use]
    pub fn with_new_recipes_per_hour(self, most: u32) -> Self {
        Self { newcomers: Newcomers::new(most), ..self }
    }

    /// The same intake with a detector of warnings within episodes. `sha256` (hex) is that of its file.
    ///
    /// # Errors
    /// If the store cannot be read. The inner error is that of a damaged detector.
    pub fn with_warner(mut self, file: WarnFile, sha256: String) -> Result<Result<Self, WarnError>, IntakeError> {
        Ok(Warnings::open(file, sha256, &self.store)?.map(|warnings| {
            self.warnings = Some(warnings);
            self
        }))
    }

    /// The warnings within episodes.
    pub(super) fn warnings(&self) -> Option<&Warnings> {
        self.warnings.as_ref()
    }

    /// Processes control periods. `None` without a detector.
    ///
    /// # Errors
    /// If the store failed. The periods are processed in any case, and their alarms are written with the next ones.
    pub fn hear_periods(&mut self, periods: Periods) -> Result<Option<HeardPeriods>, IntakeError> {
        let Some(warnings) = &mut self.warnings else { return Ok(None) };
        let (heard, ended) = warnings.hear(periods, &self.monitor, &mut |alarm| self.unwritten.push(alarm));
        if ended || !self.unwritten.is_empty() {
            self.store.together(|| {
                warnings.keep(&self.store)?;
                self.store.add_alarms(&self.unwritten)
            })?;
            self.unwritten.clear();
        }
        Ok(Some(heard))
    }

    /// The simulated episodes of a recipe.
    pub(super) fn episodes(&self, recipe: &str) -> Option<&Episodes> {
        let own = self.episodes.get(&Some(recipe.to_owned()));
        own.or_else(|| self.episodes.get(&None)).map(Arc::as_ref)
    }

    /// Restores each recipe's state from the store, then processes the later cycles.
    ///
    /// # Errors
    /// If the store cannot be read.
    pub fn open(store: Store, mut monitor: Monitor, late_after_s: f64) -> Result<Self, IntakeError> {
        let mut progress = BTreeMap::new();
        for (name, seq, state) in store.recipes()? {
            monitor.restore(&name, state);
            progress.insert(name, Progress { last: seq, written: seq, since: 0 });
        }
        let mut alarms = Vec::new();
        store.unprocessed(|seq, cycle| {
            // A recipe beyond the limit was accepted with other settings. It stays on disk.
            if monitor.observe(cycle, &mut |alarm| alarms.push(alarm)).is_ok() {
                note(&mut progress, &cycle.recipe, seq);
            }
        })?;
        store.together(|| store.add_alarms(&alarms))?;
        let newest = store.newest()?;
        let newest_time = store.robots(MOST_ROBOTS)?.into_iter().collect();
        Ok(Self {
            store,
            monitor,
            late_after_s,
            newest_time,
            progress,
            newest,
            unwritten: Vec::new(),
            totals: Taken::default(),
            senders: Senders::default(),
            newcomers: Newcomers::new(ServiceSettings::default().new_recipes_per_hour),
            warnings: None,
            episodes: BTreeMap::new(),
        })
    }

    /// Parses and processes several batches with one commit, like [`Self::take_parsed`].
    ///
    /// # Errors
    /// As [`Self::take_parsed`], and if a batch has too many lines.
    pub fn take(&mut self, batches: &[&[u8]]) -> Result<Vec<Taken>, IntakeError> {
        let batches = batches.iter().map(|batch| Batch::parse(batch)).collect::<Result<Vec<_>, _>>()?;
        self.take_parsed(batches)
    }

    /// Processes several batches with one commit. Accepted cycles are on disk when this returns.
    ///
    /// # Errors
    /// If the store failed. No cycle of any batch was stored or processed.
    pub fn take_parsed(&mut self, batches: Vec<Batch>) -> Result<Vec<Taken>, IntakeError> {
        let mut fresh = Fresh::default();
        self.store.begin()?;
        let taken: Result<Vec<Taken>, StoreError> =
            batches.into_iter().map(|batch| self.keep(batch, &mut fresh)).collect();
        let taken = match taken.and_then(|taken| self.store.commit().map(|()| taken)) {
            Ok(taken) => taken,
            Err(error) => {
                self.store.roll_back();
                return Err(error.into());
            }
        };
        Ok(self.hear(taken, fresh)?)
    }

    /// Writes one batch into the transaction.
    fn keep(&mut self, batch: Batch, fresh: &mut Fresh) -> Result<Taken, StoreError> {
        let Batch { cycles, malformed, problems, sender, .. } = batch;
        let from = sender.as_ref().map_or("the feed", |(name, _)| name).to_owned();
        if let Some(first) = problems.first() {
            let sender = from.clone();
            let time_s = self.newest_time.values().copied().fold(0.0, f64::max);
            let what = if malformed == 1 {
                "1 line is not a cycle".to_owned()
            } else {
                format!("{malformed} lines are not cycles")
            };
            let because = format!("{what}; line {}: {}", first.line, first.because);
            let (place, recipe) = (format!("line {}", first.line), "*".to_owned());
            fresh.found.push(Found { trouble: Trouble::Refused, sender, recipe, place, time_s, because });
        }
        fresh.from.push(from);
        let mut taken = Taken { refused: malformed, refusals: problems, ..Taken::default() };
        for (line, cycle, text) in cycles {
            if let Err(because) = self.has_room(&cycle.recipe, sender.as_ref(), fresh) {
                fresh.found.push(Found::of(Trouble::Refused, &cycle, because.clone()));
                taken.refuse(line, because);
                continue;
            }
            match self.store.add(&cycle, &text)? {
                Kept::New(seq) => {
                    taken.accepted += 1;
                    fresh.cycles.push((seq, cycle));
                }
                Kept::Same => taken.duplicates += 1,
                Kept::Other => {
                    let because = format!("the id `{}` is already stored with other content", cycle.id);
                    fresh.found.push(Found::of(Trouble::Restarted, &cycle, because.clone()));
                    taken.refuse(line, because);
                }
            }
        }
        taken.refusals.sort_by_key(|refused| refused.line);
        taken.refusals.truncate(LISTED);
        Ok(taken)
    }

    /// Checks that a recipe can be monitored, including the new recipes of this commit.
    fn has_room(&mut self, recipe: &str, sender: Option<&(String, Instant)>, fresh: &mut Fresh) -> Result<(), String> {
        if self.monitor.recipe(recipe).is_none() && !fresh.recipes.contains(recipe) {
            self.monitor.has_room(recipe, fresh.recipes.len()).map_err(|full| full.to_string())?;
            if let Some((sender, now)) = sender {
                self.newcomers.admit(sender, recipe, *now).map_err(|many| many.to_string())?;
            }
            fresh.recipes.insert(recipe.to_owned());
        }
        Ok(())
    }

    /// Passes the cycles that are now on disk to the detectors.
    fn hear(&mut self, mut taken: Vec<Taken>, fresh: Fresh) -> Result<Vec<Taken>, StoreError> {
        let mut alarms: Vec<Alarm> = Vec::new();
        let Fresh { cycles, from, found, .. } = fresh;
        let mut fresh = cycles.into_iter();
        let mut due = BTreeSet::new();
        for (taken, from) in taken.iter_mut().zip(&from) {
            for (seq, cycle) in fresh.by_ref().take(taken.accepted as usize) {
                self.clock(&cycle, taken);
                self.newest = seq;
                taken.gaps += u64::from(self.senders.accept(&cycle, from, &mut |alarm| alarms.push(alarm)));
                // There is space: it was checked before the write.
                if let Ok(judged) = self.monitor.observe(&cycle, &mut |alarm| alarms.push(alarm)) {
                    taken.outside += u64::from(judged.outside == Some(true));
                }
                if note(&mut self.progress, &cycle.recipe, seq) >= STATE_EVERY {
                    due.insert(cycle.recipe);
                }
            }
            self.totals.add(taken);
        }
        found.into_iter().for_each(|found| self.senders.raise(found, &mut |alarm| alarms.push(alarm)));
        // Everything below follows from the cycles on disk. If it cannot be written now, a restart writes it.
        self.unwritten.append(&mut alarms);
        if !self.unwritten.is_empty() {
            self.store.together(|| self.store.add_alarms(&self.unwritten))?;
            self.unwritten.clear();
        }
        self.keep_recipes(due.into_iter().collect())?;
        self.sweep()?;
        Ok(taken)
    }

    fn clock(&mut self, cycle: &Cycle, taken: &mut Taken) {
        if let Some(newest) = self.newest_time.get_mut(cycle.robot.as_str()) {
            taken.out_of_order += u64::from(cycle.time_s < *newest);
            taken.late += u64::from(cycle.time_s < *newest - self.late_after_s);
            *newest = newest.max(cycle.time_s);
        } else if self.newest_time.len() < MOST_ROBOTS {
            self.newest_time.insert(cycle.robot.clone(), cycle.time_s);
        }
    }

    fn keep_recipe(&mut self, name: &str) -> Result<(), StoreError> {
        if let (Some(recipe), Some(progress)) = (self.monitor.recipe(name), self.progress.get_mut(name)) {
            self.store.keep_recipe(name, progress.last, recipe.state())?;
            *progress = Progress { last: progress.last, written: progress.last, since: 0 };
        }
        Ok(())
    }

    /// Writes every recipe's state, so that the next start does not process cycles again.
    ///
    /// # Errors
    /// If the store failed. The cycles are on disk in any case.
    pub fn close(&mut self) -> Result<(), IntakeError> {
        Ok(self.keep_recipes(self.behind(u64::MAX))?)
    }

    /// Recipes with cycles up to this number that their state on disk does not contain.
    fn behind(&self, up_to: u64) -> Vec<String> {
        let behind = self.progress.iter().filter(|(_, progress)| progress.since > 0 && progress.written < up_to);
        behind.map(|(name, _)| name.clone()).collect()
    }

    /// Writes the states of some recipes, all or none.
    fn keep_recipes(&mut self, names: Vec<String>) -> Result<(), StoreError> {
        if names.is_empty() {
            return Ok(());
        }
        let before: Vec<Option<Progress>> = names.iter().map(|name| self.progress.get(name).copied()).collect();
        self.store.begin()?;
        let kept = names.iter().try_for_each(|name| self.keep_recipe(name)).and_then(|()| self.store.commit());
        if kept.is_err() {
            self.store.roll_back();
            let before = names.into_iter().zip(before).filter_map(|(name, progress)| Some((name, progress?)));
            self.progress.extend(before);
        }
        kept
    }

    /// Deletes cycles beyond `keep_cycles`, after the states that contain them are on disk.
    fn sweep(&mut self) -> Result<(), StoreError> {
        let Some(up_to) = self.store.too_old(self.newest) else { return Ok(()) };
        let mut behind = self.behind(up_to);
        // Deletes a few at a time, so that no sender waits for a thousand deletions. The rest follows with the next
        // batches.
        let whole = behind.len() <= STATES_AT_ONCE;
        behind.truncate(STATES_AT_ONCE);
        self.keep_recipes(behind)?;
        if whole { self.store.sweep(up_to) } else { Ok(()) }
    }

    /// Restarts a recipe's detectors after the cause was repaired. Returns whether the recipe exists.
    ///
    /// # Errors
    /// If the store failed.
    pub fn restart(&mut self, name: &str) -> Result<bool, IntakeError> {
        let Some(recipe) = self.monitor.recipe_mut(name) else { return Ok(false) };
        recipe.restart();
        self.keep_recipe(name)?;
        Ok(true)
    }

    /// Checks that the store can be written.
    ///
    /// # Errors
    /// If the store cannot be written.
    pub fn healthy(&self) -> Result<(), IntakeError> {
        Ok(self.store.probe()?)
    }

    /// The monitor.
    pub fn monitor(&self) -> &Monitor {
        &self.monitor
    }

    /// The sum of all results since the start.
    pub fn totals(&self) -> &Taken {
        &self.totals
    }

    /// The store.
    pub fn store(&self) -> &Store {
        &self.store
    }
}

/// The content of one commit.
#[derive(Default)]
struct Fresh {
    /// New cycles with their numbers.
    cycles: Vec<(u64, Cycle)>,
    /// Who sent each batch: an address, `mqtt` or `the feed`.
    from: Vec<String>,
    /// New recipes.
    recipes: BTreeSet<String>,
    /// Problems of senders.
    found: Vec<Found>,
}

/// Records that a recipe processed a cycle. Returns the number of cycles since its state was written.
fn note(progress: &mut BTreeMap<String, Progress>, recipe: &str, seq: u64) -> u64 {
    if let Some(progress) = progress.get_mut(recipe) {
        progress.last = seq;
        progress.since += 1;
        return progress.since;
    }
    // No state is on disk, and this is its first cycle.
    progress.insert(recipe.to_owned(), Progress { last: seq, written: seq.saturating_sub(1), since: 1 });
    1
}
