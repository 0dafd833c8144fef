//! The folder of a run: file names, lock, and atomic writes.

use std::fs::{self, File, OpenOptions, TryLockError};
use std::io::{self, Write};
use std::path::{Path, PathBuf};

use robogate_core::budget::Budget;
use robogate_dictionary::{PlanHash, files, read_text};
use serde::Serialize;
use serde::de::DeserializeOwned;
use sha2::{Digest, Sha256};

use crate::RunError;

/// The plan: everything that the run depends on. Written first.
pub const PLAN: &str = "plan.json";
/// The journal: the episodes of an unfinished run.
pub const JOURNAL: &str = "journal.rgj";
/// The boundary found by the first stage.
pub const BOUNDARY: &str = "boundary.json";
/// The models of the active stage.
pub const ACTIVE: &str = "active.json";
/// The division of a campaign into shards.
pub const LAYOUT: &str = "shards/layout.json";
/// The dictionary of a finished run.
pub const DICTIONARY: &str = "dictionary.parquet";
/// The summary of a finished run. Written last.
pub const SUMMARY: &str = "summary.json";

/// A locked folder, in which only this process works while the value lives.
#[derive(Debug)]
pub(crate) struct Folder {
    dir: PathBuf,
    /// The lock. The operating system releases it when the process ends for any reason.
    _lock: Option<File>,
}

impl Folder {
    /// Locks the existing folder `dir`.
    pub(crate) fn lock(dir: &Path) -> Result<Self, RunError> {
        let dir = dir.to_owned();
        // The lock is on the folder itself. A lock file would have to remain in the folder, or be deleted while another
        // process waits for it. If folders cannot be opened or locked (Windows, some network file systems), the
        // journal's lock protects the run while a journal exists.
        let lock = match File::open(&dir) {
            Ok(opened) => match opened.try_lock() {
                Ok(()) => Some(opened),
                Err(TryLockError::WouldBlock) => return Err(RunError::Locked { dir }),
                Err(TryLockError::Error(_)) => None,
            },
            Err(_) => None,
        };
        if lock.is_some() {
            remove_unfinished(&dir);
        }
        Ok(Self { dir, _lock: lock })
    }

    pub(crate) fn path(&self, name: &str) -> PathBuf {
        self.dir.join(name)
    }

    /// The folder itself.
    pub(crate) fn dir(&self) -> &Path {
        &self.dir
    }

    pub(crate) fn has(&self, name: &str) -> bool {
        self.path(name).exists()
    }

    /// The names of the files in the folder, without our own partial files.
    pub(crate) fn names(&self) -> Result<Vec<String>, RunError> {
        let mut names = names(&self.dir).map_err(RunError::io(&self.dir, "list"))?;
        names.retain(|name| !files::is_partial(name, PLAN));
        Ok(names)
    }

    /// The SHA-256 of the plan, which the journal names.
    pub(crate) fn plan_hash(&self) -> Result<PlanHash, RunError> {
        let path = self.path(PLAN);
        let text = fs::read(&path).map_err(RunError::io(&path, "read"))?;
        Ok(Sha256::digest(text).into())
    }

    /// Writes a JSON document atomically: complete or not at all, even after a power failure.
    pub(crate) fn write(&self, name: &str, document: &impl Serialize) -> Result<(), RunError> {
        let text = document_bytes(document).map_err(|error| RunError::io(&self.path(name), "write")(error.into()))?;
        self.write_bytes(name, &text)
    }

    /// Writes a file atomically, as [`Self::write`] does.
    pub(crate) fn write_bytes(&self, name: &str, bytes: &[u8]) -> Result<(), RunError> {
        let path = self.path(name);
        files::write(&path, bytes).map_err(RunError::io(&path, "write"))
    }

    /// Appends one line per document to a file of JSON lines.
    pub(crate) fn append(&self, name: &str, documents: &[impl Serialize]) -> Result<(), RunError> {
        let path = self.path(name);
        let append = || {
            let mut file = OpenOptions::new().append(true).create(true).open(&path)?;
            let before = file.metadata()?.len();
            let written = file.write_all(&json_lines(documents)?).and_then(|()| file.sync_data());
            // The next line must not follow half of one.
            written.inspect_err(|_| drop(file.set_len(before)))
        };
        append().map_err(RunError::io(&path, "write"))
    }

    pub(crate) fn remove(&self, name: &str) -> Result<(), RunError> {
        let path = self.path(name);
        fs::remove_file(&path).and_then(|()| files::sync_folder(&self.dir)).map_err(RunError::io(&path, "remove"))
    }
}

/// Removes the files that a killed process did not complete. No other process works in the locked folder.
fn remove_unfinished(dir: &Path) {
    for name in names(dir).unwrap_or_default() {
        if name.starts_with('.')
            && name.ends_with(".part")
            && fs::symlink_metadata(dir.join(&name)).is_ok_and(|it| it.is_file())
        {
            // What cannot be removed is overwritten by the next attempt.
            let _ = fs::remove_file(dir.join(name));
        }
    }
}

/// The sorted names in the folder `dir`.
pub(crate) fn names(dir: &Path) -> io::Result<Vec<String>> {
    let mut names = fs::read_dir(dir)?
        .map(|entry| Ok(entry?.file_name().to_string_lossy().into_owned()))
        .collect::<io::Result<Vec<_>>>()?;
    names.sort();
    Ok(names)
}

/// The bytes of JSON documents with one line each.
pub(crate) fn json_lines(documents: &[impl Serialize]) -> serde_json::Result<Vec<u8>> {
    let mut lines = Vec::new();
    for document in documents {
        serde_json::to_writer(&mut lines, document)?;
        lines.push(b'\n');
    }
    Ok(lines)
}

/// The bytes of a JSON document as this crate writes it.
pub(crate) fn document_bytes(document: &impl Serialize) -> serde_json::Result<Vec<u8>> {
    let mut text = serde_json::to_vec_pretty(document)?;
    text.push(b'\n');
    Ok(text)
}

/// Reads a JSON document that this crate wrote.
pub(crate) fn read<T: DeserializeOwned>(path: &Path) -> Result<T, RunError> {
    parse(path, read_text(path).map_err(RunError::io(path, "read"))?.as_bytes())
}

/// Parses the content of the file `path`, a JSON document that this crate wrote.
pub(crate) fn parse<T: DeserializeOwned>(path: &Path, text: &[u8]) -> Result<T, RunError> {
    Budget::FILE.check_json(text).map_err(|e| RunError::io(path, "read")(io::Error::other(e)))?;
    serde_json::from_slice(text).map_err(|source| RunError::Unreadable { path: path.to_owned(), source })
}
