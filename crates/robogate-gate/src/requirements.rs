//! What is demanded, as a file.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::{GateError, Requirement, ScoreTerm};

/// What is demanded of a policy, and how sure the gate must be.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Requirements {
    /// Its name.
    pub name: String,
    /// How a metric is held against its limit.
    pub mode: Mode,
    /// In confidence mode: how sure a pass and a fail must each be. 0.95 means that each is wrong at most once in twenty.
    #[serde(default = "default_confidence")]
    pub confidence: f64,
    /// In confidence mode: what "all requirements at this confidence" means.
    #[serde(default)]
    pub family: Family,
    /// How much a gate that runs episodes itself may spend.
    #[serde(default)]
    pub budget: Budget,
    /// The demands.
    pub requirement: Vec<Requirement>,
    /// The terms of the confidence score; none, no score.
    #[serde(default)]
    pub score: Vec<ScoreTerm>,
}

/// How a metric is held against its limit.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Mode {
    /// The observed figure is compared with the limit, however few episodes it comes from (the paper's gate).
    Point,
    /// The demand must be shown to hold at the stated confidence.
    Confidence,
}

/// What a confidence over several requirements means.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Family {
    /// A pass is the claim that all are met: an intersection-union test, in which each is shown at the full level and
    /// the claim as a whole holds at it (Berger 1982). A fail is the claim that some are violated: a union of tests,
    /// which shares its error among them by Holm's procedure.
    #[default]
    IntersectionUnion,
    /// As above, and each "met" may be read alone as well: these are adjusted by Holm's procedure too.
    Holm,
}

/// How much a gate that runs episodes itself may spend.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Budget {
    /// At most this many rounds of the suite, each with fresh seeds.
    pub rounds: u32,
}

impl Default for Budget {
    fn default() -> Self {
        Self { rounds: 20 }
    }
}

fn default_confidence() -> f64 {
    0.95
}

impl Requirements {
    /// Reads TOML.
    ///
    /// # Errors
    /// What is wrong and where: an unknown key, a demand without a limit.
    pub fn from_toml(text: &str) -> Result<Self, GateError> {
        toml::from_str(text).map_err(|error| GateError::Syntax(error.to_string()))
    }
}
