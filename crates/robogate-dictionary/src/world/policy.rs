//! The policy of a run.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::Value;

/// The policy of a run, other than the scripted controller of the environment.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(tag = "kind", rename_all = "snake_case", deny_unknown_fields)]
pub enum PolicyRecord {
    /// A policy of RoboGate that drives any task.
    BuiltIn {
        /// Its name.
        name: String,
    },
    /// A policy that the environment declares and runs itself.
    Hosted {
        /// Its name.
        name: String,
        /// Its version, or the hash of its files, as the environment declares it.
        #[serde(default)]
        version: String,
        /// Where the process of the environment loads it from, for a policy that is not the environment's own: `lerobot:FOLDER`.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        from: Option<String>,
    },
    /// A network in a file, or a policy behind a server.
    External(ExternalPolicyRecord),
}

/// A network in a file, which RoboGate runs, or a policy behind a server.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ExternalPolicyRecord {
    /// The address of the server, or the path of the file.
    pub server: String,
    /// The profile: its observations and actions, with the keys of a profile's file.
    pub profile: Value,
    /// How the environment becomes the task that the profile expects, with the keys of a map's file.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub map: Option<Value>,
    /// What the policy reported about itself on the first connection.
    pub declared: Value,
    /// How the answers of several servers were compared before the first episode. `None` for one server, and if they were not compared.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub compared: Option<ComparedServers>,
}

/// The comparison of the answers of several servers of one policy to the same requests.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ComparedServers {
    /// The number of servers.
    pub servers: usize,
    /// The number of requests that each of them answered.
    pub requests: usize,
    /// The largest difference from an answer of the first server, in spreads of its number. `None` for random answers.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub largest: Option<f64>,
    /// The largest difference that is admitted, in spreads.
    pub tolerance: f64,
    /// For random answers: the smallest p-value of the hypothesis that a server has the distribution of answers of the first one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub p_value: Option<f64>,
}

impl PolicyRecord {
    /// SHA-256 (hex) of the policy's file, or of what its server or its environment declared to run. `None` if it is unknown, and for
    /// a policy that is built into RoboGate.
    pub fn sha256(&self) -> Option<String> {
        let text = match self {
            Self::BuiltIn { .. } => return None,
            // The version may be the hash of its files.
            Self::Hosted { version, .. } => version,
            Self::External(external) => external.declared.get("sha256")?.as_str()?,
        };
        let digits = text.strip_prefix("sha256:").unwrap_or(text);
        let valid = digits.len() == 64 && digits.chars().all(|c| c.is_ascii_hexdigit());
        valid.then(|| digits.to_ascii_lowercase())
    }
}

impl ExternalPolicyRecord {
    /// Whether RoboGate runs a file, whose bytes it hashed.
    pub fn is_file(&self) -> bool {
        !self.server.contains("://") && self.declared.get("sha256").is_some_and(Value::is_string)
    }
}
