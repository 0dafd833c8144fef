//! Recordings as feeds of `robogate monitor serve`: MCAP files, and folders of rosbag2 with this storage.

use std::cell::RefCell;
use std::collections::BTreeSet;
use std::fs::File;
use std::io::{self, BufReader};
use std::path::{Path, PathBuf};

use robogate_core::guard::guarded;
use robogate_monitor::Cycle;
use robogate_monitor::service::{TopicMap, TopicReader};
use robogate_monitor::warn::Period;
use robogate_replay::read_mcap;

/// Whether a feed is a recording and not lines.
pub(super) fn is_bag(path: &Path) -> bool {
    path.is_dir() || has(path, "mcap")
}

fn has(path: &Path, extension: &str) -> bool {
    path.extension().is_some_and(|found| found == extension)
}

/// The files of a recording: the file itself, or those of a folder in the order of their numbers.
pub(super) fn files(path: &Path) -> Result<Vec<PathBuf>, String> {
    if !path.is_dir() {
        return Ok(vec![path.to_owned()]);
    }
    let entries =
        path.read_dir().and_then(|entries| entries.map(|entry| Ok(entry?.path())).collect::<io::Result<Vec<_>>>());
    let entries = entries.map_err(|error| format!("{}: {error}", path.display()))?;
    let (mut files, others): (Vec<PathBuf>, Vec<PathBuf>) = entries.into_iter().partition(|path| has(path, "mcap"));
    if files.is_empty() {
        let reason = if others.iter().any(|path| has(path, "db3")) {
            "its storage is SQLite. Expected MCAP\nHint: convert it with `ros2 bag convert` and `storage_id: mcap`"
        } else {
            "no .mcap file in this folder. Expected cycles as lines, an MCAP file, or a folder of rosbag2"
        };
        return Err(format!("{}: {reason}", path.display()));
    }
    // NAME_10.mcap comes after NAME_9.mcap.
    files.sort_by_cached_key(|path| {
        let name = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        let stem = name.trim_end_matches(|c: char| c.is_ascii_digit());
        (stem.to_owned(), name[stem.len()..].parse::<u64>().unwrap_or(0), name.clone())
    });
    Ok(files)
}

/// What a recording contains: a cycle, or control periods with their time.
pub(super) enum Found {
    Cycle(Result<Cycle, String>),
    Periods(Vec<Result<Period, String>>, f64),
}

/// Reads the cycles of a recording.
pub(super) fn cycles(
    path: &Path,
    map: TopicMap,
    each: &mut dyn FnMut(Found) -> Result<(), String>,
) -> Result<(), String> {
    let mut reader = TopicReader::new(map.clone());
    let topics = map.topics();
    let recorded = RefCell::new(BTreeSet::new());
    let wanted = |topic: &str| {
        // A few names are enough for a message.
        if recorded.borrow().len() < 1_000 {
            recorded.borrow_mut().insert(topic.to_owned());
        }
        topics.contains_key(topic)
    };
    for file in files(path)? {
        let input = File::open(&file).map_err(|error| format!("cannot read {}: {error}", file.display()))?;
        let input = BufReader::with_capacity(1 << 20, input);
        let read = guarded(|| {
            read_mcap(input, &wanted, &mut |message| {
                let cycle = reader.observe(&message.topic, message.time_s, message.message);
                let periods = reader.take_periods();
                if !periods.is_empty() {
                    each(Found::Periods(periods, message.time_s))?;
                }
                cycle.map_or(Ok(()), |cycle| each(Found::Cycle(cycle)))
            })
        });
        read.and_then(|read| read).map_err(|error| format!("{}: {error}", file.display()))?;
    }
    let recorded = recorded.into_inner();
    if !recorded.contains(&map.end.topic) && recorded.len() < 1_000 {
        let names = recorded.iter().map(String::as_str).collect::<Vec<_>>().join(", ");
        let (path, topic) = (path.display(), &map.end.topic);
        return Err(format!("{path}: no topic {topic}. Its topics: {names}\nHint: change [end] of --topics"));
    }
    Ok(())
}
