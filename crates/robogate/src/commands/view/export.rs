//! The page as one file.

use std::path::Path;
use std::sync::Arc;

use anyhow::Context;
use robogate_analysis::{ExplorerTable, Role};
use robogate_replay::{packed_floats, reel};
use robogate_report::explorer_page;
use serde_json::{Value, json};

use super::board::Board;
use super::clips::{Clips, Origin};
use super::model;
use crate::exit::{DONE, Exit, OrExit};
use crate::remote::Simulators;
use crate::terminal::{foreign, note};

/// Writes the page with at most this number of recorded episodes.
pub(super) fn write(file: &Path, mut board: Board, simulators: &Simulators, most: usize) -> Result<u8, Exit> {
    let models: Vec<Value> = (0..board.runs.len())
        .map(|run| {
            let training = model::training(&board.table, run, &board.runs[run].provenance);
            model::fit(&training).unwrap_or_else(|because| json!({ "version": 1, "because": because }))
        })
        .collect();
    let mut clips = Clips::new(simulators.clone());
    let mut recorded = Vec::new();
    let mut places = Vec::new();
    for (run, index) in chosen(&board, most) {
        let of = &board.runs[run];
        let origin = Origin {
            run,
            name: of.name.clone(),
            path: of.path.clone(),
            provenance: Arc::clone(&of.provenance),
            named: board.runs.len() > 1,
        };
        let entry = board.recorded(run, index).or_broken()?;
        match entry.map(|entry| clips.clip(&origin, &entry)) {
            Some(Ok(clip)) => {
                places.push(json!([run, index]));
                recorded.push(clip);
            }
            Some(Err(because)) => note(format_args!(
                "note: episode {index} of {} is not in the page: {}",
                foreign(&origin.name),
                foreign(because)
            )),
            None => {}
        }
    }
    let reel = reel(&recorded);
    let columns: Vec<String> = board.table.columns().iter().map(|column| packed_floats(column.values())).collect();
    let document = json!({
        "state": board.state(),
        "columns": columns,
        "models": models,
        "episodes": places,
    });
    let data = document.to_string().replace('<', "\\u003c");
    let names: Vec<&str> = board.runs.iter().map(|run| run.name.as_str()).collect();
    let (html, _) = explorer_page(&names.join(", "), Some((&data, &reel.json)));
    std::fs::write(file, &html).with_context(|| format!("cannot write {}", file.display())).or_broken()?;
    note(format_args!(
        "{}: {} KB, {} rows, {} recorded episodes",
        file.display(),
        html.len().div_ceil(1024),
        board.table.rows(),
        recorded.len()
    ));
    Ok(DONE)
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
