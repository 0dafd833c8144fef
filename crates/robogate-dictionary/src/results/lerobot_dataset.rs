//! Reads a LeRobot dataset (`codebase_version` v2 and v3): one row per episode of its frames.
//!
//! `meta/info.json` declares the features. An episode is a success if `next.success` is true in any of its frames, as in `lerobot-eval`, which
//! records it. The frames are in `data/*/*.parquet`, the words for `task_index` in `meta/tasks.parquet` (v3) or `meta/tasks.jsonl` (v2).
//! Videos are not read.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

use robogate_core::budget::Budget;
use serde_json::{Map, Value};
use sha2::{Digest, Sha256};

use super::{Frame, Sink, json_lines, parquet};
use crate::raw::{RawRow, Scalar};
use crate::{DictionaryError, hex, read_text};

const INFO: &str = "meta/info.json";
const SUCCESS: &str = "next.success";
const REWARD: &str = "next.reward";
/// Largest number of files with frames.
const MOST_FILES: usize = 100_000;

pub(super) fn read(folder: &Path, sink: Sink<'_>) -> Result<Frame, DictionaryError> {
    let refuse = |reason: String| DictionaryError::results(folder, reason);
    let (info, text) = info(folder)?;
    let declares = info.get("features").and_then(Value::as_object).is_some_and(|of| of.contains_key(SUCCESS));
    if !declares {
        return Err(refuse(format!(
            "its frames have no feature `{SUCCESS}`, so no episode has an outcome\nHint: record it, as `lerobot-eval` does, or import a table with one \
             row per episode"
        )));
    }
    let fps = info.get("fps").and_then(Value::as_f64).filter(|fps| *fps > 0.0);
    let mut hash = Sha256::new();
    hash.update(text);
    let tasks = tasks(folder, &mut hash)?;
    let mut episodes = Episodes { sink, fps, tasks, current: None, seen: 0 };
    for file in data_files(folder)? {
        let read = parquet::read(&file, &mut |row| episodes.frame(row))?;
        hash.update(read.sha256);
    }
    episodes.finish()?;
    let seen = episodes.seen;
    if let Some(total) = info.get("total_episodes").and_then(Value::as_u64).filter(|total| *total != seen) {
        return Err(refuse(format!("its {INFO} states {total} episodes, but its frames have {seen}")));
    }
    let names = ["codebase_version", "robot_type", "fps"];
    let metadata = names.into_iter().filter_map(|name| Some((name.to_owned(), info.get(name)?.clone()))).collect();
    Ok(Frame { sha256: hex(&hash.finalize()), metadata, notes: Vec::new() })
}

/// What the dataset declares, and the text of the file.
fn info(folder: &Path) -> Result<(Map<String, Value>, String), DictionaryError> {
    let path = folder.join(INFO);
    let refuse = |reason: String| {
        DictionaryError::results(
            folder,
            format!("{reason}. Expected the folder of a LeRobot dataset, or a file with results"),
        )
    };
    let text = read_text(&path).map_err(|error| refuse(format!("{INFO} cannot be read: {error}")))?;
    let info: Map<String, Value> =
        Budget::FILE.json(text.as_bytes()).map_err(|error| refuse(format!("{INFO} is not a JSON object: {error}")))?;
    let version = info.get("codebase_version").and_then(Value::as_str).unwrap_or("unknown");
    if !["v2.", "v3."].iter().any(|known| version.starts_with(known)) {
        return Err(refuse(format!("its codebase version is {}. Expected v2 or v3", version.escape_debug())));
    }
    Ok((info, text))
}

/// The words of the tasks.
fn tasks(folder: &Path, hash: &mut Sha256) -> Result<BTreeMap<i64, String>, DictionaryError> {
    let mut tasks = BTreeMap::new();
    let mut take = |row: &RawRow| {
        let text = row.fields.iter().find_map(|(_, value)| match value {
            Scalar::Text(text) => Some(text.clone()),
            _ => None,
        });
        if let (Some(Scalar::Integer(index)), Some(text)) = (row.get("task_index"), text) {
            tasks.insert(*index, text);
        }
        Ok(())
    };
    let (table, lines) = (folder.join("meta/tasks.parquet"), folder.join("meta/tasks.jsonl"));
    let read = match (table.is_file(), lines.is_file()) {
        (true, _) => parquet::read(&table, &mut take)?,
        (false, true) => json_lines::read(&lines, &mut take)?,
        (false, false) => return Ok(tasks),
    };
    hash.update(read.sha256);
    Ok(tasks)
}

/// The files with frames, in the order of their names.
fn data_files(folder: &Path) -> Result<Vec<PathBuf>, DictionaryError> {
    let list = |path: &Path| -> Result<Vec<PathBuf>, DictionaryError> {
        let entries = fs::read_dir(path).map_err(DictionaryError::io(path, "list"))?;
        let paths = entries.map(|entry| entry.map(|entry| entry.path())).take(MOST_FILES + 1);
        let mut paths = paths.collect::<Result<Vec<_>, _>>().map_err(DictionaryError::io(path, "list"))?;
        paths.sort();
        Ok(paths)
    };
    let mut files = Vec::new();
    for chunk in list(&folder.join("data"))?.into_iter().filter(|path| path.is_dir()) {
        let is_frames = |path: &PathBuf| path.extension().is_some_and(|ending| ending == "parquet") && path.is_file();
        files.extend(list(&chunk)?.into_iter().filter(is_frames));
        if files.len() > MOST_FILES {
            return Err(DictionaryError::results(folder, format!("it has more than {MOST_FILES} files with frames")));
        }
    }
    if files.is_empty() {
        return Err(DictionaryError::results(folder, "it has no frames in data/*/*.parquet"));
    }
    Ok(files)
}

/// Collects frames to episodes.
struct Episodes<'a> {
    sink: Sink<'a>,
    fps: Option<f64>,
    tasks: BTreeMap<i64, String>,
    current: Option<Current>,
    seen: u64,
}

/// An episode whose frames are being read.
struct Current {
    index: i64,
    task: Option<i64>,
    frames: u64,
    success: Option<bool>,
    reward: Option<f64>,
}

impl Episodes<'_> {
    fn frame(&mut self, row: &RawRow) -> Result<(), DictionaryError> {
        let integer = |name: &str| match row.get(name) {
            Some(Scalar::Integer(n)) => Some(*n),
            _ => None,
        };
        let index = integer("episode_index").unwrap_or(0);
        if self.current.as_ref().is_some_and(|current| current.index != index) {
            self.finish()?;
        }
        let new = Current { index, task: integer("task_index"), frames: 0, success: None, reward: None };
        let current = self.current.get_or_insert(new);
        current.frames += 1;
        match row.get(SUCCESS) {
            Some(Scalar::Bool(success)) => *current.success.get_or_insert(false) |= success,
            Some(Scalar::Integer(n)) => *current.success.get_or_insert(false) |= *n != 0,
            _ => {}
        }
        if let Some(Scalar::Number(reward)) = row.get(REWARD) {
            *current.reward.get_or_insert(0.0) += reward;
        }
        Ok(())
    }

    /// Passes on the current episode.
    fn finish(&mut self) -> Result<(), DictionaryError> {
        let Some(current) = self.current.take() else { return Ok(()) };
        let number = |x: f64| Scalar::Number(x);
        let time = self.fps.map_or(Scalar::Null, |fps| number(current.frames as f64 / fps));
        let mut row = RawRow::default();
        row.number = self.seen;
        let mut push = |name: &str, value: Scalar| row.fields.push((name.into(), value));
        push("success", current.success.map_or(Scalar::Null, Scalar::Bool));
        push("cycle_time_s", time);
        push("episode_index", Scalar::Integer(current.index));
        if let Some(task) = current.task.and_then(|task| self.tasks.get(&task)) {
            push("category", Scalar::Text(task.clone()));
        }
        push("sum_reward", current.reward.map_or(Scalar::Null, number));
        self.seen += 1;
        (self.sink)(&row)
    }
}
