//! The Parquet record.

use std::path::{Path, PathBuf};

use crate::{DictionaryError, Entry, Provenance, SchemaVersion};

/// What was written.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Written {
    /// How many rows.
    pub rows: u64,
    /// The content hash of the rows ([`crate::dataset_hash`]), which the file carries too.
    pub dataset_hash: String,
}

/// Writes a dictionary row by row: memory is bounded by one row group, and the file is at `path`
/// only once it is complete.
#[derive(Debug)]
pub struct DictionaryWriter {}

impl DictionaryWriter {
    /// Begins a dictionary that will be at `path`.
    pub fn create(_path: &Path, _provenance: &Provenance) -> Result<Self, DictionaryError> {
        Ok(Self {})
    }

    /// Adds the next entry; its index must be above the one before.
    pub fn push(&mut self, _entry: &Entry) -> Result<(), DictionaryError> {
        Ok(())
    }

    /// Completes the file and puts it in its place.
    pub fn finish(self) -> Result<Written, DictionaryError> {
        Ok(Written { rows: 0, dataset_hash: String::new() })
    }
}

/// Writes the dictionary `path` from entries in rising order of index.
pub fn write_parquet(
    path: &Path,
    provenance: &Provenance,
    entries: impl Iterator<Item = Result<Entry, DictionaryError>>,
) -> Result<Written, DictionaryError> {
    let mut writer = DictionaryWriter::create(path, provenance)?;
    for entry in entries {
        writer.push(&entry?)?;
    }
    writer.finish()
}

/// A dictionary on disk.
#[derive(Debug)]
pub struct Dictionary {
    path: PathBuf,
    provenance: Provenance,
}

impl Dictionary {
    /// Opens a dictionary: its schema and provenance are read and checked, its rows are not.
    pub fn open(path: &Path) -> Result<Self, DictionaryError> {
        Err(DictionaryError::not_a_dictionary(path, "not yet"))
    }

    /// The file.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Where it comes from.
    pub fn provenance(&self) -> &Provenance {
        &self.provenance
    }

    /// The schema version of the file.
    pub fn schema_version(&self) -> SchemaVersion {
        self.provenance.schema_version
    }

    /// How many rows it has.
    pub fn len(&self) -> u64 {
        0
    }

    /// Whether it has none.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The content hash that was stored when it was written; [`crate::dataset_hash`] over
    /// [`Self::entries`] checks it.
    pub fn dataset_hash(&self) -> &str {
        ""
    }

    /// Every entry in order, one row group in memory at a time.
    pub fn entries(&self) -> Result<Entries<'_>, DictionaryError> {
        Ok(Entries { _dictionary: self })
    }

    /// One whole column.
    pub fn column(&self, _name: &str) -> Result<Column, DictionaryError> {
        Ok(Column::Numbers(Vec::new()))
    }
}

/// The entries of a dictionary.
#[derive(Debug)]
pub struct Entries<'a> {
    _dictionary: &'a Dictionary,
}

impl Iterator for Entries<'_> {
    type Item = Result<Entry, DictionaryError>;

    fn next(&mut self) -> Option<Self::Item> {
        None
    }
}

/// A column in memory; `None` is a missing value.
#[derive(Debug, Clone, PartialEq)]
pub enum Column {
    /// Real numbers.
    Numbers(Vec<Option<f64>>),
    /// Signed whole numbers.
    Integers(Vec<Option<i64>>),
    /// Whole numbers from 0.
    Counts(Vec<Option<u64>>),
    /// Words: each row has the position of its word in `words`, which stand in order of appearance.
    Categories {
        /// The distinct words.
        words: Vec<String>,
        /// For each row the position of its word.
        codes: Vec<Option<u32>>,
    },
}
