//! The question as a file, written before the first episode.

use std::path::Path;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::{Baseline, GateError, Requirements, Sampling};

/// What a gate that runs episodes was asked, with everything that its answer refers to.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Asked {
    /// Version of this form.
    pub format: u32,
    /// What is demanded.
    pub requirements: Requirements,
    /// What relative demands refer to.
    pub baseline: Option<Baseline>,
    /// The policy that may be replaced.
    pub against: Option<AskedAgainst>,
    /// Whether somebody looks after each round.
    pub sampling: Sampling,
}

/// The run of a policy that may be replaced.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct AskedAgainst {
    /// Where its run was, in full.
    pub path: String,
    /// Identity of its rows (SHA-256, hex).
    pub dataset_sha256: String,
    /// How far below its success rate the other's may lie.
    pub margin: f64,
}

impl Asked {
    /// Its name in a run's folder.
    pub const FILE: &'static str = "gate-question.json";
    /// The version of the form that is written here, and the only one that is read.
    pub const FORMAT: u32 = 1;

    /// The question of the run in `folder`; `None` where it was asked none.
    ///
    /// # Errors
    /// A file that is none.
    pub fn of(folder: &Path) -> Result<Option<Self>, GateError> {
        let path = folder.join(Self::FILE);
        if !path.is_file() {
            return Ok(None);
        }
        let in_file = |error| GateError::InFile { path: path.clone(), error: Box::new(error) };
        let text =
            std::fs::read_to_string(&path).map_err(|source| GateError::Unreadable { path: path.clone(), source })?;
        let asked: Self = serde_json::from_str(&text)
            .map_err(|error| in_file(GateError::Syntax(format!("not a gate's question: {error}"))))?;
        if asked.format != Self::FORMAT {
            let text =
                format!("format {}, and this robogate reads {}\nhint: upgrade robogate", asked.format, Self::FORMAT);
            return Err(in_file(GateError::Syntax(text)));
        }
        asked.requirements.check().map_err(in_file)?;
        Ok(Some(asked))
    }

    /// As a file holds it: the same question gives the same bytes.
    pub fn to_json(&self) -> String {
        // A tree of strings and finite numbers cannot fail to serialise.
        serde_json::to_string_pretty(self).unwrap_or_default() + "\n"
    }
}
