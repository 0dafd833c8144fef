//! The simulated episodes that the page compares cycles with and replays.

use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};

use robogate_analysis::{Source, shell_word};
use robogate_core::{Outcome, Value};
use robogate_monitor::ParameterValue;
use robogate_monitor::service::{Episodes, Replays, SimulatedEpisode};
use robogate_report::replay_page;

use super::Referred;
use crate::commands::view::Player;
use crate::exit::{Exit, OrExit};
use crate::terminal::note;
use robogate_session::open_source;

/// The largest number of episodes of a run that cycles are compared with.
const MOST_EPISODES: usize = 200_000;

/// Simulated episodes.
pub(super) struct Simulated {
    /// Those of one recipe, or under `None` those of all recipes without their own.
    pub(super) episodes: Vec<(Option<String>, Arc<Episodes>)>,
    /// Replays them. `None` if no run can be replayed.
    pub(super) replays: Option<Replays>,
}

/// Reads the episodes of the run `given`, or those of the runs that the references name. A run of a reference that is not there,
/// or that has changed, is left out with a note.
pub(super) fn simulated(given: Option<&Path>, referred: &[Referred]) -> Result<Simulated, Exit> {
    let mut known: Vec<(PathBuf, Arc<Episodes>)> = Vec::new();
    let mut runs: Vec<PathBuf> = Vec::new();
    let mut episodes = Vec::new();
    if let Some(run) = given {
        episodes.push((None, Arc::new(read(run, &open_source(run)?, &mut runs)?)));
    } else {
        for of in referred {
            let Some(run) = of.reference.run.as_deref() else { continue };
            let path = of.path.parent().unwrap_or(Path::new("")).join(run);
            let path = path.canonicalize().unwrap_or(path);
            let found = match known.iter().find(|(one, _)| *one == path) {
                Some((_, found)) => Arc::clone(found),
                None => match source_of(&path, &of.reference.dataset_sha256) {
                    Ok(source) => {
                        let found = Arc::new(read(&path, &source, &mut runs)?);
                        known.push((path, Arc::clone(&found)));
                        found
                    }
                    Err(because) => {
                        let (file, path) = (of.path.display(), path.display());
                        note(format_args!(
                            "note: {file}: its simulated episodes are not shown, because {path} {because}"
                        ));
                        continue;
                    }
                },
            };
            episodes.push((of.recipe.clone(), found));
        }
    }
    Ok(Simulated { episodes, replays: replays(runs) })
}

/// Opens the run of a reference, or says why it cannot be used.
fn source_of(run: &Path, dataset: &str) -> Result<Source, String> {
    if !run.is_dir() {
        return Err("is not there".to_owned());
    }
    let source = Source::open(run).map_err(|error| format!("cannot be read: {error}"))?;
    if source.dictionary().dataset_hash() != dataset {
        return Err("has other episodes than before".to_owned());
    }
    Ok(source)
}

/// Reads the valid episodes of a run, and adds the run to `runs` if they can be replayed.
fn read(run: &Path, source: &Source, runs: &mut Vec<PathBuf>) -> Result<Episodes, Exit> {
    let mut episodes = Vec::new();
    for entry in source.dictionary().entries().take(MOST_EPISODES) {
        let episode = entry.or_usage()?.episode;
        if matches!(episode.outcome, Outcome::Invalid(_)) {
            continue;
        }
        let value = |value: &Value| match value {
            Value::Number(x) => ParameterValue::Number(*x),
            Value::Integer(n) => ParameterValue::Number(*n as f64),
            other => ParameterValue::Word(other.to_string()),
        };
        let requested = episode.scenario.requested.iter();
        episodes.push(SimulatedEpisode {
            index: episode.scenario.index,
            outcome: episode.outcome.as_str().to_owned(),
            parameters: requested.map(|(name, one)| (name.to_owned(), value(one))).collect(),
        });
    }
    let folder = source.folder().unwrap_or(run);
    let found = Episodes::new(shell_word(&folder.display().to_string()), episodes);
    let imported = source.dictionary().provenance().source.is_some();
    if imported || source.folder().is_none() {
        return Ok(found);
    }
    runs.push(folder.to_owned());
    Ok(found.replayed(runs.len() - 1))
}

/// The page that replays episodes of these runs. They are read with the first replay.
fn replays(runs: Vec<PathBuf>) -> Option<Replays> {
    if runs.is_empty() {
        return None;
    }
    let player: Mutex<Option<Player>> = Mutex::new(None);
    let recompute = move |run: usize, index: u64| {
        // A panic while an episode was computed leaves the player as it was.
        let mut player = player.lock().unwrap_or_else(PoisonError::into_inner);
        let player = match &mut *player {
            Some(player) => player,
            empty => empty.insert(Player::open(&runs, MOST_EPISODES).map_err(|exit| exit.to_string())?),
        };
        player.clip(run, index).map_err(|because| because.to_string())
    };
    let (page, policy) = replay_page();
    Some(Replays::new(page, policy, Arc::new(recompute)))
}
