//! Files that belong to a trial: recordings, logs, data sets. The journal has their digests, and the folder of the study a copy.

use std::fs;
use std::io::{self, Write};
use std::path::{Path, PathBuf};

use robogate_dictionary::{file_digest, files};
use serde::{Deserialize, Serialize};

use crate::{Problem, Study};

/// Name of the folder of the copies in the folder of a study.
pub const ATTACHMENTS: &str = "attachments";
/// Most files and bytes of one attachment.
const MOST_FILES: usize = 1_000;
const MOST_BYTES: u64 = 64 << 30;
/// Longest name of a file, in bytes.
const LONGEST_NAME: usize = 400;

/// A file of a trial.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Attachment {
    /// Its name below the folder of the trial's attachments, with `/` between folders.
    pub name: String,
    /// Its size.
    pub bytes: u64,
    /// SHA-256 (hex) of its content.
    pub sha256: String,
}

impl Attachment {
    /// The copy in the folder of a study. `None` for a name that leads out of the folder.
    fn path(&self, study: &Path, code: &str) -> Option<PathBuf> {
        is_inside(&self.name).then(|| study.join(ATTACHMENTS).join(code).join(&self.name))
    }
}

/// Copies a file, or all files of a folder, beside the journal. What was copied is removed again after an error.
pub(crate) fn copied(study: &Path, code: &str, from: &Path) -> Result<Vec<Attachment>, Problem> {
    let files = files_of(from)?;
    let mut done: Vec<(PathBuf, Attachment)> = Vec::new();
    let all = files.iter().try_for_each(|(path, name)| {
        let failed = |reason: String| Problem::File { path: path.clone(), reason };
        let mut attachment = Attachment { name: name.clone(), bytes: 0, sha256: String::new() };
        let to = attachment.path(study, code).ok_or_else(|| failed("its name cannot be stored".to_owned()))?;
        if let Some(folder) = to.parent() {
            files::create_folders(folder).map_err(|error| failed(error.to_string()))?;
        }
        let target = fs::OpenOptions::new().write(true).create_new(true).open(&to);
        let mut target = target.map_err(|error| match error.kind() {
            io::ErrorKind::AlreadyExists => failed(format!("trial {code} has an attachment {name} already")),
            _ => failed(error.to_string()),
        })?;
        done.push((to.clone(), attachment.clone()));
        (attachment.bytes, attachment.sha256) = file_digest(path, MOST_BYTES, &mut |bytes| target.write_all(bytes))
            .map_err(|error| failed(error.to_string()))?;
        target.sync_all().map_err(|error| failed(error.to_string()))?;
        if let Some((_, last)) = done.last_mut() {
            *last = attachment;
        }
        let bytes: u64 = done.iter().map(|(_, of)| of.bytes).sum();
        let fits = bytes <= MOST_BYTES;
        if fits { Ok(()) } else { Err(failed(format!("more than {} GiB in all", MOST_BYTES >> 30))) }
    });
    let flushed = all.and_then(|()| {
        let folder = study.join(ATTACHMENTS);
        files::sync_all_below(&folder)
            .and_then(|()| files::sync_folder(study))
            .map_err(|error| Problem::File { path: folder, reason: error.to_string() })
    });
    if let Err(error) = flushed {
        for (path, _) in done {
            // The error is the one to report.
            let _ = fs::remove_file(path);
        }
        return Err(error);
    }
    Ok(done.into_iter().map(|(_, attachment)| attachment).collect())
}

/// Checks the copies of all attachments against the journal. Returns how many there are.
///
/// # Errors
/// A copy that is missing or was changed.
pub fn check_attachments(folder: &Path, study: &Study) -> Result<u64, Problem> {
    let mut checked = 0;
    for attempt in study.attempts() {
        for attachment in &attempt.attachments {
            let lost = |path: PathBuf, reason: &str| Problem::Attachment { path, reason: reason.to_owned() };
            let path = attachment.path(folder, &attempt.code);
            let path =
                path.ok_or_else(|| lost(folder.join(ATTACHMENTS), "the journal has a name that leads out of it"))?;
            let regular = fs::symlink_metadata(&path).is_ok_and(|of| of.is_file() && of.len() == attachment.bytes);
            if !regular {
                return Err(lost(path, "it is missing, or has another size than the journal says"));
            }
            let found = file_digest(&path, MOST_BYTES, &mut |_| Ok(()));
            let found = found.map_err(|error| Problem::File { path: path.clone(), reason: error.to_string() })?;
            if found != (attachment.bytes, attachment.sha256.clone()) {
                return Err(lost(path, "its content is not the one that was attached"));
            }
            checked += 1;
        }
    }
    Ok(checked)
}

/// The files at a path with their names: the file itself, or all below a folder.
fn files_of(from: &Path) -> Result<Vec<(PathBuf, String)>, Problem> {
    let failed = |path: &Path, reason: &str| Problem::File { path: path.to_owned(), reason: reason.to_owned() };
    let name = from.file_name().and_then(|name| name.to_str()).ok_or_else(|| failed(from, "it has no name"))?;
    let (mut found, mut open) = (Vec::new(), vec![(from.to_owned(), name.to_owned())]);
    while let Some((path, name)) = open.pop() {
        // A link or device inside of a folder is not followed; the path that the user names may be a link.
        let metadata = if path == from { fs::metadata(&path) } else { fs::symlink_metadata(&path) };
        let metadata = metadata.map_err(|error| failed(&path, &error.to_string()))?;
        if metadata.is_dir() {
            for entry in fs::read_dir(&path).map_err(|error| failed(&path, &error.to_string()))? {
                let path = entry.map_err(|error| failed(&path, &error.to_string()))?.path();
                let part = path.file_name().and_then(|part| part.to_str());
                let part = part.ok_or_else(|| failed(&path, "its name is not UTF-8"))?;
                let name = format!("{name}/{part}");
                open.push((path.clone(), name));
            }
        } else if metadata.is_file() {
            if !is_inside(&name) {
                return Err(failed(&path, "its name is too long, or has control characters"));
            }
            found.push((path, name));
        } else {
            return Err(failed(&path, "it is not a file or folder"));
        }
        if found.len() + open.len() > MOST_FILES {
            return Err(failed(from, &format!("more than {MOST_FILES} files\nHint: attach an archive of them")));
        }
    }
    if found.is_empty() {
        return Err(failed(from, "it has no file"));
    }
    found.sort_by(|a, b| a.1.cmp(&b.1));
    Ok(found)
}

/// Whether a name stays below its folder.
fn is_inside(name: &str) -> bool {
    let plain = |part: &str| !part.is_empty() && part != "." && part != ".." && !part.contains(['\\', ':']);
    name.len() <= LONGEST_NAME && !name.chars().any(char::is_control) && name.split('/').all(plain)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_stay_inside() {
        for (name, inside) in [
            ("a.csv", true),
            ("set/meta/info.json", true),
            ("../a", false),
            ("/etc", false),
            ("a//b", false),
            ("a\nb", false),
        ] {
            assert_eq!(is_inside(name), inside, "{name:?}");
        }
    }

    #[test]
    fn folders_are_copied_and_links_are_not() {
        let folder = tempfile::tempdir().unwrap();
        let (study, set) = (folder.path().join("study"), folder.path().join("set"));
        fs::create_dir_all(set.join("meta")).unwrap();
        fs::create_dir(&study).unwrap();
        fs::write(set.join("meta/info.json"), "{}").unwrap();
        fs::write(set.join("data"), "1").unwrap();
        let copied_files = copied(&study, "K7", &set).unwrap();
        let names: Vec<&str> = copied_files.iter().map(|of| of.name.as_str()).collect();
        assert_eq!(names, ["set/data", "set/meta/info.json"]);
        assert_eq!(fs::read(study.join("attachments/K7/set/data")).unwrap(), b"1");
        let again = copied(&study, "K7", &set).unwrap_err().to_string();
        assert!(again.contains("has an attachment set/data already"), "{again}");
        assert!(study.join("attachments/K7/set/data").is_file(), "the earlier copy stays");
        std::os::unix::fs::symlink("/etc/passwd", set.join("link")).unwrap();
        let error = copied(&study, "K8", &set).unwrap_err().to_string();
        assert!(error.contains("not a file or folder"), "{error}");
        assert!(!study.join("attachments/K8").exists());
    }
}
