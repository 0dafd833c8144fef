//! A file that is complete or absent.

use std::fs::{self, File};
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};

use crate::DictionaryError;
use crate::journal::sync_folder;

/// A file written beside its place and moved there once it is complete.
///
/// Its name while it is written is fixed (`.NAME.part`): what a killed process left is overwritten by the next one.
#[derive(Debug)]
pub(crate) struct AtomicFile {
    /// `None` once it is in its place.
    file: Option<BufWriter<File>>,
    partial: PathBuf,
    path: PathBuf,
}

impl AtomicFile {
    /// Begins the file that will be at `path`.
    pub(crate) fn create(path: &Path) -> Result<Self, DictionaryError> {
        let name = path.file_name().ok_or_else(|| {
            DictionaryError::io(path, "create")(io::Error::new(io::ErrorKind::InvalidInput, "it has no file name"))
        })?;
        if path.is_dir() {
            return Err(DictionaryError::io(path, "create")(io::ErrorKind::IsADirectory.into()));
        }
        // A device or a pipe would be replaced by a file of its name.
        if fs::metadata(path).is_ok_and(|there| !there.is_file()) {
            return Err(DictionaryError::io(path, "create")(io::Error::new(
                io::ErrorKind::InvalidInput,
                "the path exists and is not a regular file",
            )));
        }
        let mut partial = std::ffi::OsString::from(".");
        partial.push(name);
        partial.push(".part");
        let partial = path.with_file_name(partial);
        let file = File::create(&partial).map_err(DictionaryError::io(&partial, "create"))?;
        Ok(Self { file: Some(BufWriter::new(file)), partial, path: path.to_owned() })
    }

    /// Puts the complete file in its place, where it survives a power failure.
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
        sync_folder(&self.path)
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
            // An error or a panic is on its way already; a leftover is overwritten by the next run.
            let _ = fs::remove_file(&self.partial);
        }
    }
}
