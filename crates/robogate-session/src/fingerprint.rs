//! Fingerprints of policies and records of their checkpoints: a gate stores them, and a deployed policy is compared with them.

use std::fs;
use std::path::{Path, PathBuf};

use anyhow::{Context, anyhow};
use robogate_dictionary::{files, read_text};
use robogate_policy::{Checkpoint, Fingerprint, Recorder};
use robogate_stats::format::counted;

use crate::failure::{Failure, OrFailure};
use crate::loaded_policy::loaded_path;
use crate::notice::note;
use crate::policy_source::PolicySource;
use crate::subject::Subject;
use crate::text::foreign;

/// The file in the folder of a gate, and in its evidence.
pub const FINGERPRINT: &str = "fingerprint.msgpack";

/// The file with the record of the checkpoint of a policy, in the folder of a gate and in its evidence.
pub const CHECKPOINT: &str = "checkpoint.json";

/// The record of the checkpoint in a folder or file.
pub fn checkpoint(path: &Path) -> Result<Checkpoint, Failure> {
    let checkpoint = Checkpoint::of(path).with_context(|| format!("--checkpoint {}", path.display())).or_request()?;
    let (files, tensors) = checkpoint.size();
    let tensors = if tensors > 0 { format!(", {}", counted(tensors as u64, "tensor")) } else { String::new() };
    note(format_args!("checkpoint {}: {}{tensors}", path.display(), counted(files as u64, "file")));
    Ok(checkpoint)
}

/// The record of a checkpoint in the folder of a gate or of its evidence. `None` if the gate has none.
pub fn read_checkpoint(folder: &Path) -> Result<Option<Checkpoint>, Failure> {
    let file = folder.join(CHECKPOINT);
    if !file.is_file() {
        return Ok(None);
    }
    let text = read_text(&file).with_context(|| format!("cannot read {}", file.display())).or_request()?;
    Checkpoint::from_json(text.as_bytes()).with_context(|| file.display().to_string()).or_request().map(Some)
}

impl Subject {
    /// The record of the folder or file that the process of the environment loads as its policy, such as `lerobot:FOLDER`. `None` for
    /// other policies, and with a note if it cannot be recorded.
    pub fn loaded_checkpoint(&self) -> Option<Checkpoint> {
        let Some(PolicySource::Declared(policy)) = self.policy_source() else { return None };
        let path = Path::new(loaded_path(policy.from.as_deref()?));
        // The folder of a training has several checkpoints. These are tried in the order in which the process does it.
        let inner = ["", "pretrained_model", "checkpoints/last/pretrained_model"].map(|inner| path.join(inner));
        let loaded = inner.iter().find(|folder| folder.join("config.json").is_file());
        match checkpoint(loaded.map_or(path, PathBuf::as_path)) {
            Ok(found) => Some(found),
            Err(why) => {
                note(format_args!("note: the files of the policy are not recorded: {:#}", why.error));
                None
            }
        }
    }

    /// Asks a policy server or a network again what it was asked in some control periods of the episodes so far, and a policy in the
    /// process of its environment by the start of some episodes, and writes the answers into the folder of the run. A failure is a note: the episodes have their result.
    pub fn write_fingerprint(&self, run: &Path) {
        let measure = || -> anyhow::Result<Option<Fingerprint>> {
            let Some(PolicySource::External(source)) = self.policy_source() else {
                return self.rehearsed_fingerprint(run).map_err(|failure| failure.error);
            };
            let queries = Recorder::take(self.recorder());
            if queries.is_empty() {
                return Ok(None);
            }
            let mut policy = source.connect()?;
            let period_s = self.task().control_period_s;
            Ok(Some(Fingerprint::measure(queries, &mut policy, source.profile(), period_s)?))
        };
        let write = || -> anyhow::Result<()> {
            let Some(fingerprint) = measure()? else { return Ok(()) };
            let bytes = fingerprint.to_bytes()?;
            files::write(run.join(FINGERPRINT), bytes)
                .with_context(|| format!("cannot write {}", run.join(FINGERPRINT).display()))
        };
        if let Err(why) = write() {
            note(format_args!(
                "note: the run has no fingerprint of its policy, so `robogate admit` cannot use it: {}",
                foreign(why)
            ));
        }
    }
}

/// The largest fingerprint, and the largest record of a checkpoint.
pub const MOST_FINGERPRINT_BYTES: u64 = 64 << 20;

/// The fingerprint in a file, or in the folder of a gate or of its evidence. Nothing in it is contacted or started.
pub fn read_fingerprint(path: &Path) -> Result<Fingerprint, Failure> {
    let file = if path.is_dir() { path.join(FINGERPRINT) } else { path.to_owned() };
    if path.is_dir() && !file.exists() {
        return Err(anyhow!(
            "{}: it has no {FINGERPRINT}\nHint: gates of a policy that is not built in write one; run the gate again with this version",
            path.display()
        ))
        .or_request();
    }
    let about = || format!("cannot read {}", file.display());
    let metadata = fs::metadata(&file).with_context(about).or_request()?;
    if !metadata.is_file() || metadata.len() > MOST_FINGERPRINT_BYTES {
        return Err(anyhow!("{}: not a file of at most 64 MiB", file.display())).or_request();
    }
    let bytes = fs::read(&file).with_context(about).or_request()?;
    Fingerprint::from_bytes(&bytes).with_context(|| file.display().to_string()).or_request()
}
