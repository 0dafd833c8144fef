//! Reads text files of limited size.

use std::fs::File;
use std::io::{self, Read};
use std::path::Path;

use robogate_core::budget::Budget;

/// Reads a text file of at most [`Budget::FILE`] bytes. A pipe is read to its end.
///
/// # Errors
/// If the file cannot be read, is too large (an endless device, for example) or is not UTF-8.
pub fn read_text(path: &Path) -> io::Result<String> {
    let most = Budget::FILE.bytes;
    let mut text = String::new();
    File::open(path)?.take(most as u64 + 1).read_to_string(&mut text)?;
    match Budget::FILE.check_bytes(text.len()) {
        Ok(()) => Ok(text),
        Err(error) => Err(io::Error::new(io::ErrorKind::FileTooLarge, error)),
    }
}

/// Reads a text file in a folder of another author, which may contain pipes and devices: only regular files are opened.
///
/// # Errors
/// If the file is not a regular file, cannot be read, is too large or is not UTF-8.
pub fn read_regular_text(path: &Path) -> io::Result<String> {
    if !std::fs::symlink_metadata(path)?.is_file() {
        return Err(io::Error::new(io::ErrorKind::InvalidInput, "not a regular file"));
    }
    read_text(path)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[cfg(target_os = "linux")]
    #[test]
    fn devices_end() {
        assert_eq!(read_text(Path::new("/dev/zero")).unwrap_err().kind(), io::ErrorKind::FileTooLarge);
        assert_eq!(read_regular_text(Path::new("/dev/zero")).unwrap_err().to_string(), "not a regular file");
        assert_eq!(read_text(Path::new("/dev/null")).unwrap(), "");
    }
}
