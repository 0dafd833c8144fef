//! Atomic file writes: a file is complete or absent.

use std::fs::{self, File};
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};

use crate::DictionaryError;
use crate::files::{partial_path, sync_parent};

/// A file that is written under a temporary name and renamed once it is complete.
///
/// The temporary name is fixed (`.NAME.part`), so the next process overwrites the remains of a killed one.
#[derive(Debug)]
pub(crate) struct AtomicFile {
    /// `None` after the rename.
    file: Option<BufWriter<File>>,
    partial: PathBuf,
    path: PathBuf,
}

impl AtomicFile {
    /// Creates the temporary file for `path`.
    pub(crate) fn create(path: &Path) -> Result<Self, DictionaryError> {
        let partial = partial_path(path).map_err(DictionaryError::io(path, "create"))?;
        if path.is_dir() {
            return Err(DictionaryError::io(path, "create")(io::ErrorKind::IsADirectory.into()));
        }
        // Renaming over a device or a pipe would replace it with a regular file.
        if fs::metadata(path).is_ok_and(|there| !there.is_file()) {
            return Err(DictionaryError::io(path, "create")(io::Error::new(
                io::ErrorKind::InvalidInput,
                "the path exists and is not a regular file",
            )));
        }
        let file = File::create(&partial).map_err(DictionaryError::io(&partial, "create"))?;
        Ok(Self { file: Some(BufWriter::new(file)), partial, path: path.to_owned() })
    }

    /// Renames the complete file to its final path and flushes both, so that it survives a power failure.
    pub(crate) fn commit(mut self) -> Result<(), DictionaryError> {
        let committed = self.try_commit();
        if committed.is_ok() {
            self.file = None;
        }
        committed.map_err(DictionaryError::io(&self.path, "write"))
    }

    fn try_commit(&mut self) -> io::Result<()> {
        if let Some(file) = &mut self.file {
            file.flush()?;
            file.get_ref().sync_all()?;
        }
        fs::rename(&self.partial, &self.path)?;
        sync_parent(&self.path)
    }
}

impl Write for AtomicFile {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.file.as_mut().map_or(Ok(0), |file| file.write(bytes))
    }

    fn flush(&mut self) -> io::Result<()> {
        self.file.as_mut().map_or(Ok(()), Write::flush)
    }
}

impl Drop for AtomicFile {
    fn drop(&mut self) {
        if self.file.take().is_some() {
            // The write has already failed. The next run overwrites the remaining file.
            let _ = fs::remove_file(&self.partial);
        }
    }
}
