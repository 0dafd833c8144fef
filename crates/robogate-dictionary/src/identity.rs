//! Identities of suites and tasks, as recorded in the provenance of a dictionary.

use robogate_core::{Suite, TaskSpec};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

use crate::hex;

/// The identity of a suite: SHA-256 (hex) of its JSON without white space. Comments and the layout of the TOML file
/// have no effect.
pub fn suite_sha256(suite: &Suite) -> String {
    // A tree of strings, finite numbers and maps with string keys cannot fail to serialise.
    let json = serde_json::to_vec(suite).unwrap_or_default();
    hex(&Sha256::digest(json))
}

/// The exact identity of a task.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct TaskIdentity {
    /// The name.
    pub name: String,
    /// The version.
    pub version: u32,
    /// SHA-256 (hex) of its declaration as JSON.
    pub sha256: String,
}

impl TaskIdentity {
    /// The identity of `task`.
    pub fn of(task: &TaskSpec) -> Self {
        // A tree of strings, finite numbers and maps with string keys cannot fail to serialise.
        let json = serde_json::to_vec(task).unwrap_or_default();
        Self { name: task.name.as_str().to_owned(), version: task.version, sha256: hex(&Sha256::digest(json)) }
    }
}
