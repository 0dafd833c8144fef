//! The files of a checkpoint: weights, statistics, processors, settings and code, so that a deployed checkpoint can be compared with the
//! judged one.
//!
//! Nothing is loaded: files are hashed, and two formats are also read. The settings in JSON files are recorded one by one, and the
//! tensors of safetensors files each with a hash, so that another layout of the same content is equal and a difference has a name.
//!
//! | what | recorded |
//! |---|---|
//! | `*.json` | each setting by its path, or the hash where there are too many |
//! | `*.safetensors` | each tensor: type, shape, hash; the numbers of small ones. Files that share the weights count as one |
//! | other files | size and hash |
//! | documentation, hidden files, states of the training | nothing |

mod difference;
mod safetensors;

use std::collections::BTreeMap;
use std::fs::{self, File};
use std::io::{self, Read};
use std::path::Path;

use robogate_core::budget::{Budget, OverBudget};
use serde::{Deserialize, Serialize};
use serde_json::Value;
use sha2::{Digest, Sha256};

use safetensors::Tensors;

/// The deepest folder, counted from that of the checkpoint.
const DEEPEST: usize = 16;
/// The most files of a checkpoint.
const MOST_FILES: usize = 10_000;
/// The most settings and tensors that are recorded one by one, of all files together.
const MOST_ENTRIES: usize = 50_000;
/// The largest JSON file whose settings are recorded.
const SETTINGS: Budget = Budget { bytes: 4 << 20, values: 1 << 18, depth: 64 };
/// The largest record that is read.
const RECORD: Budget = Budget { bytes: 32 << 20, values: 1 << 21, depth: 16 };
/// Folders whose files do not belong to the policy.
const LEFT_OUT: [&str; 4] = ["training_state", "wandb", "__pycache__", "logs"];

/// The record of a checkpoint.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Checkpoint {
    /// The version of the record.
    format: u32,
    /// Files by their path in the checkpoint, with `/` between its parts.
    files: BTreeMap<String, Content>,
    /// Tensors by their name, for each file or group of files of weights.
    tensors: BTreeMap<String, Tensors>,
}

/// What is recorded of a file.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
enum Content {
    /// Its settings by their path.
    Settings(BTreeMap<String, Value>),
    /// Its bytes.
    Bytes {
        /// Their number.
        size: u64,
        /// SHA-256 (hex).
        sha256: String,
    },
}

/// Why a checkpoint cannot be recorded, or a record cannot be read.
#[derive(Debug, thiserror::Error)]
pub enum CheckpointError {
    /// A file or folder that cannot be read.
    #[error("cannot read {path}: {source}")]
    Io {
        /// The file.
        path: String,
        /// Why.
        source: io::Error,
    },
    /// A folder that is too large or has no policy.
    #[error("{path}: {reason}\nHint: name the folder of one checkpoint, such as pretrained_model")]
    Folder {
        /// The folder.
        path: String,
        /// What is wrong.
        reason: String,
    },
    /// A record that is too large.
    #[error(transparent)]
    OverBudget(#[from] OverBudget),
    /// A text that is not such a record.
    #[error("not the record of a checkpoint: {0}")]
    Record(serde_json::Error),
    /// A record of another version.
    #[error(
        "the record of a checkpoint has the version {0}, which is not that of this version
Hint: run the gate again with this version"
    )]
    Version(u32),
}

impl Checkpoint {
    /// The version of the record.
    const FORMAT: u32 = 1;

    /// Reads the files below a folder, or one file.
    ///
    /// # Errors
    /// A file that cannot be read, or a folder with too many files, or without any.
    pub fn of(path: &Path) -> Result<Self, CheckpointError> {
        let mut files = BTreeMap::new();
        if path.is_dir() {
            list(path, "", 0, &mut files)?;
        } else if fs::metadata(path)
            .map_err(|source| CheckpointError::Io { path: path.display().to_string(), source })?
            .is_file()
        {
            let name = path.file_name().map_or_else(String::new, |name| name.to_string_lossy().into_owned());
            files.insert(name, path.to_owned());
        }
        let folder =
            |reason: &str| CheckpointError::Folder { path: path.display().to_string(), reason: reason.to_owned() };
        if files.is_empty() {
            return Err(folder("it has no files of a policy"));
        }
        let mut found = Self { format: Self::FORMAT, files: BTreeMap::new(), tensors: BTreeMap::new() };
        let mut left = MOST_ENTRIES;
        for (name, file) in files {
            let io = |source| CheckpointError::Io { path: file.display().to_string(), source };
            if name.ends_with(".safetensors")
                && let Some(tensors) = safetensors::read(&file, left).map_err(io)?
            {
                left -= tensors.len().min(left);
                let known = found.tensors.entry(set(&name)).or_default();
                for (tensor, content) in tensors {
                    // Two parts with one name: both count.
                    let unique = if known.contains_key(&tensor) { format!("{tensor} in {name}") } else { tensor };
                    known.insert(unique, content);
                }
                continue;
            }
            // The index of a checkpoint in several files says where the tensors lie, and not what they are.
            if name.ends_with(".safetensors.index.json") {
                continue;
            }
            let content = match settings(&file, &name, left).map_err(io)? {
                Some(settings) => {
                    left -= settings.len().min(left);
                    Content::Settings(settings)
                }
                None => {
                    let (size, sha256) = hashed(&file).map_err(io)?;
                    Content::Bytes { size, sha256 }
                }
            };
            found.files.insert(name, content);
        }
        Ok(found)
    }

    /// The record as JSON. The same content gives the same bytes.
    pub fn to_json(&self) -> String {
        serde_json::to_string(self).unwrap_or_default()
    }

    /// Reads a record.
    ///
    /// # Errors
    /// A text that is too large, or not such a record.
    pub fn from_json(text: &[u8]) -> Result<Self, CheckpointError> {
        RECORD.check_json(text)?;
        let found: Self = serde_json::from_slice(text).map_err(CheckpointError::Record)?;
        if found.format == Self::FORMAT { Ok(found) } else { Err(CheckpointError::Version(found.format)) }
    }

    /// The number of files, groups of weights included, and of tensors.
    pub fn size(&self) -> (usize, usize) {
        (self.files.len() + self.tensors.len(), self.tensors.values().map(BTreeMap::len).sum())
    }
}

/// The files of a policy below a folder, by their path. Links to files are followed: a cache of models consists of them.
fn list(
    folder: &Path,
    prefix: &str,
    depth: usize,
    files: &mut BTreeMap<String, std::path::PathBuf>,
) -> Result<(), CheckpointError> {
    let io = |source| CheckpointError::Io { path: folder.display().to_string(), source };
    for entry in fs::read_dir(folder).map_err(io)? {
        let entry = entry.map_err(io)?;
        let name = entry.file_name().to_string_lossy().into_owned();
        let path = entry.path();
        let own = entry.file_type().map_err(io)?;
        if name.starts_with('.') {
            continue;
        }
        if own.is_dir() && !LEFT_OUT.contains(&name.as_str()) {
            if depth == DEEPEST {
                let reason = format!("its folders are nested more than {DEEPEST} times");
                return Err(CheckpointError::Folder { path: folder.display().to_string(), reason });
            }
            list(&path, &format!("{prefix}{name}/"), depth + 1, files)?;
        } else if own.is_symlink() && path.is_dir() {
            let reason = format!("{prefix}{name} is a link to a folder, whose files would not be compared");
            return Err(CheckpointError::Folder { path: folder.display().to_string(), reason });
        } else if !own.is_dir() && belongs(&name) && path.is_file() {
            files.insert(format!("{prefix}{name}"), path);
        }
        if files.len() > MOST_FILES {
            let reason = format!("it has more than {MOST_FILES} files");
            return Err(CheckpointError::Folder { path: folder.display().to_string(), reason });
        }
    }
    Ok(())
}

/// Whether a file can have an effect on a policy.
fn belongs(name: &str) -> bool {
    let lower = name.to_lowercase();
    let stem = lower.strip_suffix(".txt").unwrap_or(&lower);
    let is_text =
        ["readme", "license", "licence", "notice"].contains(&stem) || lower.starts_with("events.out.tfevents");
    !is_text && !lower.ends_with(".md") && !lower.ends_with(".log")
}

/// The group of a file of tensors: parts of one set of weights have one name.
fn set(name: &str) -> String {
    let (folder, file) = name.rsplit_once('/').map_or(("", name), |(folder, file)| (folder, file));
    let stem = file.trim_end_matches(".safetensors");
    let whole = match stem.rsplit_once("-of-").and_then(|(start, _)| start.rsplit_once('-')) {
        Some((start, number)) if number.bytes().all(|byte| byte.is_ascii_digit()) => start,
        _ => stem,
    };
    if folder.is_empty() { whole.to_owned() } else { format!("{folder}/{whole}") }
}

/// The settings of a JSON file by their path. `None` for a file that is not JSON, or has more of them than `most`.
fn settings(path: &Path, name: &str, most: usize) -> io::Result<Option<BTreeMap<String, Value>>> {
    if !name.ends_with(".json") || fs::metadata(path)?.len() > SETTINGS.bytes as u64 {
        return Ok(None);
    }
    let text = fs::read(path)?;
    // Python writes NaN and Infinity, which are not JSON: such a file is compared by its bytes.
    let Ok(document) = SETTINGS.json::<Value>(&text) else { return Ok(None) };
    let mut found = BTreeMap::new();
    flatten(&document, String::new(), most, &mut found);
    Ok((found.len() <= most).then_some(found))
}

/// Adds the settings of a document, each with its path. Empty lists and objects are settings too.
fn flatten(value: &Value, path: String, most: usize, found: &mut BTreeMap<String, Value>) {
    if found.len() > most {
        return;
    }
    let within = |key: &str| if path.is_empty() { key.to_owned() } else { format!("{path}.{key}") };
    match value {
        Value::Object(fields) if !fields.is_empty() => {
            fields.iter().for_each(|(key, value)| flatten(value, within(key), most, found));
        }
        Value::Array(values) if !values.is_empty() => {
            (1..).zip(values).for_each(|(at, value)| flatten(value, within(&at.to_string()), most, found));
        }
        value => drop(found.insert(path, value.clone())),
    }
}

/// Size and SHA-256 (hex) of a file.
fn hashed(path: &Path) -> io::Result<(u64, String)> {
    let mut file = File::open(path)?;
    let (mut hash, mut size) = (Sha256::new(), 0);
    let mut buffer = vec![0; 1 << 16];
    loop {
        let n = file.read(&mut buffer)?;
        if n == 0 {
            return Ok((size, hex(hash)));
        }
        hash.update(&buffer[..n]);
        size += n as u64;
    }
}

/// The SHA-256 in lower-case hexadecimal.
pub(crate) fn hex(hash: Sha256) -> String {
    hash.finalize().iter().map(|byte| format!("{byte:02x}")).collect()
}
