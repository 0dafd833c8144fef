//! The page as one file.

use std::path::Path;
use std::sync::Arc;

use anyhow::Context;
use robogate_analysis::{ExplorerTable, Role};
use robogate_dictionary::files;
use robogate_replay::{Clip, packed_floats, reel};
use robogate_report::explorer_page;
use serde_json::{Value, json};

use super::CLIPS;
use super::board::Board;
use super::clips::{Clips, Origin};
use super::model;
use crate::exit::{DONE, Exit, OrExit};
use crate::terminal::{foreign, indented, note};
use robogate_session::Reopening;

/// Writes the page with at most this number of recorded episodes and of rows. If the number of episodes is given and none
/// can be recorded, that is an error; by default, the page then has none.
pub(super) fn write(
    file: &Path,
    mut board: Board,
    opening: &Reopening,
    clips: Option<u16>,
    most_rows: usize,
) -> Result<u8, Exit> {
    let models: Vec<Value> = (0..board.runs.len())
        .map(|run| {
            let training = model::training(&board.table, run, &board.runs[run].provenance);
            model::fit(&training).unwrap_or_else(|because| json!({ "version": 1, "because": because }))
        })
        .collect();
    let most = usize::from(clips.unwrap_or(CLIPS));
    let mut recorder = Recorder::new(opening, most);
    for (run, index) in chosen(&board, most) {
        recorder.add(&mut board, run, index)?;
        if let Some(twin) = board.table.passing_twin(run, index) {
            recorder.add(&mut board, run, twin.index)?;
        }
    }
    if let Some(clips) = clips
        && recorder.recorded.is_empty()
        && !recorder.failed.is_empty()
    {
        let (_, Exit { code, error }) = recorder.failed.swap_remove(0);
        let what = format!("--clips {clips}: no episode can be recorded. Leave out --clips for a page without replays");
        return Err(Exit { code, error: error.context(what) });
    }
    recorder.note_failed(&board);
    let episodes: Vec<Value> = recorder.episodes(&board.table).collect();
    let Recorder { recorded, places, .. } = recorder;
    let reel = reel(&recorded);
    let rows = rows(&board.table, &places, most_rows);
    let columns: Vec<String> = board
        .table
        .columns()
        .iter()
        .map(|column| packed_floats(&rows.iter().map(|row| column.values()[*row]).collect::<Vec<f32>>()))
        .collect();
    let document = json!({
        "state": board.state(),
        "columns": columns,
        "models": models,
        "episodes": episodes,
    });
    let data = document.to_string();
    let names: Vec<&str> = board.runs.iter().map(|run| run.name.as_str()).collect();
    let (html, _) = explorer_page(&names.join(", "), Some((&data, &reel.json)));
    files::write(file, &html).with_context(|| format!("cannot write {}", file.display())).or_broken()?;
    note(format_args!(
        "{}: {} KB, {} rows, {} recorded episodes",
        file.display(),
        html.len().div_ceil(1024),
        rows.len(),
        recorded.len()
    ));
    if rows.len() < board.table.rows() {
        note(format_args!(
            "note: the page has a random sample of {} of {} rows\nHint: choose its size with --rows",
            rows.len(),
            board.table.rows()
        ));
    }
    Ok(DONE)
}

/// The rows of the page: all, or a sample with the recorded episodes.
fn rows(table: &ExplorerTable, places: &[(usize, u64)], most: usize) -> Vec<usize> {
    let mut rows = table.sample(most);
    if rows.len() < table.rows() {
        rows.extend(places.iter().filter_map(|(run, index)| table.row(*run, *index)));
        rows.sort_unstable();
        rows.dedup();
    }
    rows
}

/// The recorded episodes of the page.
struct Recorder {
    clips: Clips,
    most: usize,
    recorded: Vec<Clip>,
    /// Run and index of each recorded episode.
    places: Vec<(usize, u64)>,
    /// Run and index of each episode that cannot be recorded, and why.
    failed: Vec<((usize, u64), Exit)>,
}

impl Recorder {
    fn new(opening: &Reopening, most: usize) -> Self {
        let clips = Clips::new(opening.clone());
        Self { clips, most, recorded: Vec::new(), places: Vec::new(), failed: Vec::new() }
    }

    /// Records an episode, unless it is there or the page is full.
    fn add(&mut self, board: &mut Board, run: usize, index: u64) -> Result<(), Exit> {
        let place = (run, index);
        let mut known = self.places.iter().chain(self.failed.iter().map(|(failed, _)| failed));
        if self.recorded.len() >= self.most || known.any(|known| *known == place) {
            return Ok(());
        }
        let of = &board.runs[run];
        let origin = Origin {
            run,
            name: of.name.clone(),
            path: of.path.clone(),
            provenance: Arc::clone(&of.provenance),
            named: board.runs.len() > 1,
        };
        match board.recorded(run, index).or_broken()?.map(|entry| self.clips.clip(&origin, &entry)) {
            Some(Ok(clip)) => {
                self.places.push(place);
                self.recorded.push(clip);
            }
            Some(Err(exit)) => self.failed.push((place, exit)),
            None => {}
        }
        Ok(())
    }

    /// Prints why episodes are not in the page, once for each run and reason.
    fn note_failed(&self, board: &Board) {
        let mut reasons: Vec<(usize, String, Vec<u64>)> = Vec::new();
        for ((run, index), exit) in &self.failed {
            let because = exit.to_string();
            match reasons.iter_mut().find(|(of, known, _)| of == run && *known == because) {
                Some((.., indices)) => indices.push(*index),
                None => reasons.push((*run, because, vec![*index])),
            }
        }
        for (run, because, indices) in reasons {
            let name = foreign(&board.runs[run].name);
            let which = match indices[..] {
                [index] => format!("episode {index} of {name} is"),
                _ => format!("{} episodes of {name} are", indices.len()),
            };
            note(format_args!("note: {which} not in the page: {}", indented(because)));
        }
    }

    /// The recorded episodes, each with its nearest passing twin if that is recorded too.
    fn episodes(&self, table: &ExplorerTable) -> impl Iterator<Item = Value> {
        self.places.iter().map(|(run, index)| {
            let twin = table.passing_twin(*run, *index).and_then(|twin| {
                let at = self.places.iter().position(|place| *place == (*run, twin.index))?;
                Some(json!({ "index": twin.index, "differences": twin.differences, "at": at }))
            });
            json!({ "run": run, "index": index, "twin": twin })
        })
    }
}

/// Episodes to record: from each run and each outcome in turn, so that every failure mode can be watched.
fn chosen(board: &Board, most: usize) -> Vec<(usize, u64)> {
    let mut groups: Vec<(usize, Vec<u64>)> = Vec::new();
    for (run, _) in board.runs.iter().enumerate().filter(|(_, run)| run.is_playable()) {
        for indices in by_outcome(&board.table, run, most) {
            groups.push((run, indices));
        }
    }
    let mut chosen = Vec::new();
    for round in 0..most {
        for (run, indices) in &groups {
            if chosen.len() < most
                && let Some(index) = indices.get(round)
            {
                chosen.push((*run, *index));
            }
        }
    }
    chosen
}

/// The first episodes of each outcome but `invalid`, the failure modes first.
fn by_outcome(table: &ExplorerTable, run: usize, most: usize) -> Vec<Vec<u64>> {
    let column = |role: Role| table.columns().iter().find(|column| column.role == role);
    let (Some(runs), Some(outcomes), Some(indices)) = (column(Role::Run), column(Role::Outcome), column(Role::Index))
    else {
        return Vec::new();
    };
    let mut groups = vec![Vec::new(); outcomes.levels.len()];
    for ((of, outcome), index) in runs.values().iter().zip(outcomes.values()).zip(indices.values()) {
        if *of as usize == run
            && let Some(group) = groups.get_mut(*outcome as usize)
            && group.len() < most
        {
            group.push(*index as u64);
        }
    }
    let invalid = outcomes.levels.iter().position(|level| level == "invalid");
    if let Some(group) = invalid.and_then(|at| groups.get_mut(at)) {
        group.clear();
    }
    groups.rotate_left(1);
    groups
}
