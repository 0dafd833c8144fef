//! The runs that this user made on this machine.
//!
//! The files of a run name programs: an environment in Python, a policy server, a network, a model of a robot. The files of
//! another user's run name that user's programs, so a program must not start because a file names it. When a run starts,
//! this module records its folder and its programs in the user's state folder. A copied, moved or edited folder has no such
//! record.

use std::fs::{self, OpenOptions};
use std::io::{self, Write};
use std::path::{Path, PathBuf};

use robogate_dictionary::{Provenance, hex};
use serde::{Deserialize, Serialize};
use serde_json::json;
use sha2::{Digest, Sha256};

use crate::notice::note;
use crate::subject::programs;

/// A note about one folder: what its run may start, and with which interpreter.
#[derive(Debug, Serialize, Deserialize)]
struct Note {
    /// Hash of the environment, the policy and the robot that the run names.
    programs_sha256: String,
    /// The Python interpreter of the environment, if the user chose one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    python: Option<PathBuf>,
}

/// A run that this user made on this machine.
#[derive(Debug, Default, PartialEq)]
pub struct Origin {
    /// The Python interpreter of its environment, if the user chose one.
    pub python: Option<PathBuf>,
}

/// Notes that this user starts a run in `folder`. A run that names no program needs no note.
pub fn register(folder: &Path, provenance: &Provenance, python: Option<&Path>) {
    if programs(provenance).is_ok_and(|programs| programs.is_empty()) {
        return;
    }
    let python = python.and_then(|python| std::path::absolute(python).ok());
    let noted = Note { programs_sha256: programs_sha256(provenance), python };
    if let Err(why) = write(folder, &noted) {
        note(format_args!(
            "note: cannot note that this run is yours ({why}), so replays of it need --trust\nHint: set ROBOGATE_STATE_DIR to a \
             folder that you can write"
        ));
    }
}

/// The same for a folder that is made from `from`, if that is a run of this user.
pub fn register_copy(folder: &Path, from: &Path, provenance: &Provenance) {
    if let Some(origin) = of(from, provenance) {
        register(folder, provenance, origin.python.as_deref());
    }
}

/// The origin of the run in `folder`. `None` if this user did not make it on this machine, or if it has another
/// environment, policy or robot now.
pub(crate) fn of(folder: &Path, provenance: &Provenance) -> Option<Origin> {
    /// Far more than the notes of one folder need.
    const MOST_BYTES: u64 = 1 << 20;
    let path = path(folder).ok()?;
    if fs::metadata(&path).ok()?.len() > MOST_BYTES {
        return None;
    }
    let text = fs::read_to_string(path).ok()?;
    let wanted = programs_sha256(provenance);
    // The last note counts: the folder was removed and made again. A line that was cut by a full disk says nothing.
    let notes = text.lines().rev().filter_map(|line| serde_json::from_str::<Note>(line).ok());
    notes.filter(|note| note.programs_sha256 == wanted).map(|note| Origin { python: note.python }).next()
}

/// Whether this user made the run in `folder` on this machine.
pub(crate) fn is_own(folder: &Path, provenance: &Provenance) -> bool {
    of(folder, provenance).is_some()
}

fn write(folder: &Path, noted: &Note) -> io::Result<()> {
    let path = path(folder)?;
    let known = fs::read_to_string(&path).unwrap_or_default();
    let line = serde_json::to_string(noted)?;
    if known.lines().last() == Some(&*line) {
        return Ok(());
    }
    if let Some(parent) = path.parent() {
        fs::create_dir_all(parent)?;
        private(parent)?;
    }
    let mut file = OpenOptions::new().create(true).append(true).open(&path)?;
    file.write_all(format!("{line}\n").as_bytes())
}

/// Whether a folder is the address of an object store, such as `s3://bucket/campaign`.
pub fn is_remote(folder: &Path) -> bool {
    folder.to_str().is_some_and(|text| text.contains("://"))
}

/// Restricts a folder to this user.
#[cfg(unix)]
fn private(folder: &Path) -> io::Result<()> {
    use std::os::unix::fs::PermissionsExt;

    fs::set_permissions(folder, fs::Permissions::from_mode(0o700))
}

#[cfg(not(unix))]
fn private(_: &Path) -> io::Result<()> {
    Ok(())
}

/// The file with the notes about a folder. Its name is the hash of the folder's path, in which links are resolved.
fn path(folder: &Path) -> io::Result<PathBuf> {
    let full = if is_remote(folder) { folder.to_owned() } else { resolved(folder)? };
    Ok(state()?.join("origins").join(hex(&Sha256::digest(full.as_os_str().as_encoded_bytes()))))
}

/// The path of a folder that may not exist yet.
fn resolved(folder: &Path) -> io::Result<PathBuf> {
    let absolute = std::path::absolute(folder)?;
    for part in absolute.ancestors() {
        if let (Ok(real), Ok(rest)) = (part.canonicalize(), absolute.strip_prefix(part)) {
            // Joining an empty path would add a separator.
            return Ok(if rest.as_os_str().is_empty() { real } else { real.join(rest) });
        }
    }
    Ok(absolute)
}

/// The folder with the user's keys and notes, if it can be found.
pub(crate) fn state_folder() -> Option<PathBuf> {
    state().ok()
}

/// The state folder: `ROBOGATE_STATE_DIR`, else `$XDG_STATE_HOME/robogate`, else `~/.local/state/robogate`.
fn state() -> io::Result<PathBuf> {
    let path = |name: &str| std::env::var_os(name).map(PathBuf::from).filter(|path| path.is_absolute());
    path("ROBOGATE_STATE_DIR")
        .or_else(|| Some(path("XDG_STATE_HOME")?.join("robogate")))
        .or_else(|| Some(path("HOME")?.join(".local/state/robogate")))
        .ok_or_else(|| io::Error::other("cannot find the state folder: HOME is not set"))
}

/// The hash of everything that a run names to be started. Space, plan and seed do not matter: the arms of a campaign and the units of
/// a fleet start the same programs.
fn programs_sha256(provenance: &Provenance) -> String {
    let Provenance { world, engine, robot, policy, .. } = provenance;
    // The keys of an object are sorted, so equal values have equal texts.
    let text = json!({ "world": world, "engine": engine, "robot": robot, "policy": policy }).to_string();
    hex(&Sha256::digest(text))
}
