//! The signals of the episodes of a run: what the policy saw and did in each control period, in one file of the run's folder.
//!
//! The file is one line of JSON ([`Header`]), then one record for each episode in order of index: index and trajectory hash
//! (u64), number of control periods and of numbers in each (u32), then for each control period the time in seconds, the numbers
//! of [`Signals`] and the measures of the task, as f32. All numbers are little endian; NaN stands for a missing one. The hash
//! binds a record to its row of the dictionary.

use std::collections::BTreeMap;
use std::fs::{self, File, OpenOptions};
use std::io::{self, BufRead, BufReader, BufWriter, ErrorKind, Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};

use anyhow::{Context, anyhow, bail};
use robogate_campaign::EpisodeObserver;
use robogate_core::{Episode, Outcome, Signals, TaskSpec, Tick, Word, measure_row};
use robogate_dictionary::files;
use serde::{Deserialize, Serialize};

use crate::failure::{Failure, OrFailure};
use crate::notice::warning;

/// The file in the folder of a run.
pub const SIGNALS: &str = "signals.rgs";

/// The version of the format.
const FORMAT: u32 = 1;
/// The longest first line.
const LONGEST_HEADER: u64 = 1 << 20;
/// The most numbers of an episode, and the most in a control period.
const MOST_NUMBERS: u64 = 1 << 26;
const WIDEST: u32 = 1 << 16;
/// Bytes before the numbers of a record.
const HEAD: usize = 24;

/// The first line of the file.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Header {
    format: u32,
    /// The task.
    pub task: Word,
    /// The signals.
    pub signals: Signals,
    /// The measures of each control period, after the signals.
    pub measures: Vec<Word>,
}

impl Header {
    /// The first line of a file.
    fn line(&self) -> anyhow::Result<Vec<u8>> {
        let mut line = serde_json::to_vec(self)?;
        line.push(b'\n');
        Ok(line)
    }

    /// The header of the file of a run of this task.
    pub fn of(task: &TaskSpec) -> Self {
        let measures = task.measures.iter().map(|measure| measure.name).collect();
        Self { format: FORMAT, task: task.name, signals: Signals::of(task), measures }
    }

    /// How many numbers a control period has.
    pub fn width(&self) -> usize {
        1 + self.signals.width() + self.measures.len()
    }
}

/// The signals of one episode.
#[derive(Debug, Clone, PartialEq)]
pub struct EpisodeSignals {
    /// The index of the episode.
    pub index: u64,
    /// The hash of its trajectory.
    pub trajectory_hash: u64,
    /// [`Header::width`] numbers for each control period.
    pub numbers: Vec<f32>,
}

/// The open file of a run, which its episodes share. Nothing is written while it is closed.
#[derive(Debug, Clone, Default)]
pub(crate) struct SignalLog(Arc<Mutex<Option<File>>>);

impl SignalLog {
    /// Makes the records so far safe on disk. An error shows at the end, when the file is written again.
    pub(crate) fn sync(&self) {
        if let Some(file) = &*self.0.lock().unwrap_or_else(PoisonError::into_inner) {
            let _ = file.sync_data();
        }
    }

    /// Opens the file in the folder of a run, or continues it.
    fn open(&self, run: &Path, header: &Header) -> anyhow::Result<()> {
        let path = run.join(SIGNALS);
        let file = if path.exists() {
            let (found, _) = opened(&path)?;
            if found != *header {
                bail!("{}: it has the signals of another task\nHint: remove the file", path.display());
            }
            cut(&path)?;
            OpenOptions::new().append(true).open(&path)
        } else {
            files::write(&path, header.line()?).and_then(|()| OpenOptions::new().append(true).open(&path))
        };
        let file = file.with_context(|| format!("cannot write {}", path.display()))?;
        *self.0.lock().unwrap_or_else(PoisonError::into_inner) = Some(file);
        Ok(())
    }

    /// Ends recording. Returns whether the file was open.
    fn close(&self) -> bool {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).take().is_some()
    }

    /// The observer of an episode. `None` while the file is closed.
    pub(crate) fn observer(&self, task: &Arc<TaskSpec>) -> Option<Box<dyn EpisodeObserver>> {
        let open = self.0.lock().unwrap_or_else(PoisonError::into_inner).is_some();
        let header = open.then(|| Header::of(task))?;
        let (task, row) = (Arc::clone(task), vec![f32::NAN; header.width()]);
        Some(Box::new(Recording { log: self.clone(), task, header, row, bytes: vec![0; HEAD], ticks: 0 }))
    }
}

/// The record of an episode that runs.
struct Recording {
    log: SignalLog,
    task: Arc<TaskSpec>,
    header: Header,
    row: Vec<f32>,
    bytes: Vec<u8>,
    ticks: u32,
}

impl EpisodeObserver for Recording {
    fn observe(&mut self, tick: &Tick<'_>) {
        let Self { task, header, row, bytes, ticks, .. } = self;
        let (signals, measures) = row[1..].split_at_mut(header.signals.width());
        header.signals.write(tick.observation, tick.action, signals);
        measure_row(task, &tick.step.measures, measures);
        row[0] = tick.observation.time_s as f32;
        row.iter().for_each(|x| bytes.extend(x.to_le_bytes()));
        *ticks += 1;
    }

    fn finish(mut self: Box<Self>, episode: &Episode) {
        if matches!(episode.outcome, Outcome::Invalid(_)) {
            return;
        }
        self.bytes[..8].copy_from_slice(&episode.scenario.index.to_le_bytes());
        self.bytes[8..16].copy_from_slice(&episode.trajectory_hash.to_le_bytes());
        self.bytes[16..20].copy_from_slice(&self.ticks.to_le_bytes());
        self.bytes[20..24].copy_from_slice(&(self.row.len() as u32).to_le_bytes());
        let mut file = self.log.0.lock().unwrap_or_else(PoisonError::into_inner);
        let Some(open) = &mut *file else { return };
        let before = open.metadata().map(|metadata| metadata.len());
        if let Err(why) = open.write_all(&self.bytes) {
            // The episodes have their result. Half of a record is not read, but should not stay.
            let _ = before.and_then(|length| open.set_len(length));
            warning(format!("{SIGNALS} cannot be written, so no further signals are recorded: {why}"));
            *file = None;
        }
    }
}

/// The file of signals without records, which a run has from its start.
pub(crate) fn empty(task: &TaskSpec) -> Result<Vec<u8>, Failure> {
    Header::of(task).line().or_broken()
}

/// Begins to record signals of a run: into its folder, from the next episode on.
pub(crate) fn begin(log: &SignalLog, run: &Path, task: &TaskSpec) -> Result<(), Failure> {
    log.open(run, &Header::of(task)).or_request()
}

/// Removes what follows the last whole record of a file: a killed process or a power failure has left it.
fn cut(path: &Path) -> anyhow::Result<()> {
    let (header, mut reader) = opened(path)?;
    let mut end = reader.stream_position()?;
    // A record that is damaged ends the whole ones too. The episodes behind it have no signals then.
    loop {
        match record(&mut reader, header.width()) {
            Ok(Some(_)) => end = reader.stream_position()?,
            Ok(None) => break,
            // A disk that cannot be read says nothing about what is on it.
            Err(error) if is_unreadable(&error) => return Err(error),
            Err(_) => break,
        }
    }
    let shorten = || {
        let file = OpenOptions::new().write(true).open(path)?;
        if file.metadata()?.len() > end { file.set_len(end) } else { Ok(()) }
    };
    shorten().with_context(|| format!("cannot write {}", path.display()))
}

fn is_unreadable(error: &anyhow::Error) -> bool {
    let of_the_disk =
        |error: &io::Error| error.kind() != io::ErrorKind::UnexpectedEof && error.raw_os_error().is_some();
    error.chain().filter_map(|cause| cause.downcast_ref::<io::Error>()).any(of_the_disk)
}

/// Ends recording, and brings the records into the order of their indices: the file does not depend on threads.
pub(crate) fn end(log: &SignalLog, run: &Path) -> Result<(), Failure> {
    let path = run.join(SIGNALS);
    if log.close() {
        sort(&path).with_context(|| format!("cannot write {}", path.display())).or_broken()
    } else {
        Ok(())
    }
}

/// Writes the records again in the order of their indices. The last record of an index is kept.
fn sort(path: &Path) -> anyhow::Result<()> {
    let (header, mut reader) = opened(path)?;
    let mut places: BTreeMap<u64, (u64, u64)> = BTreeMap::new();
    let mut at = reader.stream_position()?;
    while let Some(episode) = record(&mut reader, header.width())? {
        let next = reader.stream_position()?;
        places.insert(episode.index, (at, next - at));
        at = next;
    }
    let part = path.with_file_name(files::partial(SIGNALS));
    let mut to = BufWriter::new(File::create(&part)?);
    to.write_all(&header.line()?)?;
    for (at, length) in places.into_values() {
        reader.seek(SeekFrom::Start(at))?;
        io::copy(&mut reader.by_ref().take(length), &mut to)?;
    }
    to.into_inner()?.sync_all()?;
    fs::rename(&part, path)?;
    Ok(files::sync_parent(path)?)
}

fn opened(path: &Path) -> anyhow::Result<(Header, BufReader<File>)> {
    let file = File::open(path).with_context(|| format!("cannot read {}", path.display()))?;
    let mut reader = BufReader::new(file);
    let mut line = Vec::new();
    reader.by_ref().take(LONGEST_HEADER).read_until(b'\n', &mut line)?;
    let header: Header = serde_json::from_slice(&line)
        .with_context(|| format!("{}: not a file of signals\nHint: remove it", path.display()))?;
    let wide = header.signals.checked_width();
    if header.format != FORMAT || wide.is_none_or(|wide| wide + header.measures.len() >= WIDEST as usize) {
        bail!("{}: its format is not one that this version reads\nHint: remove the file", path.display());
    }
    Ok((header, reader))
}

/// The next record. `None` at the end, and for a record that lacks its end.
fn record(reader: &mut BufReader<File>, width: usize) -> anyhow::Result<Option<EpisodeSignals>> {
    let mut head = [0; HEAD];
    match reader.read_exact(&mut head) {
        Err(error) if error.kind() == ErrorKind::UnexpectedEof => return Ok(None),
        other => other?,
    }
    let long = |at: usize| u64::from_le_bytes(std::array::from_fn(|i| head[at + i]));
    let short = |at: usize| u32::from_le_bytes(std::array::from_fn(|i| head[at + i]));
    let (ticks, wide) = (short(16), short(20));
    let numbers = u64::from(ticks) * u64::from(wide);
    if wide as usize != width || numbers > MOST_NUMBERS {
        bail!("{SIGNALS}: the record of episode {} is damaged\nHint: remove the file", long(0));
    }
    let mut bytes = Vec::new();
    reader.by_ref().take(4 * numbers).read_to_end(&mut bytes)?;
    if bytes.len() as u64 != 4 * numbers {
        return Ok(None);
    }
    let numbers = bytes.chunks_exact(4).map(|x| f32::from_le_bytes([x[0], x[1], x[2], x[3]])).collect();
    Ok(Some(EpisodeSignals { index: long(0), trajectory_hash: long(8), numbers }))
}

/// Reads the signals of a run, episode by episode.
///
/// # Errors
/// A run without them, or a damaged file.
pub fn read_signals(run: &Path, receive: &mut dyn FnMut(&Header, EpisodeSignals)) -> Result<Header, Failure> {
    let path: PathBuf = run.join(SIGNALS);
    if !path.is_file() {
        return Err(anyhow!(
            "{}: it has no {SIGNALS}\nHint: repeat the run with `robogate run --record-signals`",
            run.display()
        ))
        .or_request();
    }
    let (header, mut reader) = opened(&path).or_request()?;
    let about = || format!("cannot read {}", path.display());
    while let Some(episode) = record(&mut reader, header.width()).with_context(about).or_request()? {
        receive(&header, episode);
    }
    Ok(header)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn header() -> Header {
        let signals = Signals { period_s: 0.1, groups: Vec::new(), gripper_in_vector: None };
        Header { format: FORMAT, task: Word::constant("reach"), signals, measures: vec![Word::constant("force_n")] }
    }

    fn bytes(index: u64, hash: u64, values: &[f32]) -> Vec<u8> {
        let mut bytes: Vec<u8> = [index, hash].into_iter().flat_map(u64::to_le_bytes).collect();
        bytes.extend([values.len() as u32 / 2, 2].into_iter().flat_map(u32::to_le_bytes));
        bytes.extend(values.iter().flat_map(|x| x.to_le_bytes()));
        bytes
    }

    #[test]
    fn records_are_sorted_and_the_last_counts() {
        let dir = tempfile::tempdir().unwrap();
        let log = SignalLog::default();
        log.open(dir.path(), &header()).unwrap();
        let cut = &bytes(9, 9, &[0.0, 1.0, 0.1, 2.0])[..30];
        let written =
            [&bytes(2, 20, &[0.0, 1.0]), &bytes(1, 10, &[0.0, 2.0]), &bytes(2, 21, &[0.0, 3.0, 0.1, 4.0]), cut];
        let file = dir.path().join(SIGNALS);
        OpenOptions::new().append(true).open(file).unwrap().write_all(&written.concat()).unwrap();
        end(&log, dir.path()).unwrap();
        let mut found = Vec::new();
        read_signals(dir.path(), &mut |_, episode| {
            found.push((episode.index, episode.trajectory_hash, episode.numbers))
        })
        .unwrap();
        assert_eq!(found, [(1, 10, vec![0.0, 2.0]), (2, 21, vec![0.0, 3.0, 0.1, 4.0])]);
    }

    /// A resumed run continues behind the last whole record.
    #[test]
    fn records_that_lack_their_end_are_removed() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join(SIGNALS);
        let mut hole = bytes(5, 50, &[0.0, 1.0]);
        hole[16..].fill(0);
        for left in [&bytes(9, 9, &[0.0, 1.0, 0.1, 2.0])[..30], &hole] {
            let log = SignalLog::default();
            log.open(dir.path(), &header()).unwrap();
            assert!(log.close());
            let append = |bytes: &[u8]| OpenOptions::new().append(true).open(&path).unwrap().write_all(bytes).unwrap();
            append(&[&bytes(1, 10, &[0.0, 2.0]), left].concat());
            log.open(dir.path(), &header()).unwrap();
            append(&bytes(2, 20, &[0.0, 1.0]));
            end(&log, dir.path()).unwrap();
            let mut found = Vec::new();
            read_signals(dir.path(), &mut |_, episode| found.push(episode.index)).unwrap();
            assert_eq!(found, [1, 2]);
            fs::remove_file(&path).unwrap();
        }
    }

    #[test]
    fn damaged_file_is_an_error() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join(SIGNALS);
        let mut line = serde_json::to_vec(&header()).unwrap();
        line.push(b'\n');
        let mut huge = bytes(1, 1, &[]);
        huge[16..24].fill(0xff);
        for content in [b"{}".to_vec(), [line, huge].concat()] {
            fs::write(&path, content).unwrap();
            assert!(read_signals(dir.path(), &mut |_, _| {}).is_err());
        }
    }
}
