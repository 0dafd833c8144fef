//! Policies as runs record them.

use std::sync::Arc;

use anyhow::anyhow;
use robogate_dictionary::{ExternalPolicyRecord, PolicyRecord};
use robogate_policy::Access;
use serde::de::DeserializeOwned;
use serde_json::Value;

use crate::failure::{Failure, OrFailure};
use crate::policy_source::{BuiltInPolicy, DeclaredPolicy, ExternalSource, PolicySource};
use crate::text::foreign;

impl PolicySource {
    /// The record of this policy.
    ///
    /// # Errors
    /// A profile or a map that JSON cannot hold.
    pub(crate) fn record(&self) -> serde_json::Result<PolicyRecord> {
        Ok(match self {
            Self::BuiltIn(BuiltInPolicy::Random) => PolicyRecord::BuiltIn { name: self.name().to_owned() },
            Self::Declared(DeclaredPolicy { environment, version }) => {
                PolicyRecord::Hosted { name: environment.clone(), version: version.clone() }
            }
            Self::External(source) => PolicyRecord::External(ExternalPolicyRecord {
                server: source.server.clone(),
                profile: serde_json::to_value(&*source.profile)?,
                map: source.map.as_deref().map(serde_json::to_value).transpose()?,
                declared: source.declared.clone(),
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
            PolicyRecord::Hosted { name, version } => {
                Self::Declared(DeclaredPolicy { environment: name.clone(), version: version.clone() })
            }
            PolicyRecord::External(ExternalPolicyRecord { server, profile, map, declared }) => {
                Self::External(ExternalSource {
                    server: server.clone(),
                    profile: Arc::new(part("profile", profile)?),
                    map: map.as_ref().map(|map| part("map", map)).transpose()?.map(Arc::new),
                    declared: declared.clone(),
                    at: None,
                    access: Access::default(),
                })
            }
        })
    }
}

fn part<T: DeserializeOwned>(name: &str, value: &Value) -> Result<T, Failure> {
    T::deserialize(value)
        .map_err(|why| anyhow!("plan.json: provenance.world.policy.{name} cannot be read: {why}"))
        .or_request()
}
