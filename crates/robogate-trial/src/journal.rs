//! The journal of a study: lines of JSON that are only appended, each with a code over itself and all lines before.
//!
//! The code of a line is HMAC-SHA-256 over the code of the line before and the text of the record, with the secret of the study
//! as its key. Who changes, removes or reorders a line cannot write the codes that follow. A second file, the head, states the number of
//! lines with a code over it and the last line, so that a line missing at the end is found too: the journal contains no code of a
//! head. Each line is on disk before its event is acknowledged. An incomplete last line is the rest of an event that was never
//! acknowledged; it is removed.

use std::fs::{File, OpenOptions};
use std::io::{Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

use robogate_core::budget::Budget;

use crate::{Event, Moment, Problem, Record, Secret};

/// Name of the journal in the folder of a study.
pub const JOURNAL: &str = "journal.jsonl";
/// Name of the head in the folder of a study.
pub const HEAD: &str = "journal.head";
/// Longest line, in bytes.
const LONGEST: usize = 1 << 16;
/// Between the record and its code.
const BETWEEN: &str = ",\"mac\":\"";
/// Digits of a code.
const DIGITS: usize = 64;

/// A journal that is open for writing. One process at a time.
#[derive(Debug)]
pub struct Journal {
    file: File,
    path: PathBuf,
    secret: Secret,
    next: u64,
    last: String,
    /// Set when a write failed: what is on disk is then unknown until the journal is opened again.
    broken: bool,
}

/// The content of a journal.
#[derive(Debug, Default)]
struct Content {
    records: Vec<Record>,
    /// Code of the last line.
    last: String,
    /// Bytes of the complete lines.
    complete: u64,
}

impl Journal {
    /// Opens the journal in `folder` for writing, and creates it if `new`. Returns the records so far.
    ///
    /// # Errors
    /// If it cannot be read or written, another process writes it, or it was changed.
    pub fn open(folder: &Path, secret: &Secret, new: bool) -> Result<(Self, Vec<Record>), Problem> {
        let path = folder.join(JOURNAL);
        let failed = |error: std::io::Error| Problem::File { path: path.clone(), reason: error.to_string() };
        let mut options = OpenOptions::new();
        options.read(true).append(true).create_new(new);
        let mut file = options.open(&path).map_err(failed)?;
        match file.try_lock() {
            Ok(()) => {}
            Err(std::fs::TryLockError::WouldBlock) => return Err(Problem::InUse(folder.to_owned())),
            Err(std::fs::TryLockError::Error(error)) => return Err(failed(error)),
        }
        let content = read(&mut file, &path, secret, head(folder)?)?;
        file.set_len(content.complete).and_then(|()| file.sync_all()).map_err(failed)?;
        if new {
            File::open(folder).and_then(|folder| folder.sync_all()).map_err(failed)?;
        }
        let next = content.records.len() as u64;
        let mut journal = Self { file, path, secret: secret.clone(), next, last: content.last, broken: false };
        if next > 0 {
            journal.write_head()?;
        }
        Ok((journal, content.records))
    }

    /// Reads and checks the journal in `folder`, also while another process writes it.
    ///
    /// # Errors
    /// If it cannot be read, or was changed.
    pub fn read(folder: &Path, secret: &Secret) -> Result<Vec<Record>, Problem> {
        let path = folder.join(JOURNAL);
        // The head is read first: the journal is never behind it.
        let head = head(folder)?;
        let mut file =
            File::open(&path).map_err(|error| Problem::File { path: path.clone(), reason: error.to_string() })?;
        Ok(read(&mut file, &path, secret, head)?.records)
    }

    /// Appends an event. When this returns, the event is on disk.
    ///
    /// # Errors
    /// If it cannot be written. The journal then accepts no further event.
    pub fn append(&mut self, at: Moment, id: &str, event: Event) -> Result<Record, Problem> {
        if self.broken {
            let reason = "an earlier write failed. Start the server again".to_owned();
            return Err(Problem::File { path: self.path.clone(), reason });
        }
        let record = Record { n: self.next, at, id: id.to_owned(), event };
        let text = serde_json::to_string(&record).unwrap_or_default();
        let mac = self.secret.mac(format!("{}{text}", self.last).as_bytes());
        let line = format!("{{\"record\":{text}{BETWEEN}{mac}\"}}\n");
        if line.len() > LONGEST {
            return Err(Problem::Refused(format!(
                "the record has {} bytes. At most {LONGEST} are accepted",
                line.len()
            )));
        }
        if let Err(error) = self.file.write_all(line.as_bytes()).and_then(|()| self.file.sync_data()) {
            self.broken = true;
            return Err(Problem::File { path: self.path.clone(), reason: error.to_string() });
        }
        self.next += 1;
        self.last = mac;
        self.write_head()?;
        Ok(record)
    }

    /// Replaces the head.
    fn write_head(&mut self) -> Result<(), Problem> {
        let path = self.path.with_file_name(HEAD);
        let text = format!("{} {}\n", self.next, head_mac(&self.secret, self.next, &self.last));
        robogate_dictionary::files::write(&path, text).map_err(|error| {
            self.broken = true;
            Problem::File { path, reason: error.to_string() }
        })
    }
}

/// The code of a head. No record begins like its message, so no line has this code.
fn head_mac(secret: &Secret, lines: u64, last: &str) -> String {
    secret.mac(format!("head {lines} {last}").as_bytes())
}

/// The number of lines and the code of the head, as it states them. `None` if there is no head.
fn head(folder: &Path) -> Result<Option<(u64, String)>, Problem> {
    let path = folder.join(HEAD);
    let text = match robogate_dictionary::read_regular_text(&path) {
        Ok(text) => text,
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(None),
        Err(error) => return Err(Problem::File { path, reason: error.to_string() }),
    };
    let parsed = text.trim_end().split_once(' ').and_then(|(n, mac)| Some((n.parse::<u64>().ok()?, mac.to_owned())));
    // A head is written after a line. One of no lines would name none, and its code would not be checked.
    parsed.filter(|(n, _)| *n > 0).map(Some).ok_or_else(|| Problem::Changed {
        path,
        line: 1,
        reason: "it is not the head of a journal".to_owned(),
    })
}

/// Reads and checks a journal.
fn read(file: &mut File, path: &Path, secret: &Secret, head: Option<(u64, String)>) -> Result<Content, Problem> {
    let failed = |reason: String| Problem::File { path: path.to_owned(), reason };
    let changed = |line: usize, reason: &str| Problem::Changed {
        path: path.to_owned(),
        line: line as u64 + 1,
        reason: reason.to_owned(),
    };
    let most = Budget::FILE.bytes;
    let mut bytes = Vec::new();
    file.seek(SeekFrom::Start(0)).map_err(|error| failed(error.to_string()))?;
    file.take(most as u64 + 1).read_to_end(&mut bytes).map_err(|error| failed(error.to_string()))?;
    Budget::FILE.check_bytes(bytes.len()).map_err(|error| failed(error.to_string()))?;
    let mut content = Content::default();
    for (at, line) in bytes.split_inclusive(|byte| *byte == b'\n').enumerate() {
        let Some(line) = line.strip_suffix(b"\n") else { break };
        let text = std::str::from_utf8(line).map_err(|_| changed(at, "it is not UTF-8"))?;
        let record = parsed(text, &content.last, secret).map_err(|reason| changed(at, &reason))?;
        if record.0.n != at as u64 {
            return Err(changed(at, "it has the number of another line"));
        }
        content.complete += line.len() as u64 + 1;
        content.records.push(record.0);
        content.last = record.1;
        if let Some((n, mac)) = &head
            && *n == content.records.len() as u64
            && *mac != head_mac(secret, *n, &content.last)
        {
            return Err(changed(at, "it is not the line that the head names"));
        }
    }
    let lines = content.records.len();
    if head.as_ref().is_some_and(|(n, _)| *n > lines as u64) || (head.is_none() && lines > 0) {
        return Err(changed(lines, "lines are missing at the end, or the file that states their number"));
    }
    Ok(content)
}

/// The record and the code of a line, after the line whose code is `before`.
fn parsed(line: &str, before: &str, secret: &Secret) -> Result<(Record, String), String> {
    let inner = line.strip_prefix("{\"record\":").and_then(|rest| rest.strip_suffix("\"}"));
    let cut = inner.and_then(|inner| inner.len().checked_sub(DIGITS)).filter(|_| line.len() <= LONGEST);
    let parts = inner.zip(cut).and_then(|(inner, cut)| inner.split_at_checked(cut));
    let (text, mac) = parts
        .and_then(|(text, mac)| Some((text.strip_suffix(BETWEEN)?, mac)))
        .ok_or_else(|| "it is not a record with its code".to_owned())?;
    if secret.mac(format!("{before}{text}").as_bytes()) != mac {
        return Err("its code does not match: it or a line before was changed, removed or moved".to_owned());
    }
    let record = Budget::FILE.json(text.as_bytes()).map_err(|error| format!("it is not a record: {error}"))?;
    Ok((record, mac.to_owned()))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn event(code: usize) -> Event {
        Event::Start { code: format!("C{code}"), operator: "Ada".to_owned() }
    }

    fn written(lines: usize) -> (tempfile::TempDir, Secret) {
        let folder = tempfile::tempdir().unwrap();
        let secret = Secret::draw().unwrap();
        let (mut journal, records) = Journal::open(folder.path(), &secret, true).unwrap();
        assert!(records.is_empty());
        for n in 0..lines {
            journal.append(Moment::now(), "id", event(n)).unwrap();
        }
        (folder, secret)
    }

    #[test]
    fn every_change_is_found() {
        let (folder, secret) = written(6);
        let path = folder.path().join(JOURNAL);
        let whole = std::fs::read_to_string(&path).unwrap();
        let lines: Vec<&str> = whole.lines().collect();
        assert_eq!(Journal::read(folder.path(), &secret).unwrap().len(), 6);
        let mut changed: Vec<Vec<String>> = Vec::new();
        for at in 0..6 {
            let mut removed: Vec<String> = lines.iter().map(|line| (*line).to_owned()).collect();
            let mut edited = removed.clone();
            edited[at] = edited[at].replace(&format!("C{at}"), "C9");
            let mut twice = removed.clone();
            twice.insert(at, removed[at].clone());
            if at > 0 {
                let mut swapped = removed.clone();
                swapped.swap(at - 1, at);
                changed.push(swapped);
            }
            removed.remove(at);
            changed.extend([removed, edited, twice]);
        }
        for lines in changed {
            std::fs::write(&path, lines.join("\n") + "\n").unwrap();
            let found = Journal::read(folder.path(), &secret);
            assert!(matches!(found, Err(Problem::Changed { .. })), "{lines:#?}: {found:?}");
            assert!(matches!(Journal::open(folder.path(), &secret, false), Err(Problem::Changed { .. })));
        }
        // Each byte counts.
        for at in 0..whole.len() {
            let mut bytes = whole.clone().into_bytes();
            bytes[at] ^= 1;
            std::fs::write(&path, bytes).unwrap();
            assert!(Journal::read(folder.path(), &secret).is_err(), "byte {at}");
        }
        // A shorter file whose head was removed too.
        std::fs::write(&path, lines[..3].join("\n") + "\n").unwrap();
        std::fs::remove_file(folder.path().join(HEAD)).unwrap();
        assert!(Journal::read(folder.path(), &secret).is_err());
    }

    /// A killed process leaves any part of the last line, and a head that is one line behind.
    #[test]
    fn incomplete_last_line_is_removed() {
        let (folder, secret) = written(3);
        let path = folder.path().join(JOURNAL);
        let head = std::fs::read(folder.path().join(HEAD)).unwrap();
        let before = std::fs::read(&path).unwrap();
        let (mut journal, _) = Journal::open(folder.path(), &secret, false).unwrap();
        journal.append(Moment::now(), "", event(3)).unwrap();
        drop(journal);
        let after = std::fs::read(&path).unwrap();
        for end in before.len()..=after.len() {
            std::fs::write(&path, &after[..end]).unwrap();
            std::fs::write(folder.path().join(HEAD), &head).unwrap();
            let complete = usize::from(end == after.len());
            assert_eq!(Journal::read(folder.path(), &secret).unwrap().len(), 3 + complete);
            let (mut journal, records) = Journal::open(folder.path(), &secret, false).unwrap();
            assert_eq!(records.len(), 3 + complete, "{end}");
            journal.append(Moment::now(), "", event(9)).unwrap();
            drop(journal);
            assert_eq!(Journal::read(folder.path(), &secret).unwrap().len(), 4 + complete);
        }
    }

    #[test]
    fn one_process_writes() {
        let (folder, secret) = written(1);
        let (_journal, _) = Journal::open(folder.path(), &secret, false).unwrap();
        assert!(matches!(Journal::open(folder.path(), &secret, false), Err(Problem::InUse(_))));
        assert_eq!(Journal::read(folder.path(), &secret).unwrap().len(), 1);
    }
}
