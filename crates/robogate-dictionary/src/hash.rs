//! The content hash of a dictionary.

use std::borrow::Borrow;
use std::fmt::Write;
use std::fs::File;
use std::io::{self, Read};
use std::path::Path;
use std::sync::Arc;

use robogate_core::TaskSpec;
use sha2::{Digest, Sha256};

use crate::{DictionaryError, Entry, codec};

/// SHA-256 over the canonical form of every entry, in order. It identifies a dataset in any file format.
///
/// The bytes of a Parquet file depend on its writer's version and settings; this hash does not. Two campaigns have the
/// same hash exactly if they agree on every value of every row. Like Parquet, it ignores the order of the parameters,
/// the difference between an integer and the same real number, and the difference between a missing measure and one
/// that is not finite.
#[derive(Debug, Clone)]
pub struct DatasetHash {
    task: Arc<TaskSpec>,
    state: Sha256,
    row: Vec<u8>,
}

impl DatasetHash {
    /// Starts a hash without entries. The entries that follow are episodes of `task`.
    pub fn new(task: Arc<TaskSpec>) -> Self {
        // The prefix names the canonical form, so a change of the form changes every hash.
        Self { task, state: Sha256::new_with_prefix(b"robogate dataset 1\n"), row: Vec::new() }
    }

    /// Adds the next entry.
    pub fn update(&mut self, entry: &Entry) {
        self.row.clear();
        codec::encode_canonical(entry, &self.task, &mut self.row);
        self.state.update(&self.row);
    }

    /// The hash in hexadecimal.
    pub fn finish(self) -> String {
        hex(&self.state.finalize())
    }
}

/// The [`DatasetHash`] over entries of one task that may fail to be read. The first error ends it.
pub fn dataset_hash<E: Borrow<Entry>>(
    task: Arc<TaskSpec>,
    entries: impl IntoIterator<Item = Result<E, DictionaryError>>,
) -> Result<String, DictionaryError> {
    let mut hash = DatasetHash::new(task);
    for entry in entries {
        hash.update(entry?.borrow());
    }
    Ok(hash.finish())
}

/// Size and SHA-256 (hex) of a file, in bounded memory. `also` receives its content.
///
/// # Errors
/// If the file cannot be read, has more than `most` bytes, or `also` fails.
pub fn file_digest(path: &Path, most: u64, also: &mut dyn FnMut(&[u8]) -> io::Result<()>) -> io::Result<(u64, String)> {
    let (mut file, mut hash, mut bytes) = (File::open(path)?, Sha256::new(), 0);
    let mut part = vec![0; 1 << 20];
    loop {
        let read = file.read(&mut part)?;
        if read == 0 {
            return Ok((bytes, hex(&hash.finalize())));
        }
        bytes += read as u64;
        if bytes > most {
            return Err(io::Error::new(io::ErrorKind::FileTooLarge, format!("more than {} GiB", most >> 30)));
        }
        hash.update(&part[..read]);
        also(&part[..read])?;
    }
}

/// Formats bytes as lower-case hexadecimal.
pub fn hex(bytes: &[u8]) -> String {
    bytes.iter().fold(String::with_capacity(2 * bytes.len()), |mut text, byte| {
        // Writing to a string cannot fail.
        let _ = write!(text, "{byte:02x}");
        text
    })
}
