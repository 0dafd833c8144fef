//! Campaigns in shards: parts of a campaign run on many machines, and the merged result has the same bytes as the run of
//! one machine.
//!
//! ```text
//! DIR/plan.json                     everything the campaign depends on
//! DIR/shards/layout.json            the number of shards
//! DIR/shards/design-uniform.points  the points of the uniform stage
//! DIR/shards/uniform-3-of-16.rgs    the episodes of one shard
//! DIR/boundary.json                 the boundary found by the uniform stage
//! DIR/shards/active-2.json          the points of a round of the active stage
//! DIR/shards/uniform-3-of-16.rgs.conflict  the SHA-256 of two different results of this shard, if there were two
//! ```
//!
//! A campaign has rounds ([`ShardRound`]): the uniform stage and then the boundary stage or the rounds of the active stage, or the
//! rounds of a suite. Each
//! round is divided into the same number of shards. The next round opens when all shards of a round are committed,
//! because its points may follow from their results.
//!
//! Every file is written completely and then stored under a name that does not exist yet, so there are no locks, and any
//! number of processes may run the same shard. A shard that is interrupted leaves nothing and runs again from its start.

mod active;
mod arrivals;
mod conflict;
mod design;
mod division;
mod error;
mod file;
mod lost;
mod merge;
mod round;
mod shard;
mod status;
mod store;
mod task;

use std::collections::{BTreeMap, BTreeSet};
use std::ops::ControlFlow;
use std::path::PathBuf;
use std::sync::Arc;

use robogate_core::ParameterSpace;
use robogate_dictionary::{Entry, LostEpisode, Provenance, hex};
use serde::{Deserialize, Serialize};

pub use error::ShardError;
pub use round::ShardRound;
pub use shard::{MOST_SHARDS, Shard, ShardNameError, ShardSet};
pub use status::{RoundState, RoundStatus, ShardStatus};
pub use store::{DirectoryStore, ShardStore, Stored};
pub use task::{Assignment, Commit, ShardEnd, ShardResult, ShardTask};

use crate::folder::{self, BOUNDARY, DICTIONARY, JOURNAL, LAYOUT, PLAN, SUMMARY};
use crate::run::AfterRound;
use crate::{Bins, BoundaryReport, Plan, Points, Round, RunError, Settings};
use division::Division;
use file::{Hash, Header, sha256};

/// A campaign in shards.
pub struct Shards {
    store: Box<dyn ShardStore>,
    settings: Settings,
    /// The content of `plan.json`.
    plan_text: Vec<u8>,
    /// Its SHA-256, which every shard records.
    plan_hash: Hash,
    space: Arc<ParameterSpace>,
    shards: u32,
}

impl std::fmt::Debug for Shards {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Shards").field("dir", &self.dir()).field("shards", &self.shards).finish_non_exhaustive()
    }
}

/// The content of `shards/layout.json`.
#[derive(Debug, Serialize, Deserialize)]
struct Layout {
    version: u32,
    shards: u32,
    plan_sha256: String,
}

impl Layout {
    const VERSION: u32 = 1;
}

/// A round with missing shards.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct OpenRound {
    /// The round.
    pub round: ShardRound,
    /// The missing shards, in increasing order.
    pub missing: Vec<u32>,
}

/// The committed shards of each round.
type Committed = BTreeMap<ShardRound, BTreeSet<u32>>;

impl Shards {
    /// Starts or joins a campaign in `shards` shards. The first process stores the plan and the number of shards. The
    /// others need the same number and equal settings.
    ///
    /// This function fills in `plan` and `seed` of `provenance`.
    pub fn begin(
        store: Box<dyn ShardStore>,
        shards: u32,
        plan: &Plan,
        provenance: Provenance,
    ) -> Result<Self, ShardError> {
        Self::begin_with(store, shards, plan, provenance, &[])
    }

    /// Like [`Self::begin`], and stores `documents` (names and contents) beside the plan before any shard can run.
    /// Documents that exist must be equal.
    pub fn begin_with(
        store: Box<dyn ShardStore>,
        shards: u32,
        plan: &Plan,
        provenance: Provenance,
        documents: &[(&str, &[u8])],
    ) -> Result<Self, ShardError> {
        // Checks the number of shards.
        Shard::new(0, shards)?;
        plan.check(&provenance.space).map_err(RunError::from)?;
        let path = store.place(PLAN);
        let unreadable = |source| RunError::Unreadable { path: path.clone(), source };
        let present = Settings::new(plan, provenance).map_err(unreadable)?;
        if get(&*store, LAYOUT)?.is_none() {
            let names = store.list("").map_err(failed(&*store, "", "list"))?;
            if names.iter().any(|name| [JOURNAL, DICTIONARY, SUMMARY].contains(&name.as_str())) {
                return Err(ShardError::SingleRun { dir: store.place("") });
            }
        }
        let text = folder::document_bytes(&present).map_err(unreadable)?;
        if put(&*store, PLAN, &text)? == Stored::Exists {
            let text = existing(&*store, PLAN)?;
            Settings::parse(&path, &text)?.same(&present)?;
        }
        for (name, content) in documents {
            put_equal(&*store, name, content)?;
        }
        // Another process may have stored an equal plan in another formatting.
        let text = get(&*store, PLAN)?.unwrap_or(text);
        let layout = Layout { version: Layout::VERSION, shards, plan_sha256: hex(&sha256(&text)) };
        let layout = folder::document_bytes(&layout).map_err(unreadable)?;
        put(&*store, LAYOUT, &layout)?;
        let joined = Self::open(store)?;
        if joined.shards != shards {
            return Err(ShardError::OtherCount { dir: joined.dir(), shards: joined.shards, asked: shards });
        }
        Ok(joined)
    }

    /// Opens a campaign in shards.
    pub fn open(store: Box<dyn ShardStore>) -> Result<Self, ShardError> {
        let (Some(plan_text), Some(layout)) = (get(&*store, PLAN)?, get(&*store, LAYOUT)?) else {
            return Err(ShardError::NotInShards { dir: store.place("") });
        };
        let path = store.place(LAYOUT);
        let layout: Layout = folder::parse(&path, &layout)?;
        crate::run::known_version(&path, layout.version, Layout::VERSION)?;
        Shard::new(0, layout.shards)?;
        let plan_hash = sha256(&plan_text);
        let path = store.place(PLAN);
        if layout.plan_sha256 != hex(&plan_hash) {
            return Err(ShardError::PlanChanged { path });
        }
        let settings = Settings::parse(&path, &plan_text)?;
        settings.plan.check(&settings.provenance.space).map_err(RunError::from)?;
        let space = Arc::new(settings.provenance.space.clone());
        Ok(Self { store, settings, plan_text, plan_hash, space, shards: layout.shards })
    }

    /// The number of shards of each round.
    pub fn shards(&self) -> u32 {
        self.shards
    }

    /// The settings of the campaign.
    pub fn settings(&self) -> &Settings {
        &self.settings
    }

    fn plan(&self) -> &Plan {
        &self.settings.plan
    }

    /// The place of the campaign, for messages.
    pub fn dir(&self) -> PathBuf {
        self.store.place("")
    }

    /// The first round with missing shards. `None` if every round is complete.
    ///
    /// `after_round` decides after each complete round of a suite whether another one follows, as in
    /// [`crate::start_in_rounds`]. Each call passes the rounds in order, from the first on. Without it, all rounds of the
    /// plan follow.
    ///
    /// A shard for which two processes computed different results is an error.
    pub fn open_round(&self, after_round: Option<&mut AfterRound<'_>>) -> Result<Option<OpenRound>, ShardError> {
        let files = self.files()?;
        self.check_conflicts(&files)?;
        Ok(self.rounds(&files, after_round)?.1)
    }

    /// The complete rounds in order, and the open one. `files` is that of [`Self::files`].
    fn rounds(
        &self,
        files: &[String],
        mut after_round: Option<&mut AfterRound<'_>>,
    ) -> Result<(Vec<ShardRound>, Option<OpenRound>), ShardError> {
        let committed = self.committed(files)?;
        let lost = if after_round.is_some() { self.lost(files)? } else { Vec::new() };
        let mut complete = Vec::new();
        for round in ShardRound::all(self.plan()) {
            if self.is_over(round)? {
                break;
            }
            let missing = self.missing(&committed, round);
            if !missing.is_empty() {
                return Ok((complete, Some(OpenRound { round, missing })));
            }
            complete.push(round);
            if let (Some(decide), ShardRound::Suite(number)) = (&mut after_round, round)
                && self.decide(round, number, &lost, *decide)?.is_break()
            {
                break;
            }
        }
        Ok((complete, None))
    }

    /// Passes a complete round of a suite to `after_round`.
    fn decide(
        &self,
        round: ShardRound,
        number: u64,
        lost: &[LostEpisode],
        after_round: &mut AfterRound<'_>,
    ) -> Result<ControlFlow<()>, ShardError> {
        let mut entries = self.entries(round).collect::<Result<Vec<Entry>, _>>()?;
        entries.sort_unstable_by_key(Entry::index);
        Ok(after_round(&Round { number, entries: &entries, lost }))
    }

    /// The names of the shard files, of the records of other results, and of the files beside them. That is one request to an
    /// object store.
    fn files(&self) -> Result<Vec<String>, ShardError> {
        self.store.list(store::SHARDS).map_err(failed(&*self.store, store::SHARDS, "list"))
    }

    /// The committed shards among `files`. Their content is not read.
    fn committed(&self, files: &[String]) -> Result<Committed, ShardError> {
        let mut committed = Committed::new();
        let rounds = ShardRound::all(self.plan());
        for file in files {
            match file::parse_name(file) {
                Some((round, shard)) if shard.of() == self.shards && rounds.binary_search(&round).is_ok() => {
                    committed.entry(round).or_default().insert(shard.index());
                }
                _ if file.ends_with(file::ENDING) => {
                    let path = self.store.place(&format!("{}/{file}", store::SHARDS));
                    return Err(ShardError::ForeignFile { path, shards: self.shards });
                }
                // The layout, or a file of the user.
                _ => {}
            }
        }
        Ok(committed)
    }

    fn missing(&self, committed: &Committed, round: ShardRound) -> Vec<u32> {
        let there = committed.get(&round);
        (0..self.shards).filter(|k| !there.is_some_and(|there| there.contains(k))).collect()
    }

    /// Divides the episodes of a round.
    fn division(&self, round: ShardRound) -> Division {
        Division::new(round.indices(self.plan()), self.plan().seed, round)
    }

    /// The shards of the campaign.
    fn all_shards(&self) -> impl Iterator<Item = Shard> {
        let shards = self.shards;
        (0..shards).filter_map(move |k| Shard::new(k, shards).ok())
    }

    /// Reads the entries of a complete round, shard after shard, with one shard in memory at a time.
    fn entries(&self, round: ShardRound) -> impl Iterator<Item = Result<Entry, ShardError>> {
        let division = self.division(round);
        self.all_shards().flat_map(move |shard| match self.read(round, shard, &division.of(shard)) {
            Ok(Some(entries)) => entries.into_iter().map(Ok).collect::<Vec<_>>(),
            Ok(None) => {
                let (dir, missing) = (self.dir(), vec![shard.index()]);
                vec![Err(ShardError::Missing { dir, round, shards: self.shards, missing })]
            }
            Err(error) => vec![Err(error)],
        })
    }

    /// Reads and checks a committed shard with the episodes `indices`. `None` if it is missing.
    fn read(&self, round: ShardRound, shard: Shard, indices: &[u64]) -> Result<Option<Vec<Entry>>, ShardError> {
        let name = shard_name(round, shard);
        let Some(bytes) = get(&*self.store, &name)? else {
            return Ok(None);
        };
        let path = self.store.place(&name);
        let damaged = |reason: String| ShardError::Damaged { path: path.clone(), reason };
        let (header, frames) = match file::decode(&bytes) {
            Ok(decoded) => decoded,
            Err(file::Unreadable::Damaged(reason)) => return Err(damaged(reason)),
            Err(file::Unreadable::Newer(found)) => {
                return Err(RunError::OtherVersion { path, found, expected: file::VERSION }.into());
            }
        };
        let expected = Header { plan: self.plan_hash, round, shard, episodes: indices.len() as u64 };
        if header.plan != expected.plan {
            return Err(ShardError::OtherPlan { path });
        }
        if (header.round, header.shard) != (round, shard) {
            return Err(ShardError::Misnamed { path, found: format!("{} of round {}", header.shard, header.round) });
        }
        if header != expected {
            return Err(damaged(format!("it has {} episodes, expected {}", header.episodes, expected.episodes)));
        }
        let mut entries = Vec::with_capacity(indices.len());
        for entry in file::entries(frames, indices) {
            let entry = entry.map_err(damaged)?;
            if entry.stage != round.stage().as_str()
                || entry.episode.scenario.seed.campaign_number() != self.plan().seed
            {
                return Err(damaged(format!("episode {} belongs to another campaign", entry.index())));
            }
            entries.push(entry);
        }
        Ok(Some(entries))
    }

    /// The points of a round whose previous rounds are complete.
    fn points(&self, round: ShardRound) -> Result<Points, ShardError> {
        Ok(match (round, &self.plan().suite) {
            (ShardRound::Boundary, _) => {
                let report = self.boundary()?;
                Points::boundary_by(self.plan(), &self.space, &report, &|wanted| self.design(wanted))?
            }
            (ShardRound::Suite(_), Some(suite)) => Points::suite(suite, self.plan().seed),
            (ShardRound::Active(number), _) => {
                let chosen = self.chosen(number)?.ok_or(ShardError::NotChosen { dir: self.dir(), round })?;
                Points::active(self.plan(), round.indices(self.plan()).start, chosen.points)
            }
            _ => Points::uniform_by(self.plan(), &self.space, &|wanted| self.design(wanted))?,
        })
    }

    /// The boundary that follows from the uniform stage, whose shards must be complete. It is computed once and stored.
    pub fn boundary(&self) -> Result<BoundaryReport, ShardError> {
        if let Some(text) = get(&*self.store, BOUNDARY)? {
            return Ok(folder::parse(&self.store.place(BOUNDARY), &text)?);
        }
        let mut bins = Bins::of(self.plan(), &self.space).map_err(RunError::from)?;
        for entry in self.entries(ShardRound::Uniform) {
            let episode = entry?.episode;
            bins.add(&episode.scenario.requested, &episode.outcome);
        }
        self.store_boundary(&bins)
    }

    /// Stores the boundary that follows from the counts of the uniform stage. A different stored one is an error.
    fn store_boundary(&self, bins: &Bins) -> Result<BoundaryReport, ShardError> {
        let report = BoundaryReport::find(&self.plan().boundary, &self.space, bins).map_err(RunError::from)?;
        let path = self.store.place(BOUNDARY);
        let text = folder::document_bytes(&report).map_err(|source| RunError::Unreadable { path, source })?;
        self.put_equal(BOUNDARY, &text)?;
        Ok(report)
    }

    fn put_equal(&self, name: &str, bytes: &[u8]) -> Result<Stored, ShardError> {
        put_equal(&*self.store, name, bytes)
    }

    /// Reads a document beside the plan. `None` if it does not exist.
    pub fn document(&self, name: &str) -> Result<Option<Vec<u8>>, ShardError> {
        get(&*self.store, name)
    }
}

/// Stores a file. If the name exists, its content must be equal.
fn put_equal(store: &dyn ShardStore, name: &str, bytes: &[u8]) -> Result<Stored, ShardError> {
    let stored = put(store, name, bytes)?;
    if stored == Stored::Exists {
        let there = existing(store, name)?;
        if there != bytes {
            let [committed, computed] = [&there, bytes].map(|bytes| hex(&sha256(bytes)));
            return Err(ShardError::Conflict { path: store.place(name), committed, computed });
        }
    }
    Ok(stored)
}

/// The name of a shard in the store.
fn shard_name(round: ShardRound, shard: Shard) -> String {
    format!("{}/{}", store::SHARDS, file::name(round, shard))
}

fn get(store: &dyn ShardStore, name: &str) -> Result<Option<Vec<u8>>, ShardError> {
    store.get(name).map_err(failed(store, name, "read"))
}

/// Reads a file that [`put`] has found.
fn existing(store: &dyn ShardStore, name: &str) -> Result<Vec<u8>, ShardError> {
    get(store, name)?.ok_or_else(|| failed(store, name, "read")(std::io::ErrorKind::NotFound.into()))
}

fn put(store: &dyn ShardStore, name: &str, bytes: &[u8]) -> Result<Stored, ShardError> {
    store.put_if_absent(name, bytes).map_err(failed(store, name, "write"))
}

fn failed(store: &dyn ShardStore, name: &str, action: &'static str) -> impl FnOnce(std::io::Error) -> ShardError {
    let place = store.place(name);
    move |source| ShardError::Store { place, action, source }
}
