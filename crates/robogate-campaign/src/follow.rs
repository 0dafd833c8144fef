//! Reads the episodes of a campaign while another process runs it.

use std::collections::{BTreeSet, HashSet};
use std::path::{Path, PathBuf};

use robogate_dictionary::{Dictionary, DictionaryError, Entry, JournalTail, PlanHash};
use sha2::{Digest, Sha256};

use crate::folder::{DICTIONARY, JOURNAL, PLAN};
use crate::shards::{ShardError, ShardRound, Shards};
use crate::{RunError, Settings, settings};

/// Follows a campaign, which another process may run. It takes no lock and changes no file.
///
/// Episodes come from the journal of a run, or from the committed shards of a campaign in shards, and at the end from the
/// dictionary. Each episode is passed on once, in the order of arrival.
#[derive(Debug)]
pub struct Follower {
    dir: PathBuf,
    settings: Settings,
    source: Source,
    /// The episodes that were passed on before the campaign was finished.
    known: HashSet<u64>,
    /// The number of entries of the dictionary that were read.
    read: usize,
}

#[derive(Debug)]
enum Source {
    Journal { plan: PlanHash, tail: Box<JournalTail> },
    Shards { shards: Box<Shards>, known: BTreeSet<(ShardRound, u32)> },
    Finished,
}

/// What a look at a campaign found.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Progress {
    /// The campaign has no dictionary yet.
    Running,
    /// The dictionary is complete. No episode follows.
    Finished,
    /// The journal was written anew, as after a resume that runs lost episodes again. All episodes before are void, and
    /// those of the new journal follow with the next look.
    Restarted,
}

/// The reason why a campaign cannot be followed.
#[derive(Debug, thiserror::Error)]
pub enum FollowError {
    /// The plan cannot be read.
    #[error(transparent)]
    Run(#[from] RunError),
    /// A shard cannot be read.
    #[error(transparent)]
    Shard(#[from] ShardError),
    /// The journal or the dictionary cannot be read.
    #[error(transparent)]
    Dictionary(#[from] DictionaryError),
}

impl Follower {
    /// Follows the run in the folder `dir`.
    ///
    /// # Errors
    /// The folder has no plan, or an unreadable one.
    pub fn open(dir: &Path) -> Result<Self, FollowError> {
        let settings = settings(dir)?;
        let path = dir.join(PLAN);
        let text = std::fs::read(&path).map_err(RunError::io(&path, "read"))?;
        let plan: PlanHash = Sha256::digest(text).into();
        let tail = Box::new(JournalTail::new(&dir.join(JOURNAL), &plan));
        Ok(Self {
            dir: dir.to_owned(),
            settings,
            source: Source::Journal { plan, tail },
            known: HashSet::new(),
            read: 0,
        })
    }

    /// Follows a campaign in shards.
    pub fn of_shards(shards: Shards) -> Self {
        let (dir, settings) = (shards.dir(), shards.settings().clone());
        let source = Source::Shards { shards: Box::new(shards), known: BTreeSet::new() };
        Self { dir, settings, source, known: HashSet::new(), read: 0 }
    }

    /// The settings of the campaign.
    pub fn settings(&self) -> &Settings {
        &self.settings
    }

    /// Passes the episodes that arrived since the last look to `sink`.
    ///
    /// # Errors
    /// A file that cannot be read or is damaged. Episodes before it were passed on.
    pub fn look(&mut self, sink: &mut dyn FnMut(&Entry)) -> Result<Progress, FollowError> {
        let dictionary = self.dir.join(DICTIONARY);
        // A run removes its journal last.
        if dictionary.is_file() && !self.dir.join(JOURNAL).exists() {
            if !matches!(self.source, Source::Finished) {
                // After an error, the next look goes on with the entry that could not be read.
                for entry in Dictionary::open(&dictionary)?.entries().skip(self.read) {
                    let entry = entry?;
                    self.read += 1;
                    if !self.known.contains(&entry.index()) {
                        sink(&entry);
                    }
                }
                self.source = Source::Finished;
                // No episode follows, so the memory is free again.
                self.known = HashSet::new();
            }
            return Ok(Progress::Finished);
        }
        let known = &mut self.known;
        let mut fresh = |entry: &Entry| {
            if known.insert(entry.index()) {
                sink(entry);
            }
        };
        match &mut self.source {
            Source::Journal { plan, tail } => match tail.read(&mut fresh) {
                Ok(()) => Ok(Progress::Running),
                Err(DictionaryError::DamagedJournal { .. }) if !tail.is_empty() && is_new(tail, &self.dir, plan) => {
                    **tail = JournalTail::new(&self.dir.join(JOURNAL), plan);
                    self.known.clear();
                    Ok(Progress::Restarted)
                }
                Err(error) => Err(error.into()),
            },
            Source::Shards { shards, known } => {
                shards.arrivals(known, &mut fresh)?;
                Ok(Progress::Running)
            }
            Source::Finished => Ok(Progress::Finished),
        }
    }

    /// Reads the entry of an episode that was passed on. `None` for any other one.
    ///
    /// # Errors
    /// A file that cannot be read or is damaged.
    pub fn recorded(&mut self, index: u64) -> Result<Option<Entry>, FollowError> {
        if !matches!(self.source, Source::Finished) && !self.known.contains(&index) {
            return Ok(None);
        }
        Ok(match &mut self.source {
            Source::Journal { tail, .. } => tail.entry(index)?,
            Source::Shards { shards, .. } => shards.recorded(index)?,
            Source::Finished => {
                let dictionary = Dictionary::open(&self.dir.join(DICTIONARY))?;
                let found = dictionary.entries().find(|entry| entry.as_ref().map_or(true, |e| e.index() == index));
                found.transpose()?
            }
        })
    }
}

/// Whether the journal can be read from its start, so that it is another file than before, and not a damaged one.
fn is_new(before: &JournalTail, dir: &Path, plan: &PlanHash) -> bool {
    let mut tail = JournalTail::new(&dir.join(JOURNAL), plan);
    tail.read(&mut |_| {}).is_ok() && tail.len() != before.len()
}
