//! Provenance: the record of how a dictionary was made.

use std::sync::Arc;

use robogate_core::latency::Execution;
use robogate_core::{ParameterSpace, TaskSpec};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

use crate::{Controls, Platform, SCHEMA_VERSION, SchemaVersion, World, hex};

/// The provenance of a dictionary: everything that its rows depend on.
///
/// It contains no times, thread counts or paths: two runs with the same settings on the same platform have
/// byte-identical provenance ([`Self::to_json`]).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Provenance {
    /// The tool that wrote the file.
    pub tool: Tool,
    /// Version of the dictionary's schema.
    pub schema_version: SchemaVersion,
    /// The build of the tool. Absent if it is unknown, as in imports.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub build: Option<Build>,
    /// The physics engine.
    pub engine: Engine,
    /// The task, as declared by the environment. Its measures are columns of the rows.
    pub task: Arc<TaskSpec>,
    /// The robot.
    pub robot: Robot,
    /// The policy.
    pub policy: String,
    /// Where the episodes took place, and the policy. Absent in imports.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub world: Option<World>,
    /// The parameter space. Its parameters are columns of the rows, in this order.
    pub space: ParameterSpace,
    /// The settings of the campaign (stages, budgets, designs, limits), in the campaign's format.
    pub plan: serde_json::Value,
    /// The campaign's seed.
    pub seed: u64,
    /// SHA-256 (hex) of the question of the gate that started the run: its requirements, baseline, margin, sampling and
    /// trials of the real robot. Absent if no gate started it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub question_sha256: Option<String>,
    /// The platform. Absent if unknown, as in an imported dictionary.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub platform: Option<Platform>,
    /// The imported file. Absent if RoboGate recorded the episodes.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub source: Option<Source>,
}

impl Provenance {
    /// SHA-256 (hex) of the policy's file, or of what its server or its environment declared to run. `None` if it is
    /// unknown, and for a policy that is built into RoboGate.
    pub fn policy_sha256(&self) -> Option<String> {
        self.world.as_ref()?.policy.as_ref()?.sha256()
    }

    /// The latency of the policy, if the run has one.
    pub fn execution(&self) -> Option<&Execution> {
        self.world.as_ref()?.execution.as_ref()
    }

    /// The controls of the gate that started the run, if they ran.
    pub fn controls(&self) -> Option<&Controls> {
        self.world.as_ref()?.controls.as_ref()
    }

    /// The canonical JSON. The same provenance gives the same bytes.
    pub fn to_json(&self) -> String {
        // A tree of strings, numbers and maps with string keys cannot fail to serialise.
        serde_json::to_string(self).unwrap_or_default()
    }
}

/// The tool that wrote a dictionary.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct Tool {
    /// The name.
    pub name: String,
    /// The version.
    pub version: String,
}

impl Tool {
    /// This tool with its version.
    pub fn robogate() -> Self {
        Self { name: "robogate".to_owned(), version: env!("CARGO_PKG_VERSION").to_owned() }
    }
}

/// The build of the tool.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct Build {
    /// SHA-256 (hex) over the source files that it was compiled from. It tells builds with different physics and the same
    /// version apart.
    pub source_sha256: String,
}

/// The physics engine.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct Engine {
    /// The name (`mujoco`).
    pub name: String,
    /// The version, if known.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub version: Option<String>,
    /// SHA-256 (hex) of the loaded library. Another build of the same version can give different bits.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub build_sha256: Option<String>,
}

/// The robot.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Robot {
    /// The name (`franka`).
    pub name: String,
    /// SHA-256 (hex) over the files of its folder, if there is one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sha256: Option<String>,
    /// Reach, payload and workspace distance, if known.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub dimensions: Option<Dimensions>,
}

/// The identity of a robot: SHA-256 (hex) over names and contents of its files, sorted by name.
pub fn robot_sha256<'a>(files: impl IntoIterator<Item = (&'a str, &'a [u8])>) -> String {
    let mut files: Vec<_> = files.into_iter().collect();
    files.sort_unstable();
    let mut hash = Sha256::new();
    for (name, bytes) in files {
        // Each length precedes its content, so different folders always give different byte streams.
        hash.update((name.len() as u64).to_le_bytes());
        hash.update(name.as_bytes());
        hash.update((bytes.len() as u64).to_le_bytes());
        hash.update(bytes);
    }
    hex(&hash.finalize())
}

/// Reach and payload of a robot, and the distance of its workspace.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Dimensions {
    /// Published reach in metres.
    pub reach_m: f64,
    /// Published payload in kilograms.
    pub payload_kg: f64,
    /// Horizontal distance from the robot's base to the centre of the workspace, in metres.
    pub workspace_m: f64,
}

/// The file from which a dictionary was imported.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct Source {
    /// The format (`published_json`).
    pub format: String,
    /// SHA-256 (hex) of its bytes.
    pub sha256: String,
    /// Decisions and omissions of the import, as sentences.
    pub notes: Vec<String>,
    /// Quantities that the source does not record, for which no rate can be estimated: names of failure modes (if
    /// `jammed` is listed, any failure may have been one) and `cycle_time_s`.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub not_recorded: Vec<String>,
    /// The role that the import assigned to each column of the file. Empty for files with fixed columns.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub columns: Vec<SourceColumn>,
    /// How the scenarios were chosen, as the user stated. Absent if unknown.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sampling: Option<RowSampling>,
    /// How the number of episodes was chosen, as the user stated. Absent if unknown.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub stopping: Option<Stopping>,
}

/// A column of an imported file.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct SourceColumn {
    /// The name in the file.
    pub column: String,
    /// Its role: `success`, `parameter mass`, `measure reward`, `identifier, not used`, `not used: it has no value`.
    pub role: String,
    /// Number of rows with a value.
    pub values: u64,
}

/// How the scenarios of imported episodes were chosen.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum RowSampling {
    /// Each parameter was sampled independently and uniformly over its range.
    Uniform,
    /// The scenarios are those that occurred. Parameters may be correlated.
    Observed,
}

/// How the number of imported episodes was chosen.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Stopping {
    /// Before the first episode.
    Fixed,
    /// While results came in.
    Monitored,
}

/// The schema version of new dictionaries.
impl Default for SchemaVersion {
    fn default() -> Self {
        SCHEMA_VERSION
    }
}
