//! The identities of suites and tasks, as a dictionary's provenance states them.

use robogate_core::{Suite, TaskSpec};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

use crate::hex;

/// The identity of a suite: SHA-256 (hex) of its JSON without white space, in which neither the comments nor
/// the layout of its file are left.
pub fn suite_sha256(suite: &Suite) -> String {
    // A tree of strings, finite numbers and maps with string keys cannot fail to serialise.
    let json = serde_json::to_vec(suite).unwrap_or_default();
    hex(&Sha256::digest(json))
}

/// Which task it is, exactly.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct TaskIdentity {
    /// Its name.
    pub name: String,
    /// Its version.
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
