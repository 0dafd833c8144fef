//! Where a dictionary comes from.

use std::sync::Arc;

use robogate_core::{ParameterSpace, TaskSpec};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

use crate::{SCHEMA_VERSION, SchemaVersion, hex};

/// Where a dictionary comes from: everything that its rows depend on.
///
/// It holds no clock, thread count or path: two runs with the same settings on the same platform have the same
/// provenance to the byte ([`Self::to_json`]).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Provenance {
    /// What wrote it.
    pub tool: Tool,
    /// Version of the dictionary's schema.
    pub schema_version: SchemaVersion,
    /// What stepped the physics.
    pub engine: Engine,
    /// The task, as the environment declared it. Its measures are columns of the rows.
    #[serde(default = "before_tasks")]
    pub task: Arc<TaskSpec>,
    /// The robot that was judged.
    pub robot: Robot,
    /// The policy that drove it.
    pub policy: String,
    /// The settings of the world (its time step, for example) in the environment's own form.
    #[serde(default, skip_serializing_if = "serde_json::Value::is_null")]
    pub world: serde_json::Value,
    /// The parameter space: its parameters are columns of the rows, in this order.
    pub space: ParameterSpace,
    /// The settings of the campaign (stages, budgets, designs, limits) in the campaign's own form.
    pub plan: serde_json::Value,
    /// The campaign's seed.
    pub seed: u64,
    /// On what it ran; absent where that is not known (an imported dictionary).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub platform: Option<Platform>,
    /// The file it was imported from; absent where it was measured here.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub source: Option<Source>,
}

impl Provenance {
    /// The canonical JSON: the same provenance gives the same bytes.
    pub fn to_json(&self) -> String {
        // A tree of strings, numbers and maps with string keys cannot fail to serialise.
        serde_json::to_string(self).unwrap_or_default()
    }
}

/// The task of a dictionary that does not say it.
fn before_tasks() -> Arc<TaskSpec> {
    Arc::new(crate::v1::task())
}

/// The tool that wrote a dictionary.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct Tool {
    /// Its name.
    pub name: String,
    /// Its version.
    pub version: String,
}

impl Tool {
    /// This tool in this version.
    pub fn robogate() -> Self {
        Self { name: "robogate".to_owned(), version: env!("CARGO_PKG_VERSION").to_owned() }
    }
}

/// The physics engine.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct Engine {
    /// Its name (`mujoco`).
    pub name: String,
    /// Its version, where it is known.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub version: Option<String>,
    /// SHA-256 (hex) of the library that was loaded: the same version built otherwise gives other bits.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub build_sha256: Option<String>,
}

/// The robot.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Robot {
    /// Its name (`franka`).
    pub name: String,
    /// SHA-256 (hex) over the files of its folder, where there was one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sha256: Option<String>,
    /// What it can reach and carry, where that is known.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub dimensions: Option<Dimensions>,
}

/// The identity of a robot: SHA-256 (hex) over names and contents of its files, in order of name.
pub fn robot_sha256<'a>(files: impl IntoIterator<Item = (&'a str, &'a [u8])>) -> String {
    let mut files: Vec<_> = files.into_iter().collect();
    files.sort_unstable();
    let mut hash = Sha256::new();
    for (name, bytes) in files {
        // Lengths before contents: no two folders have the same stream.
        hash.update((name.len() as u64).to_le_bytes());
        hash.update(name.as_bytes());
        hash.update((bytes.len() as u64).to_le_bytes());
        hash.update(bytes);
    }
    hex(&hash.finalize())
}

/// What a robot can reach and carry, and where its work lies.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Dimensions {
    /// Published reach in metres.
    pub reach_m: f64,
    /// Published payload in kilograms.
    pub payload_kg: f64,
    /// Horizontal distance from the robot's base to the centre of the workspace, in metres.
    pub workspace_m: f64,
}

/// The platform: what decides which bits a libm or a compiler yields, and nothing of one machine.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct Platform {
    /// Operating system (`linux`).
    pub os: String,
    /// Architecture (`x86_64`).
    pub arch: String,
}

impl Platform {
    /// The platform this was compiled for.
    pub fn here() -> Self {
        Self { os: std::env::consts::OS.to_owned(), arch: std::env::consts::ARCH.to_owned() }
    }
}

/// The file an imported dictionary was made from.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct Source {
    /// Its format (`published_json`).
    pub format: String,
    /// SHA-256 (hex) of its bytes.
    pub sha256: String,
    /// What the import decided or left out, in sentences.
    pub notes: Vec<String>,
    /// What the source does not record, so that no rate of it can be estimated: names of failure modes (with `jammed` here,
    /// any failure may have been one) and `cycle_time_s`.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub not_recorded: Vec<String>,
}

/// The schema version that a new dictionary is written in.
impl Default for SchemaVersion {
    fn default() -> Self {
        SCHEMA_VERSION
    }
}
