//! What is in the folder, and what it says.

use robogate_dictionary::{Engine, Platform, Robot, Source, TaskIdentity, Tool};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::{Counts, Population, Sampling, Verdict};

/// What a file of the folder is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Role {
    /// The rows.
    Dictionary,
    /// The rows of the policy that may be replaced.
    Against,
    /// The requirements.
    Requirements,
    /// What relative demands refer to.
    Baseline,
    /// Every figure and the verdict.
    Evaluation,
    /// The plan of the campaign, as it stood before the first episode.
    Plan,
    /// The suite's scenarios.
    Suite,
    /// A file of the robot.
    Robot,
    /// A file of the policy.
    Policy,
    /// The campaign's summary.
    Summary,
    /// The public half of the key that signed.
    PublicKey,
    /// Something that the user added.
    Attachment,
}

/// A file of the folder.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct FileRecord {
    /// Its path in the folder, with slashes.
    pub path: String,
    /// What it is.
    pub role: Role,
    /// Its length.
    pub bytes: u64,
    /// SHA-256 (hex).
    pub sha256: String,
}

/// Everything that the verdict depends on: one versioned document.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Manifest {
    /// Version of this form.
    pub format: u32,
    /// What wrote it.
    pub tool: Tool,
    /// The answer.
    pub verdict: Verdict,
    /// Why, in a sentence.
    pub because: String,
    /// How many episodes, and how many of them say nothing.
    pub counts: Counts,
    /// What the figures speak of.
    pub population: Population,
    /// How the number of episodes came about.
    pub sampling: Sampling,
    /// How far below the success rate of the policy in `against.parquet` the judged one may lie; absent without it.
    pub margin: Option<f64>,
    /// Identity of the rows (SHA-256, hex), whatever file they are in.
    pub dataset_sha256: String,
    /// The campaign's seed.
    pub seed: u64,
    /// The policy.
    pub policy: String,
    /// The task; its whole declaration stands in the rows' provenance.
    pub task: TaskIdentity,
    /// The robot and the hash of its files.
    pub robot: Robot,
    /// The engine and the hash of the library that was loaded.
    pub engine: Engine,
    /// On what it ran, where that is known.
    pub platform: Option<Platform>,
    /// Where the rows come from, where they were not measured here.
    pub source: Option<Source>,
    /// What wrote the rows.
    pub measured_by: Tool,
    /// The key that signed ([`super::PublicKey::id`]); absent where nobody did.
    pub signer: Option<String>,
    /// Every other file but the statements, in order of path.
    pub files: Vec<FileRecord>,
}

impl Manifest {
    /// The version of the form that is written here, and the only one that is read.
    pub const FORMAT: u32 = 2;

    /// As the file holds it: the same manifest gives the same bytes.
    pub fn to_json(&self) -> String {
        // Every number in it is finite: nothing here can fail to serialise.
        serde_json::to_string_pretty(self).unwrap_or_default() + "\n"
    }
}

/// Whether `path` is a plain place in the folder: no way out of it, and the same on every system.
pub(super) fn is_plain(path: &str) -> bool {
    let part = |part: &str| {
        !part.is_empty()
            && !part.starts_with('.')
            && part.chars().all(|c| c.is_ascii_alphanumeric() || "._-+".contains(c))
    };
    path.len() <= 200 && path.split('/').all(part)
}
