//! Plays the episodes of runs, each failed one beside its nearest passing twin.

use std::fmt;
use std::path::PathBuf;
use std::sync::{Arc, Mutex, PoisonError};

use robogate_replay::reel;
use robogate_report::script_data;
use serde_json::json;

use super::board::Board;
use super::clips::{Clips, Origin};
use crate::exit::Exit;
use robogate_session::Reopening;

/// The episodes of runs, which are recomputed on demand.
pub(in crate::commands) struct Player {
    board: Mutex<Board>,
    clips: Mutex<Clips>,
}

/// The reason why an episode cannot be played.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(in crate::commands) enum NoClip {
    /// The number of the run is unknown.
    NoRun,
    /// The rows were imported, or come from a dictionary without its run.
    NotPlayable,
    /// The run has no such episode.
    NoEpisode(u64),
    /// The episode cannot be computed again.
    Failed(String),
}

impl fmt::Display for NoClip {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NoRun => f.write_str("there is no such run"),
            Self::NotPlayable => f.write_str("These rows do not come from a run's folder, so no episode can be shown."),
            Self::NoEpisode(index) => write!(f, "the run has no episode {index}"),
            Self::Failed(because) => f.write_str(because),
        }
    }
}

impl Player {
    /// Plays the episodes of a board.
    pub(super) fn new(board: Board, opening: Reopening) -> Self {
        Self { board: Mutex::new(board), clips: Mutex::new(Clips::new(opening)) }
    }

    /// Reads the episodes of runs.
    pub(in crate::commands) fn open(runs: &[PathBuf], most_rows: usize) -> Result<Self, Exit> {
        Ok(Self::new(Board::open(runs, most_rows)?, Reopening::none()))
    }

    pub(super) fn with_board<T>(&self, work: impl FnOnce(&mut Board) -> T) -> T {
        // A panic while a row was added leaves a column longer than the others; all are read up to the number of rows.
        work(&mut self.board.lock().unwrap_or_else(PoisonError::into_inner))
    }

    /// An episode of run number `at`, as JSON: `{ "reel", "twin" }`. The first clip of the reel is the episode. The twin of a failed
    /// one has its `index`, its `differences`, and either its place `at` in the reel or `because`.
    pub(in crate::commands) fn clip(&self, at: usize, index: u64) -> Result<Vec<u8>, NoClip> {
        let found = self.with_board(|board| {
            let named = board.runs.len() > 1;
            let of = board.runs.get(at)?;
            let origin = Origin {
                run: at,
                name: of.name.clone(),
                path: of.path.clone(),
                provenance: Arc::clone(&of.provenance),
                named,
            };
            let playable = of.is_playable();
            let twin = if playable { board.table.passing_twin(at, index) } else { None };
            let twin = twin.map(|twin| (board.recorded(at, twin.index), twin));
            Some((origin, playable, board.recorded(at, index), twin))
        });
        let (origin, playable, entry, twin) = found.ok_or(NoClip::NoRun)?;
        if !playable {
            return Err(NoClip::NotPlayable);
        }
        let entry = entry.map_err(|error| NoClip::Failed(format!("{error:#}")))?.ok_or(NoClip::NoEpisode(index))?;
        let mut clips = self.clips.lock().unwrap_or_else(PoisonError::into_inner);
        let mut recorded = vec![clips.clip(&origin, &entry).map_err(|exit| NoClip::Failed(exit.to_string()))?];
        let twin = twin.map(|(entry, twin)| {
            let clip = match entry {
                Ok(Some(entry)) => clips.clip(&origin, &entry).map_err(|exit| exit.to_string()),
                Ok(None) => Err("It is not in the run.".to_owned()),
                Err(error) => Err(format!("{error:#}")),
            };
            let mut document = json!({ "index": twin.index, "differences": twin.differences });
            match clip {
                Ok(clip) => {
                    document["at"] = json!(recorded.len());
                    recorded.push(clip);
                }
                Err(because) => document["because"] = json!(because),
            }
            document
        });
        let twin = twin.unwrap_or_default();
        Ok(script_data(&format!("{{\"twin\":{twin},\"reel\":{}}}", reel(&recorded).json)).into_bytes())
    }
}
