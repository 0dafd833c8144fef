//! What the gate answers.

use std::fmt;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// The gate's answer.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Verdict {
    /// Every requirement is met, whatever the invalid episodes could have been.
    Pass,
    /// At least one requirement is violated, whatever the invalid episodes could have been.
    Fail,
    /// The evidence supports neither.
    Inconclusive,
    /// There is no evidence: nothing was evaluated, or nothing that counts.
    Invalid,
}

impl Verdict {
    /// The exit code of a command that ends with this verdict: 0, 1, 3, 4.
    pub fn exit_code(self) -> u8 {
        match self {
            Self::Pass => 0,
            Self::Fail => 1,
            Self::Inconclusive => 3,
            Self::Invalid => 4,
        }
    }

    /// The verdict's word in data and reports.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Pass => "pass",
            Self::Fail => "fail",
            Self::Inconclusive => "inconclusive",
            Self::Invalid => "invalid",
        }
    }
}

impl fmt::Display for Verdict {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.as_str())
    }
}
