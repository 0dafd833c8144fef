//! The manifest: files of the folder, verdict and provenance.

use robogate_dictionary::{Build, Engine, Platform, Robot, Source, TaskIdentity, Tool};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::{EnvironmentBinding, PolicyBinding, QuestionBinding, Registered};
use crate::{Counts, Population, Sampling, Verdict};

/// The role of a file in the folder.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Role {
    /// The rows.
    Dictionary,
    /// The rows of the policy that may be replaced.
    Against,
    /// The requirements.
    Requirements,
    /// The baseline of relative requirements.
    Baseline,
    /// Trials of the real robot, in strata.
    Real,
    /// The evaluation: every figure and the verdict.
    Evaluation,
    /// The plan of the campaign, written before the first episode.
    Plan,
    /// The question of the gate, written before the first episode.
    Question,
    /// The registration of the run, signed before the first episode, or the key of its signer.
    Registration,
    /// The suite's scenarios.
    Suite,
    /// A file of the robot.
    Robot,
    /// A file of the environment.
    Environment,
    /// A file of the policy.
    Policy,
    /// What the policy answers to some requests, for `robogate admit`.
    Fingerprint,
    /// What repeats of the first episodes, which ran again after the last one.
    Repeats,
    /// The campaign's summary.
    Summary,
    /// The public key of the signer.
    PublicKey,
    /// What `robogate admit` found out about the deployed policy.
    Admission,
    /// The reference of the monitor.
    Monitor,
    /// A detector that warns within an episode, with its promise.
    Warning,
    /// What an upgrade changes.
    Requalification,
    /// The result of the fleet that the judged unit belongs to.
    Fleet,
    /// A document of the compliance pack or the safety case, which follows from the other files.
    Compliance,
    /// A file that the user added.
    Attachment,
}

/// A file of the folder.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct FileRecord {
    /// Its path in the folder, with slashes.
    pub path: String,
    /// Its role.
    pub role: Role,
    /// Its size in bytes.
    pub bytes: u64,
    /// SHA-256 (hex).
    pub sha256: String,
}

/// Everything that the verdict depends on, as one versioned document.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Manifest {
    /// Version of the format.
    pub format: u32,
    /// The program that wrote it, with its version.
    pub tool: Tool,
    /// The verdict.
    pub verdict: Verdict,
    /// The reason for the verdict, in one sentence.
    pub because: String,
    /// Numbers of all and of invalid episodes.
    pub counts: Counts,
    /// The population of the figures.
    pub population: Population,
    /// How the number of episodes was chosen.
    pub sampling: Sampling,
    /// The non-inferiority margin of the comparison with `against.parquet`. `None` without a comparison.
    pub margin: Option<f64>,
    /// SHA-256 (hex) of the rows, independent of their file format.
    pub dataset_sha256: String,
    /// The campaign's seed.
    pub seed: u64,
    /// The policy's name.
    pub policy: String,
    /// How the policy is identified.
    pub policy_binding: PolicyBinding,
    /// How the judged question relates to the one that the gate was asked.
    pub question: QuestionBinding,
    /// The registration of the run before its first episode. `None` if it was not registered.
    pub registration: Option<Registered>,
    /// The environment as one hash.
    pub environment: EnvironmentBinding,
    /// The task. The provenance of the rows contains its whole declaration.
    pub task: TaskIdentity,
    /// The robot, with the hash of its files.
    pub robot: Robot,
    /// The engine, with the hash of the loaded library.
    pub engine: Engine,
    /// The platform of the run, if it is known.
    pub platform: Option<Platform>,
    /// The source of the rows, if they were imported.
    pub source: Option<Source>,
    /// The program that wrote the rows, with its version.
    pub measured_by: Tool,
    /// The build of that program, if it is known.
    pub build: Option<Build>,
    /// The key that signed ([`super::PublicKey::id`]). `None` if the evidence is unsigned.
    pub signer: Option<String>,
    /// All files except manifest and statements, sorted by path.
    pub files: Vec<FileRecord>,
}

impl Manifest {
    /// The version that this build writes, and the only one that it reads.
    pub const FORMAT: u32 = 3;

    /// Serialises the manifest. Equal manifests give equal bytes.
    pub fn to_json(&self) -> String {
        // Every number is finite, so serialisation cannot fail.
        serde_json::to_string_pretty(self).unwrap_or_default() + "\n"
    }
}

/// Whether `path` is a portable relative path that stays in the folder.
pub(super) fn is_plain(path: &str) -> bool {
    let part = |part: &str| {
        !part.is_empty()
            && !part.starts_with('.')
            && part.chars().all(|c| c.is_ascii_alphanumeric() || "._-+".contains(c))
    };
    path.len() <= 200 && path.split('/').all(part)
}
