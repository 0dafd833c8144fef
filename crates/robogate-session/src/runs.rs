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

/// Seconds since 1970 as a date and time of day in UTC. The calendar repeats every 400 years (146,097 days).
pub fn utc(seconds: u64) -> String {
    let (days, of_day) = (seconds / 86_400, seconds % 86_400);
    let leap = |year: u64| year.is_multiple_of(4) && (!year.is_multiple_of(100) || year.is_multiple_of(400));
    let mut year = 1970 + 400 * (days / 146_097);
    let mut day = days % 146_097;
    while day >= 365 + u64::from(leap(year)) {
        day -= 365 + u64::from(leap(year));
        year += 1;
    }
    let lengths = [31, 28 + u64::from(leap(year)), 31, 30, 31, 30, 31, 31, 30, 31, 30, 31];
    let mut month = 1;
    for length in lengths {
        if day < length {
            break;
        }
        day -= length;
        month += 1;
    }
    format!("{year}-{month:02}-{:02} {:02}:{:02}", day + 1, of_day / 3600, of_day / 60 % 60)
}

#[cfg(test)]
mod tests {
    use super::utc;

    #[test]
    fn dates_follow_the_calendar() {
        // As `date -u -d @SECONDS` prints them.
        for (seconds, date) in [
            (0, "1970-01-01 00:00"),
            (951_782_400, "2000-02-29 00:00"),
            (1_709_251_199, "2024-02-29 23:59"),
            (1_796_000_000, "2026-11-30 00:53"),
            (4_107_542_400, "2100-03-01 00:00"),
        ] {
            assert_eq!(utc(seconds), date);
        }
    }
}
