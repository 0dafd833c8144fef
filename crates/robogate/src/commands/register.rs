//! `robogate gate --register`: registers a run before its first episode.

use std::fs;
use std::path::{Path, PathBuf};

use anyhow::anyhow;
use robogate_campaign::Plan;
use robogate_dictionary::Provenance;
use robogate_gate::evidence::{PrivateKey, REGISTRATION, REGISTRATION_KEY, list_of, register};

use crate::exit::{Exit, OrExit};
use crate::terminal::note;

/// The key that signs registrations.
pub(crate) struct Registrar {
    key: PrivateKey,
    file: PathBuf,
}

/// A signed registration.
pub(crate) struct Registered {
    envelope: String,
    key: String,
}

impl Registrar {
    /// Reads the private key.
    pub(crate) fn new(file: &Path) -> Result<Self, Exit> {
        let key = PrivateKey::read(file)?;
        Ok(Self { key, file: file.to_owned() })
    }

    /// Registers the run with this plan, which must not have started yet.
    pub(crate) fn register(&self, plan: &Plan, provenance: &Provenance) -> Result<Registered, Exit> {
        // The provenance as the run records it.
        let plan_json = serde_json::to_value(plan).or_broken()?;
        let recorded = Provenance { plan: plan_json, seed: plan.seed, ..provenance.clone() };
        let (envelope, number) = register(&self.key, &self.file, &recorded)?;
        note(format_args!(
            "registered as number {number} of key {}, in {}",
            self.key.public().id(),
            list_of(&self.file).display()
        ));
        Ok(Registered { envelope: envelope.to_json(), key: self.key.public().to_pem() })
    }
}

impl Registered {
    /// The files in the folder of the run: names and contents.
    pub(crate) fn files(&self) -> [(&'static str, &[u8]); 2] {
        [(REGISTRATION, self.envelope.as_bytes()), (REGISTRATION_KEY, self.key.as_bytes())]
    }
}

/// Rejects a folder in which no run can start, because a registration cannot be taken back.
pub(crate) fn free(dir: &Path) -> Result<(), Exit> {
    let used = fs::read_dir(dir).is_ok_and(|mut entries| entries.next().is_some());
    if used {
        Err(anyhow!("{} is not empty\nHint: choose an empty or new folder", dir.display())).or_usage()
    } else {
        Ok(())
    }
}
