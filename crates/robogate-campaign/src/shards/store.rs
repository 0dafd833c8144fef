//! Where the files of a campaign in shards are kept.

use std::fs::{self, OpenOptions};
use std::io::{self, Write};
use std::path::{Path, PathBuf};

use crate::folder::PLAN;
use crate::{RunError, folder};

use robogate_dictionary::files;

/// A store of files that many processes use at the same time, without locks and without renames.
///
/// Names are relative and use `/` on every system. A file is never changed once it has its name.
pub trait ShardStore: Send {
    /// Stores a complete file unless the name exists. Of several processes that store the same name at the same time,
    /// exactly one gets [`Stored::New`].
    fn put_if_absent(&self, name: &str, bytes: &[u8]) -> io::Result<Stored>;

    /// Reads a file. `None` if it does not exist.
    fn get(&self, name: &str) -> io::Result<Option<Vec<u8>>>;

    /// The sorted names of the complete files in `folder`, without the folder's name. The empty name is the store
    /// itself.
    fn list(&self, folder: &str) -> io::Result<Vec<String>>;

    /// Removes what processes left behind that were killed while they stored a file.
    fn remove_leftovers(&self) -> io::Result<()>;

    /// The place of a file, for messages.
    fn place(&self, name: &str) -> PathBuf;
}

/// What [`ShardStore::put_if_absent`] did.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Stored {
    /// The file is stored.
    New,
    /// The name exists already. Nothing was changed.
    Exists,
}

/// A folder of a local or shared file system that supports hard links.
#[derive(Debug, Clone)]
pub struct DirectoryStore {
    dir: PathBuf,
}

/// The folder of the shard files and of the layout.
pub(super) const SHARDS: &str = "shards";
/// The ending of an unfinished file, which is hidden.
const PART: &str = ".part";

impl DirectoryStore {
    /// Uses the folder `dir`, which may not exist yet.
    pub fn new(dir: &Path) -> Self {
        Self { dir: dir.to_owned() }
    }

    /// Rejects a folder that contains other files and no plan.
    pub fn check_free(&self) -> Result<(), RunError> {
        if self.dir.join(PLAN).exists() {
            return Ok(());
        }
        let names = match folder::names(&self.dir) {
            Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(()),
            names => names.map_err(RunError::io(&self.dir, "list"))?,
        };
        match names.into_iter().find(|name| name != SHARDS && name != PLAN && !is_part(name)) {
            Some(name) => Err(RunError::NotEmpty { dir: self.dir.clone(), name }),
            None => Ok(()),
        }
    }

    /// Writes `bytes` to a new file with a unique name in the folder of `path`.
    fn write_part(path: &Path, bytes: &[u8]) -> io::Result<PathBuf> {
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        for attempt in 0_u32.. {
            // The number of the process is not unique among machines, and a killed process may have left its file.
            let part = path.with_file_name(format!(".{name}.{}-{attempt}{PART}", std::process::id()));
            let mut file = match OpenOptions::new().write(true).create_new(true).open(&part) {
                Err(error) if error.kind() == io::ErrorKind::AlreadyExists => continue,
                file => file?,
            };
            if let Err(error) = file.write_all(bytes).and_then(|()| file.sync_all()) {
                let _ = fs::remove_file(&part);
                return Err(error);
            }
            return Ok(part);
        }
        Err(io::ErrorKind::AlreadyExists.into())
    }
}

/// The error of a link to a file that this process has just written to the same folder. FAT and exFAT have no hard links, and report
/// missing permission.
fn link_error(error: io::Error) -> io::Error {
    match error.kind() {
        io::ErrorKind::PermissionDenied => io::Error::new(io::ErrorKind::Unsupported, error),
        _ => error,
    }
}

/// Whether a file is unfinished, or the remains of a killed process.
fn is_part(name: &str) -> bool {
    name.starts_with('.') && name.ends_with(PART)
}

/// Removes a file that another process may have removed.
fn remove(path: &Path) -> io::Result<()> {
    match fs::remove_file(path) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(()),
        removed => removed,
    }
}

impl ShardStore for DirectoryStore {
    fn put_if_absent(&self, name: &str, bytes: &[u8]) -> io::Result<Stored> {
        let path = self.dir.join(name);
        if path.exists() {
            return Ok(Stored::Exists);
        }
        let folder = path.parent().unwrap_or(&self.dir);
        files::create_folders(folder)?;
        let part = Self::write_part(&path, bytes)?;
        // A link fails if the name exists, unlike a rename. The content is complete before the name exists.
        let linked = fs::hard_link(&part, &path);
        let removed = remove(&part);
        match linked {
            Ok(()) => {
                removed?;
                files::sync_folder(folder)?;
                Ok(Stored::New)
            }
            Err(error) if error.kind() == io::ErrorKind::AlreadyExists => Ok(Stored::Exists),
            // A merge removes unfinished files, which it does only if the shards are complete.
            Err(error) if error.kind() == io::ErrorKind::NotFound && path.exists() => Ok(Stored::Exists),
            Err(error) => Err(link_error(error)),
        }
    }

    fn get(&self, name: &str) -> io::Result<Option<Vec<u8>>> {
        let path = self.dir.join(name);
        // A pipe in the folder of another machine would never end.
        if fs::metadata(&path).is_ok_and(|there| !there.is_file()) {
            return Err(io::Error::new(io::ErrorKind::InvalidInput, "not a regular file"));
        }
        match fs::read(path) {
            Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(None),
            read => read.map(Some),
        }
    }

    fn list(&self, folder: &str) -> io::Result<Vec<String>> {
        let dir = self.dir.join(folder);
        let mut names = match folder::names(&dir) {
            Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(Vec::new()),
            names => names?,
        };
        names.retain(|name| !name.starts_with('.') && !dir.join(name).is_dir());
        Ok(names)
    }

    fn remove_leftovers(&self) -> io::Result<()> {
        for dir in [self.dir.clone(), self.dir.join(SHARDS)] {
            let names = match folder::names(&dir) {
                Err(error) if error.kind() == io::ErrorKind::NotFound => continue,
                names => names?,
            };
            names.iter().filter(|name| is_part(name)).try_for_each(|name| remove(&dir.join(name)))?;
        }
        Ok(())
    }

    fn place(&self, name: &str) -> PathBuf {
        // Joining nothing would append a separator.
        if name.is_empty() { self.dir.clone() } else { self.dir.join(name) }
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Barrier;

    use super::*;

    #[test]
    fn one_writer_wins() {
        let dir = tempfile::tempdir().unwrap();
        let store = DirectoryStore::new(dir.path());
        for round in 0..20 {
            let name = format!("shards/{round}");
            let barrier = Barrier::new(8);
            let put = |i: usize| {
                barrier.wait();
                store.put_if_absent(&name, &vec![i as u8; 10_000]).unwrap()
            };
            let stored: Vec<Stored> = std::thread::scope(|scope| {
                let threads: Vec<_> = (0..8).map(|i| scope.spawn(move || put(i))).collect();
                threads.into_iter().map(|thread| thread.join().unwrap()).collect()
            });
            let winner = stored.iter().position(|stored| *stored == Stored::New).unwrap();
            assert_eq!(stored.iter().filter(|stored| **stored == Stored::New).count(), 1);
            assert_eq!(store.get(&name).unwrap().unwrap(), vec![winner as u8; 10_000]);
        }
        assert_eq!(fs::read_dir(dir.path().join("shards")).unwrap().count(), 20, "no unfinished file is left");
    }

    #[test]
    fn missing_hard_links_are_named() {
        let denied = || io::Error::from(io::ErrorKind::PermissionDenied);
        let message =
            |source| crate::shards::ShardError::Store { place: "x".into(), action: "write", source }.to_string();
        assert!(message(link_error(denied())).contains("file system with hard links"));
        assert!(message(denied()).contains("write permission"));
    }

    #[test]
    fn leftovers_are_invisible_and_removed() {
        let dir = tempfile::tempdir().unwrap();
        let store = DirectoryStore::new(dir.path());
        fs::create_dir(dir.path().join(SHARDS)).unwrap();
        let leftover = dir.path().join(format!("shards/.a.{}-0.part", std::process::id()));
        fs::write(&leftover, "half").unwrap();
        assert_eq!(store.put_if_absent("shards/a", b"whole").unwrap(), Stored::New);
        assert_eq!(store.put_if_absent("shards/a", b"other").unwrap(), Stored::Exists);
        assert_eq!(store.list(SHARDS).unwrap(), ["a"]);
        assert!(leftover.exists());
        store.remove_leftovers().unwrap();
        assert!(!leftover.exists());
        assert_eq!(store.get("shards/a").unwrap().unwrap(), b"whole");
        assert_eq!(store.get("shards/b").unwrap(), None);
        assert_eq!(store.list("").unwrap(), Vec::<String>::new());
        assert_eq!(store.list("nowhere").unwrap(), Vec::<String>::new());
    }

    #[test]
    fn foreign_folder_is_rejected() {
        let dir = tempfile::tempdir().unwrap();
        let store = DirectoryStore::new(dir.path());
        fs::write(dir.path().join(".plan.json.7-0.part"), "half").unwrap();
        store.check_free().unwrap();
        fs::write(dir.path().join("thesis.tex"), "mine").unwrap();
        assert!(matches!(store.check_free(), Err(RunError::NotEmpty { name, .. }) if name == "thesis.tex"));
        DirectoryStore::new(&dir.path().join("nowhere")).check_free().unwrap();
    }
}
