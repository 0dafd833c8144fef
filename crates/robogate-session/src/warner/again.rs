//! Warned episodes run again without the warner: what it changed.
//!
//! Both episodes are the same until the warning, so only warned ones run again. The second run watches too: an episode that is
//! not warned at the same time has not repeated, and says nothing.

use std::collections::BTreeMap;
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use anyhow::Context;
use robogate_campaign::folder::DICTIONARY;
use robogate_campaign::{Executor, RunError};
use robogate_core::{Episode, Outcome, Scenario};
use robogate_dictionary::{Dictionary, files, read_regular_text};
use robogate_gate::{Record, WARNED_S, WarnerEffect};
use robogate_stats::format::count;
use serde::{Deserialize, Serialize};

use crate::failure::{Failure, OrFailure};
use crate::notice::note;

/// The file with these episodes in the folder of a run.
const UNWARNED: &str = "without_warner.json";

/// The version of the format.
const FORMAT: u32 = 1;

/// The end of a warned episode without the warner.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct UnwarnedEnd {
    /// The index of the episode.
    pub index: u64,
    /// `success` or the failure mode.
    pub outcome: String,
    /// The time of the decisive event, in seconds.
    pub time_s: f64,
}

#[derive(Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct File {
    format: u32,
    /// SHA-256 (hex) of the rows of the run.
    dataset_sha256: String,
    episodes: Vec<UnwarnedEnd>,
}

/// The ends of the warned episodes of the run in this folder without the warner. Empty if they did not run again.
///
/// # Errors
/// A file that cannot be read, or that belongs to other rows.
pub fn unwarned(folder: &Path, dictionary: &Dictionary) -> Result<Vec<UnwarnedEnd>, Failure> {
    let path = folder.join(UNWARNED);
    if dictionary.provenance().world.as_ref().is_none_or(|world| world.warner.is_none()) || !path.exists() {
        return Ok(Vec::new());
    }
    let text = read_regular_text(&path).with_context(|| format!("cannot read {}", path.display())).or_request()?;
    let hint = "Hint: remove it; `robogate resume` on the folder makes it again";
    let file: File = serde_json::from_str(&text)
        .with_context(|| format!("{}: not readable\n{hint}", path.display()))
        .or_request()?;
    if file.format != FORMAT || file.dataset_sha256 != dictionary.dataset_hash() {
        return Err(anyhow::anyhow!("{}: it belongs to other rows than those of the run\n{hint}", path.display()))
            .or_request();
    }
    Ok(file.episodes)
}

/// What the warner of the run in this folder changed. `None` without a warner.
///
/// # Errors
/// Rows or a file that cannot be read.
pub fn warner_effect_of(folder: &Path, dictionary: &Dictionary) -> Result<Option<WarnerEffect>, Failure> {
    let ends = unwarned(folder, dictionary)?;
    let record = Record::of(dictionary)?;
    let by_index: BTreeMap<u64, String> = ends.into_iter().map(|end| (end.index, end.outcome)).collect();
    Ok(record.warner.as_ref().map(|warner| WarnerEffect::of(warner, record.trials.iter(), &by_index)))
}

/// The warned episodes of a campaign, which run again after it.
pub(crate) struct WarnedAgain {
    dir: PathBuf,
    /// Whether new workers act on warnings.
    acts: Arc<AtomicBool>,
}

impl WarnedAgain {
    pub(crate) fn new(dir: &Path, acts: Arc<AtomicBool>) -> Self {
        Self { dir: dir.to_owned(), acts }
    }

    /// Runs the episodes, unless they have run. Returns how many are missing, because the executor was stopped.
    pub(crate) fn run(&self, executor: &dyn Executor) -> Result<usize, RunError> {
        let dictionary = Dictionary::open(&self.dir.join(DICTIONARY))?;
        let path = self.dir.join(UNWARNED);
        if path.exists() {
            return Ok(0);
        }
        let mut warned: Vec<Episode> = Vec::new();
        for entry in dictionary.entries() {
            let episode = entry?.episode;
            if warned_s(&episode).is_some() && !matches!(episode.outcome, Outcome::Invalid(_)) {
                warned.push(episode);
            }
        }
        note(format_args!("warned episodes run again without the warner: {}", count(warned.len() as u64)));
        let scenarios: Vec<Scenario> = warned.iter().map(|episode| episode.scenario.clone()).collect();
        let mut again: BTreeMap<u64, Episode> = BTreeMap::new();
        self.acts.store(false, Ordering::Relaxed);
        let ran = executor.execute(&|at| scenarios.get(at).cloned(), &mut |episode| {
            again.insert(episode.scenario.index, episode);
            ControlFlow::Continue(())
        });
        self.acts.store(true, Ordering::Relaxed);
        ran?;
        if again.len() < warned.len() {
            return Ok(warned.len() - again.len());
        }
        let ends = warned.iter().filter_map(|before| {
            let after = again.get(&before.scenario.index)?;
            let repeats = warned_s(after) == warned_s(before) && !matches!(after.outcome, Outcome::Invalid(_));
            repeats.then(|| UnwarnedEnd {
                index: before.scenario.index,
                outcome: after.outcome.as_str().to_owned(),
                time_s: after.time_s,
            })
        });
        let file =
            File { format: FORMAT, dataset_sha256: dictionary.dataset_hash().to_owned(), episodes: ends.collect() };
        if file.episodes.len() < warned.len() {
            note(format_args!(
                "{} of {} warned episodes did not repeat without the warner: the policy or the environment is random",
                count((warned.len() - file.episodes.len()) as u64),
                count(warned.len() as u64)
            ));
        }
        let written = serde_json::to_vec_pretty(&file).map_err(std::io::Error::from);
        let written = written.and_then(|mut text| {
            text.push(b'\n');
            files::write(&path, text)
        });
        written.map_err(|source| RunError::Io { path, action: "write", source })?;
        Ok(0)
    }
}

fn warned_s(episode: &Episode) -> Option<f64> {
    episode.measures.get(WARNED_S.as_str())
}
