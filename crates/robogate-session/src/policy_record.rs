//! Policies as runs record and keep them.

use std::fs;
use std::io;
use std::path::Path;
use std::sync::Arc;

use anyhow::anyhow;
use robogate_dictionary::{ExternalPolicyRecord, PolicyRecord, files, hex};
use robogate_policy::{Access, Servers};
use serde::de::DeserializeOwned;
use serde_json::Value;
use sha2::{Digest, Sha256};

use crate::failure::{Failure, OrFailure};
use crate::notice::note;
use crate::policy_source::{BuiltInPolicy, DeclaredPolicy, ExternalSource, PolicySource, network_sha256};
use crate::text::foreign;

impl PolicySource {
    /// The record of this policy.
    ///
    /// # Errors
    /// A profile or a map that JSON cannot hold.
    pub(crate) fn record(&self) -> serde_json::Result<PolicyRecord> {
        Ok(match self {
            Self::BuiltIn(BuiltInPolicy::Random) => PolicyRecord::BuiltIn { name: self.name().to_owned() },
            Self::Declared(DeclaredPolicy { environment, version, from }) => {
                PolicyRecord::Hosted { name: environment.clone(), version: version.clone(), from: from.clone() }
            }
            Self::External(source) => PolicyRecord::External(ExternalPolicyRecord {
                server: source.server.clone(),
                profile: serde_json::to_value(&*source.profile)?,
                map: source.map.as_deref().map(serde_json::to_value).transpose()?,
                declared: source.declared.clone(),
                compared: source.compared.clone(),
            }),
        })
    }

    /// The policy of a record. It is not contacted.
    ///
    /// # Errors
    /// An unknown policy, or a profile or map that cannot be read.
    pub(crate) fn recorded(record: &PolicyRecord) -> Result<Self, Failure> {
        Ok(match record {
            PolicyRecord::BuiltIn { name } if name == "random" => Self::BuiltIn(BuiltInPolicy::Random),
            PolicyRecord::BuiltIn { name } => {
                return Err(anyhow!("plan.json: this version has no built-in policy `{}`", foreign(name))).or_request();
            }
            PolicyRecord::Hosted { name, version, from } => {
                let (environment, version, from) = (name.clone(), version.clone(), from.clone());
                Self::Declared(DeclaredPolicy { environment, version, from })
            }
            PolicyRecord::External(ExternalPolicyRecord { server, profile, map, declared, compared }) => {
                Self::External(ExternalSource {
                    server: server.clone(),
                    profile: Arc::new(part("profile", profile)?),
                    map: map.as_ref().map(|map| part("map", map)).transpose()?.map(Arc::new),
                    declared: declared.clone(),
                    at: None,
                    access: Access::default(),
                    servers: Servers::of(server),
                    compared: compared.clone(),
                })
            }
        })
    }
}

/// The folder in that of a run with the network of its policy.
pub const POLICY: &str = "policy";
/// The largest network that a run keeps a copy of, in bytes.
const MOST_BYTES: u64 = 256 << 20;

impl PolicySource {
    /// The network of a policy in a file, with its recorded digest.
    fn network(&self) -> Option<(&Path, &str)> {
        let Self::External(ExternalSource { server, profile, declared, .. }) = self else { return None };
        let is_file = profile.dialect.is_file() && !server.contains("://");
        is_file.then_some(Path::new(server)).zip(declared.get("sha256").and_then(Value::as_str))
    }

    /// Copies the network into the folder of a run, so that later edits do not end its replays. An error is a note: the digest is
    /// recorded.
    pub(crate) fn keep(&self, run: &Path) {
        let Some((file, sha256)) = self.network() else { return };
        let copy = || {
            let bytes = fs::metadata(file)?.len();
            if bytes > MOST_BYTES {
                return Err(io::Error::other(format!("it has {} MiB (at most {})", bytes >> 20, MOST_BYTES >> 20)));
            }
            let content = fs::read(file)?;
            if hex(&Sha256::digest(&content)) != sha256 {
                return Err(io::Error::other("it has changed meanwhile"));
            }
            let target = run.join(POLICY).join(file.file_name().unwrap_or_default());
            files::create_folders(run.join(POLICY))?;
            files::write(target, content)
        };
        if let Err(why) = copy() {
            note(format_args!("note: the run keeps no copy of its policy: {why}"));
        }
    }

    /// The kept copy of the network in the folder of its run, if the file itself is not the recorded one any more.
    pub(crate) fn kept(&self, run: &Path) -> Option<String> {
        let (file, sha256) = self.network()?;
        let same = |file: &Path| network_sha256(file).is_ok_and(|found| found == sha256);
        let copy = run.join(POLICY).join(file.file_name()?);
        let found = (!same(file) && same(&copy)).then(|| copy.display().to_string())?;
        note(format_args!("{} is not the network of the run any more; its copy is used", foreign(file.display())));
        Some(found)
    }
}

fn part<T: DeserializeOwned>(name: &str, value: &Value) -> Result<T, Failure> {
    T::deserialize(value)
        .map_err(|why| anyhow!("plan.json: provenance.world.policy.{name} cannot be read: {why}"))
        .or_request()
}
