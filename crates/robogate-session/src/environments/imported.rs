//! What the Python process of an environment has imported, and opened in its own folder.

use std::collections::BTreeMap;
use std::fs;
use std::io;
use std::path::{Component, Path, PathBuf};

use anyhow::{Context, anyhow};
use robogate_dictionary::{PythonPlace, files, hex};
use serde::Deserialize;
use sha2::{Digest, Sha256};

use crate::failure::{Failure, OrFailure};
use crate::notice::note;
use crate::text::foreign;

/// The folder in that of a run with the files of its environment.
pub const ENVIRONMENT: &str = "environment";
/// The most files of an environment, and bytes in all, that a run keeps copies of.
const MOST_FILES: usize = 1_000;
const MOST_BYTES: u64 = 64 << 20;

/// What the process has imported until the end of its first episode, with the files that it opened in the folder of its environment.
#[derive(Debug, Clone, Default, Deserialize)]
pub(crate) struct Imported {
    /// The files of modules outside of installed packages, and the files that the environment opened beside them.
    #[serde(default)]
    files: Vec<ImportedFile>,
    /// The installed packages, with their versions.
    #[serde(default)]
    pub(crate) packages: BTreeMap<String, String>,
    /// Whether the files are complete. Elsewhere than on Linux, those that C libraries open are missing.
    #[serde(default)]
    complete: bool,
}

#[derive(Debug, Clone, Deserialize)]
struct ImportedFile {
    /// The name of the module as a path, or the path in the folder of the environment.
    name: String,
    path: PathBuf,
    sha256: String,
    /// Whether only the kernel reported it, because a C library opened it.
    #[serde(default)]
    only_watched: bool,
}

impl Imported {
    /// The digests of the files, by their names.
    pub(crate) fn files(&self) -> BTreeMap<String, String> {
        self.files.iter().map(|file| (file.name.clone(), file.sha256.clone())).collect()
    }

    /// Whether another process runs the same code: it may have imported or opened other files, but none with another content.
    pub(crate) fn agrees_with(&self, other: &Self) -> bool {
        let theirs = other.files();
        self.files.iter().all(|file| theirs.get(&file.name).is_none_or(|sha256| *sha256 == file.sha256))
    }

    /// Copies the files into the folder of a run. An error is a note: the digests are recorded.
    pub(crate) fn keep(&self, run: &Path) {
        if let Err(why) = self.copy(&run.join(ENVIRONMENT)) {
            note(format_args!("note: the run keeps no copy of its environment's files: {why}"));
        }
    }

    fn copy(&self, folder: &Path) -> io::Result<()> {
        let sizes = self.files.iter().map(|file| fs::metadata(&file.path).map(|metadata| metadata.len()));
        let bytes: u64 = sizes.sum::<io::Result<u64>>()?;
        if self.files.len() > MOST_FILES || bytes > MOST_BYTES {
            return Err(io::Error::other(format!(
                "they are {} files of {} MiB (at most {MOST_FILES} files of {} MiB)",
                self.files.len(),
                bytes >> 20,
                MOST_BYTES >> 20
            )));
        }
        for ImportedFile { name, path, sha256, .. } in &self.files {
            let Some(below) = below(name) else { continue };
            let content = fs::read(path)?;
            if hex(&Sha256::digest(&content)) != *sha256 {
                return Err(io::Error::other(format!("{} has changed meanwhile", foreign(path.display()))));
            }
            let target = folder.join(below);
            files::create_folders(target.parent().unwrap_or(folder))?;
            files::write(target, content)?;
        }
        Ok(())
    }

    /// Rejects other files than the recorded ones, by name. Other versions of packages are told.
    pub(crate) fn same_as(&self, recorded: &PythonPlace) -> Result<(), Failure> {
        for (package, was) in &recorded.packages {
            let is = self.packages.get(package).map_or("none", String::as_str);
            if is != was {
                note(format_args!(
                    "note: the package {} is {}; the run used {}",
                    foreign(package),
                    foreign(is),
                    foreign(was)
                ));
            }
        }
        let now = self.files();
        for (name, sha256) in &recorded.files {
            match now.get(name) {
                Some(is) if is == sha256 => {}
                Some(_) => return Err(differs(name, "has changed since the run")).or_request(),
                // A file of a C library, which this system does not report. `check_beside` has compared it.
                None if !self.complete => {}
                None => return Err(differs(name, "is not used now")).or_request(),
            }
        }
        for file in self.files.iter().filter(|file| !recorded.files.contains_key(&file.name)) {
            if !file.only_watched {
                return Err(differs(&file.name, "was not used in the run")).or_request();
            }
            // The system of the run may not have reported it.
            note(format_args!(
                "note: the environment opens {}, whose content the run did not record",
                foreign(&file.name)
            ));
        }
        Ok(())
    }
}

fn differs(name: &str, why: &str) -> anyhow::Error {
    let name = foreign(name);
    anyhow!("the environment's file {name} {why}\nHint: restore the files of the run, or start a new run")
}

/// Rejects recorded files beside the file of an environment that have changed, before anything is imported.
pub(crate) fn check_beside(file: &Path, recorded: &PythonPlace) -> Result<(), Failure> {
    let folder = file.parent().unwrap_or(Path::new("."));
    for (name, sha256) in &recorded.files {
        let Some(path) = below(name).map(|name| folder.join(name)).filter(|path| path.is_file()) else { continue };
        let content =
            fs::read(&path).with_context(|| format!("cannot read {}", foreign(path.display()))).or_request()?;
        if hex(&Sha256::digest(content)) != *sha256 {
            return Err(differs(name, "has changed since the run")).or_request();
        }
    }
    Ok(())
}

/// The kept copy of the file of an environment in the folder of a run, if all recorded files are there unchanged.
pub(crate) fn kept(run: &Path, recorded: &PythonPlace) -> Option<PathBuf> {
    let folder = run.join(ENVIRONMENT);
    let unchanged = |(name, sha256): (&String, &String)| {
        let path = folder.join(below(name)?);
        let metadata = fs::symlink_metadata(&path).ok().filter(|found| found.is_file() && found.len() <= MOST_BYTES);
        metadata.and_then(|_| fs::read(path).ok()).filter(|content| hex(&Sha256::digest(content)) == *sha256)
    };
    let complete = !recorded.files.is_empty() && recorded.files.iter().all(|file| unchanged(file).is_some());
    complete.then(|| folder.canonicalize().ok()).flatten()
}

/// A name as a path below a folder. `None` for one that leaves it.
fn below(name: &str) -> Option<&Path> {
    let path = Path::new(name);
    let plain = path.components().all(|part| matches!(part, Component::Normal(_)));
    (plain && !name.is_empty()).then_some(path)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_stay_in_the_folder() {
        assert_eq!(below("cell/__init__.py"), Some(Path::new("cell/__init__.py")));
        for name in ["../x.py", "/etc/passwd", "", "a/../../b.py"] {
            assert_eq!(below(name), None, "{name}");
        }
    }
}
