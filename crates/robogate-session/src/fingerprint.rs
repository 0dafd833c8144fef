//! Fingerprints of policies: a gate stores one, and a deployed policy is compared with it.

use std::fs;
use std::path::Path;

use anyhow::{Context, anyhow};
use robogate_dictionary::files;
use robogate_policy::{Fingerprint, Recorder};

use crate::failure::{Failure, OrFailure};
use crate::notice::note;
use crate::policy_source::PolicySource;
use crate::subject::Subject;
use crate::text::foreign;

/// The file in the folder of a gate, and in its evidence.
pub const FINGERPRINT: &str = "fingerprint.msgpack";

impl Subject {
    /// Asks a policy server or a network again what it was asked in some control periods of the episodes so far, and writes its
    /// answers into the folder of the run. A failure is a note: the episodes have their result.
    pub fn write_fingerprint(&self, run: &Path) {
        let Some(PolicySource::External(source)) = self.policy_source() else { return };
        let queries = Recorder::take(self.recorder());
        if queries.is_empty() {
            return;
        }
        let write = || -> anyhow::Result<()> {
            let mut policy = source.connect()?;
            let period_s = self.task().control_period_s;
            let bytes = Fingerprint::measure(queries, &mut policy, source.profile(), period_s)?.to_bytes()?;
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

/// The fingerprint in a file, or in the folder of a gate or of its evidence. Nothing in it is contacted or started.
pub fn read_fingerprint(path: &Path) -> Result<Fingerprint, Failure> {
    let file = if path.is_dir() { path.join(FINGERPRINT) } else { path.to_owned() };
    if path.is_dir() && !file.exists() {
        return Err(anyhow!(
            "{}: it has no {FINGERPRINT}\nHint: gates of a policy server or a network write one; run the gate again with this version",
            path.display()
        ))
        .or_request();
    }
    /// As large as a fingerprint may be.
    const MOST_BYTES: u64 = 64 << 20;
    let about = || format!("cannot read {}", file.display());
    let metadata = fs::metadata(&file).with_context(about).or_request()?;
    if !metadata.is_file() || metadata.len() > MOST_BYTES {
        return Err(anyhow!("{}: not a file of at most 64 MiB", file.display())).or_request();
    }
    let bytes = fs::read(&file).with_context(about).or_request()?;
    Fingerprint::from_bytes(&bytes).with_context(|| file.display().to_string()).or_request()
}
