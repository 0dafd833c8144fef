//! The runs below a folder.

use std::fs;
use std::path::{Path, PathBuf};
use std::time::{SystemTime, UNIX_EPOCH};

use robogate_campaign::Summary;
use robogate_campaign::folder::{PLAN, SUMMARY};
use robogate_core::budget::Budget;
use robogate_dictionary::read_text;
use robogate_gate::Verdict;
use serde::Deserialize;
use serde::de::DeserializeOwned;

/// How deep runs are searched.
const DEPTH: usize = 4;
/// How many folders are opened.
const FOLDERS: usize = 10_000;

/// A run, as a list shows it.
#[derive(Debug)]
pub struct Run {
    /// Its folder.
    pub folder: PathBuf,
    /// When it was started, in seconds since 1970.
    pub started_s: u64,
    /// The task.
    pub task: String,
    /// The robot.
    pub robot: String,
    /// The policy.
    pub policy: String,
    /// Its summary. `None` while it is unfinished.
    pub summary: Option<Summary>,
    /// The verdict of its gate. `None` without a gate.
    pub verdict: Option<Verdict>,
}

#[derive(Deserialize)]
struct Judged {
    verdict: Verdict,
}

/// The runs below a folder, the newest first. A folder that cannot be read is left out, and so are the campaigns inside of a run.
pub fn runs_below(folder: &Path) -> Vec<Run> {
    let (mut runs, mut left) = (Vec::new(), FOLDERS);
    search(folder, DEPTH, &mut left, &mut runs);
    runs.sort_by(|a, b| b.started_s.cmp(&a.started_s).then_with(|| a.folder.cmp(&b.folder)));
    runs
}

fn search(folder: &Path, depth: usize, left: &mut usize, runs: &mut Vec<Run>) {
    if *left == 0 {
        return;
    }
    *left -= 1;
    if folder.join(PLAN).is_file() {
        runs.extend(run(folder));
        return;
    }
    let Some(depth) = depth.checked_sub(1) else { return };
    for entry in fs::read_dir(folder).into_iter().flatten().filter_map(Result::ok) {
        // A link could lead back.
        let is_folder = entry.file_type().is_ok_and(|kind| kind.is_dir());
        if is_folder && !entry.file_name().to_string_lossy().starts_with('.') {
            search(&entry.path(), depth, left, runs);
        }
    }
}

fn run(folder: &Path) -> Option<Run> {
    let provenance = robogate_campaign::settings(folder).ok()?.provenance;
    let started = fs::metadata(folder.join(PLAN)).and_then(|file| file.modified()).ok()?;
    Some(Run {
        folder: folder.to_owned(),
        started_s: seconds(started),
        task: provenance.task.name.to_string(),
        robot: provenance.robot.name.clone(),
        policy: provenance.policy.clone(),
        summary: document(&folder.join(SUMMARY)),
        verdict: document::<Judged>(&folder.join("gate.json")).map(|judged| judged.verdict),
    })
}

fn document<T: DeserializeOwned>(path: &Path) -> Option<T> {
    Budget::FILE.json(read_text(path).ok()?.as_bytes()).ok()
}

fn seconds(time: SystemTime) -> u64 {
    time.duration_since(UNIX_EPOCH).map_or(0, |since| since.as_secs())
}
