//! Files and folders that survive a power failure: complete or absent.

use std::ffi::OsString;
use std::fs::{self, File, Metadata, TryLockError};
use std::io::ErrorKind::{PermissionDenied, ResourceBusy};
use std::io::{self, Write};
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};

/// The name of a file while it is written. A killed process leaves it, and the next attempt overwrites it.
pub fn partial(name: &str) -> String {
    format!(".{name}.part")
}

/// Whether this is the name of a file `of` while it is written.
pub fn is_partial(name: &str, of: &str) -> bool {
    name.strip_prefix('.').and_then(|name| name.strip_prefix(of)).is_some_and(|rest| rest.ends_with(".part"))
}

/// The path of a file while it is written, in its folder.
pub(crate) fn partial_path(path: &Path) -> io::Result<PathBuf> {
    let name =
        path.file_name().ok_or_else(|| io::Error::new(io::ErrorKind::InvalidInput, "the path has no file name"))?;
    let mut part = OsString::from(".");
    part.push(name);
    part.push(".part");
    Ok(path.with_file_name(part))
}

/// Writes a file: complete or not at all, even after a power failure. The file that a link names is replaced, and not the link, and
/// keeps its permissions. A device, a pipe, and a file in a folder that takes no other one get the bytes.
pub fn write(path: impl AsRef<Path>, bytes: impl AsRef<[u8]>) -> io::Result<()> {
    let (path, bytes) = (path.as_ref(), bytes.as_ref());
    let is_stream = ["/dev/", "/proc/"].iter().any(|folder| path.starts_with(folder));
    let there = fs::metadata(path).ok();
    if is_stream || there.as_ref().is_some_and(|there| !there.is_file()) {
        return fs::write(path, bytes);
    }
    if there.as_ref().is_some_and(|there| there.permissions().readonly()) {
        return Err(io::ErrorKind::PermissionDenied.into());
    }
    let path = if there.is_some() { path.canonicalize()? } else { path.to_owned() };
    let written = Part::of(&path).and_then(|part| part.filled(bytes, there.as_ref())?.renamed(&path));
    match written {
        // A file that is mounted alone, or whose folder is closed.
        Err(error) if there.is_some() && matches!(error.kind(), PermissionDenied | ResourceBusy) => {
            fs::write(&path, bytes)
        }
        written => written,
    }
}

/// Writes a new file, as [`write()`] does.
///
/// # Errors
/// [`io::ErrorKind::AlreadyExists`] if there is one.
pub fn write_new(path: &Path, bytes: impl AsRef<[u8]>) -> io::Result<()> {
    let part = Part::of(path)?.filled(bytes.as_ref(), None)?;
    match fs::hard_link(&part.path, path) {
        Ok(()) => sync_parent(path),
        Err(error) if error.kind() == io::ErrorKind::AlreadyExists => Err(error),
        // A file system without hard links.
        Err(_) if path.symlink_metadata().is_ok() => Err(io::ErrorKind::AlreadyExists.into()),
        Err(_) => part.renamed(path),
    }
}

/// A new file beside another one. It is locked while it is written, and removed when it is dropped.
struct Part {
    path: PathBuf,
    file: File,
}

impl Part {
    fn of(path: &Path) -> io::Result<Self> {
        static NEXT: AtomicU64 = AtomicU64::new(0);
        let usual = partial_path(path)?;
        if let Ok(there) = fs::symlink_metadata(&usual) {
            // A file without a lock is that of a killed process. The lock is held until it is removed, so that a process that has just
            // made it does not take it for its own. A link is removed, because it could name any file.
            let left =
                if there.is_file() { File::open(&usual).ok().filter(|file| file.try_lock().is_ok()) } else { None };
            let is_same = |file: &File| file.metadata().is_ok_and(|own| is_at(&own, &usual));
            if !there.is_file() || left.as_ref().is_some_and(is_same) {
                let _ = fs::remove_file(&usual);
            }
        }
        let created = |path: PathBuf| File::create_new(&path).map(|file| Self { path, file });
        let mut part = match created(usual.clone()) {
            Err(error) if error.kind() == io::ErrorKind::AlreadyExists => {
                // Another process or thread writes the same file.
                let number = NEXT.fetch_add(1, Ordering::Relaxed);
                created(usual.with_extension(format!("{}-{number}.part", std::process::id())))?
            }
            made => made?,
        };
        // Another process may have taken it for a left one before it was locked: it holds the lock, or has removed the file.
        let is_taken = matches!(part.file.try_lock(), Err(TryLockError::WouldBlock));
        if !is_taken && is_at(&part.file.metadata()?, &part.path) {
            return Ok(part);
        }
        part.path.clear();
        Self::of(path)
    }

    /// With these bytes on disk, and the permissions of the file that it replaces.
    fn filled(mut self, bytes: &[u8], like: Option<&Metadata>) -> io::Result<Self> {
        self.file.write_all(bytes)?;
        if let Some(like) = like {
            self.file.set_permissions(like.permissions())?;
        }
        self.file.sync_all()?;
        Ok(self)
    }

    fn renamed(mut self, path: &Path) -> io::Result<()> {
        fs::rename(&self.path, path)?;
        // The name may be that of another process from now on.
        self.path.clear();
        sync_parent(path)
    }
}

impl Drop for Part {
    fn drop(&mut self) {
        let _ = fs::remove_file(&self.path);
    }
}

/// Whether this file is the one at this path.
fn is_at(own: &Metadata, path: &Path) -> bool {
    fs::symlink_metadata(path).is_ok_and(|it| (it.dev(), it.ino()) == (own.dev(), own.ino()))
}

/// Creates a folder with its missing parents, so that they survive a power failure.
pub fn create_folders(path: impl AsRef<Path>) -> io::Result<()> {
    let path = path.as_ref();
    if path.is_dir() {
        return Ok(());
    }
    if let Some(parent) = path.parent().filter(|parent| !parent.as_os_str().is_empty()) {
        create_folders(parent)?;
    }
    match fs::create_dir(path) {
        // Another process made it.
        Err(error) if error.kind() == io::ErrorKind::AlreadyExists && path.is_dir() => Ok(()),
        made => made.and_then(|()| sync_parent(path)),
    }
}

/// Flushes the entries of a folder to disk, if the system can open folders.
pub fn sync_folder(folder: &Path) -> io::Result<()> {
    if cfg!(not(unix)) {
        return Ok(());
    }
    match File::open(folder).and_then(|folder| folder.sync_all()) {
        // Some file systems do not support this, and a folder may be closed to reading. The entries exist in any case.
        Err(error) if matches!(error.kind(), io::ErrorKind::InvalidInput | io::ErrorKind::PermissionDenied) => Ok(()),
        other => other,
    }
}

/// Flushes the folder of `path` to disk.
pub fn sync_parent(path: &Path) -> io::Result<()> {
    sync_folder(path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new(".")))
}

/// Flushes all files and folders below a folder to disk, so that its rename is that of a complete folder.
pub fn sync_all_below(folder: &Path) -> io::Result<()> {
    for entry in fs::read_dir(folder)? {
        let entry = entry?;
        if entry.file_type()?.is_dir() {
            sync_all_below(&entry.path())?;
        } else {
            File::open(entry.path())?.sync_all()?;
        }
    }
    sync_folder(folder)
}

#[cfg(test)]
mod tests {
    use std::os::unix::fs::{PermissionsExt, symlink};

    use super::*;

    #[test]
    fn replaced_files_keep_their_permissions_and_links() {
        let dir = tempfile::tempdir().unwrap();
        let (file, link) = (dir.path().join("secret.json"), dir.path().join("link.json"));
        fs::write(&file, "old").unwrap();
        fs::set_permissions(&file, fs::Permissions::from_mode(0o600)).unwrap();
        symlink(&file, &link).unwrap();
        write(&link, "new").unwrap();
        assert_eq!(fs::read(&file).unwrap(), b"new");
        assert_eq!(fs::metadata(&file).unwrap().permissions().mode() & 0o777, 0o600);
        assert!(fs::symlink_metadata(&link).unwrap().is_symlink());
        fs::set_permissions(&file, fs::Permissions::from_mode(0o400)).unwrap();
        assert_eq!(write(&file, "newer").unwrap_err().kind(), PermissionDenied);
        assert_eq!(fs::read(&file).unwrap(), b"new");
        write("/dev/null", "gone").unwrap();
        assert_eq!(fs::read_dir(dir.path()).unwrap().count(), 2, "nothing is left beside them");
    }

    #[test]
    fn writers_of_one_file_do_not_mix() {
        let dir = tempfile::tempdir().unwrap();
        let file = dir.path().join("a.json");
        // The file of a killed process, and then a link.
        fs::write(dir.path().join(".a.json.part"), "half").unwrap();
        write(&file, "whole").unwrap();
        symlink("/nowhere", dir.path().join(".a.json.part")).unwrap();
        write(&file, "whole").unwrap();
        let texts: Vec<String> = (0..8).map(|i| i.to_string().repeat(100_000)).collect();
        std::thread::scope(|scope| {
            for text in &texts {
                let file = &file;
                scope.spawn(move || (0..20).for_each(|_| write(file, text).unwrap()));
            }
        });
        assert!(texts.contains(&fs::read_to_string(&file).unwrap()));
        assert_eq!(fs::read_dir(dir.path()).unwrap().count(), 1);
    }

    #[test]
    fn new_files_are_made_once() {
        let dir = tempfile::tempdir().unwrap();
        let file = dir.path().join("a.json");
        let made = &|i: u32| write_new(&file, i.to_string()).is_ok();
        let all: Vec<bool> = std::thread::scope(|scope| {
            let threads: Vec<_> = (0..8).map(|i| scope.spawn(move || made(i))).collect();
            threads.into_iter().map(|thread| thread.join().unwrap()).collect()
        });
        assert_eq!(all.iter().filter(|made| **made).count(), 1);
        assert_eq!(fs::read_dir(dir.path()).unwrap().count(), 1);
    }

    #[test]
    fn names_of_partial_files_are_recognised() {
        let name = |path: &Path| path.file_name().unwrap().to_string_lossy().into_owned();
        let dir = tempfile::tempdir().unwrap();
        let part = Part::of(&dir.path().join("plan.json")).unwrap();
        assert!(is_partial(&name(&part.path), "plan.json") && is_partial(&partial("plan.json"), "plan.json"));
        assert!(!is_partial("plan.json", "plan.json") && !is_partial(".other.part", "plan.json"));
    }
}
