//! The question of a gate as a file, which is written before the first episode.

use std::path::Path;

use robogate_core::budget::Budget;
use robogate_dictionary::{Provenance, hex, read_regular_text};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

use crate::{Baseline, GateError, RealEvidence, Requirements, Sampling};

/// The question of a gate that runs episodes, with everything that its verdict depends on.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Asked {
    /// Version of the format.
    pub format: u32,
    /// The requirements.
    pub requirements: Requirements,
    /// The baseline of relative requirements.
    pub baseline: Option<Baseline>,
    /// The policy that may be replaced.
    pub against: Option<AskedAgainst>,
    /// Whether the gate tests after each round, or once.
    pub sampling: Sampling,
    /// Trials of the real robot.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub real: Option<RealEvidence>,
}

/// The run of a policy that may be replaced.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct AskedAgainst {
    /// Absolute path of its run.
    pub path: String,
    /// SHA-256 (hex) of its rows.
    pub dataset_sha256: String,
    /// The non-inferiority margin: how far the success rate may lie below that of this run.
    pub margin: f64,
}

impl Asked {
    /// The name of the file in a run's folder.
    pub const FILE: &'static str = "gate-question.json";
    /// The version that this build writes, and the only one that it reads.
    pub const FORMAT: u32 = 1;

    /// Reads the question of the run in `folder`. `None` if a gate did not start the run.
    ///
    /// # Errors
    /// If the file is not valid.
    pub fn of(folder: &Path) -> Result<Option<Self>, GateError> {
        let path = folder.join(Self::FILE);
        if !path.is_file() {
            return Ok(None);
        }
        let text = read_regular_text(&path).map_err(|source| GateError::Unreadable { path: path.clone(), source })?;
        Self::from_json(&path, &text).map(Some)
    }

    /// Rejects a question that is not the one that the rows of its run name.
    ///
    /// # Errors
    /// [`GateError::OtherQuestion`].
    pub fn check(&self, provenance: &Provenance) -> Result<(), GateError> {
        match &provenance.question_sha256 {
            Some(recorded) if self.sha256() != *recorded => Err(GateError::OtherQuestion),
            _ => Ok(()),
        }
    }

    /// Parses the content of the file `path`.
    ///
    /// # Errors
    /// If the content is not valid.
    pub fn from_json(path: &Path, text: &str) -> Result<Self, GateError> {
        let in_file = |error| GateError::InFile { path: path.to_owned(), error: Box::new(error) };
        let asked: Self = Budget::FILE
            .json(text.as_bytes())
            .map_err(|error| in_file(GateError::Syntax(format!("not a gate's question: {error}"))))?;
        if asked.format != Self::FORMAT {
            let text =
                format!("unsupported format {}. Expected {}\nHint: upgrade robogate", asked.format, Self::FORMAT);
            return Err(in_file(GateError::Syntax(text)));
        }
        asked.requirements.check().map_err(in_file)?;
        Ok(asked)
    }

    /// SHA-256 (hex) of what is asked: requirements, baseline, margin, sampling and trials of the real robot. The path and
    /// the rows of the other policy, which may run at the same time, have no effect.
    pub fn sha256(&self) -> String {
        let margin = self.against.as_ref().map(|against| against.margin);
        let mut asked = serde_json::json!({
            "requirements": self.requirements,
            "baseline": self.baseline,
            "margin": margin,
            "sampling": self.sampling,
        });
        // A question without trials keeps the hash that earlier versions gave it.
        if let (Some(real), Some(parts)) = (&self.real, asked.as_object_mut()) {
            parts.insert("real".to_owned(), serde_json::json!(real));
        }
        hex(&Sha256::digest(asked.to_string()))
    }

    /// Serialises the question. Equal questions give equal bytes.
    pub fn to_json(&self) -> String {
        // Strings and finite numbers always serialise.
        serde_json::to_string_pretty(self).unwrap_or_default() + "\n"
    }
}
