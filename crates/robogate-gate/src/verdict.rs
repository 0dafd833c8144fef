//! The verdict of the gate.

use std::fmt;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// The verdict of the gate.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Verdict {
    /// Every requirement is met, for any outcome of the invalid episodes.
    Pass,
    /// At least one requirement is violated, for any outcome of the invalid episodes.
    Fail,
    /// The evidence supports neither pass nor fail.
    Inconclusive,
    /// There is no evidence: nothing was evaluated, or all episodes are invalid.
    Invalid,
}

impl Verdict {
    /// The exit code of a command that ends with this verdict: 0 pass, 1 fail, 3 inconclusive, 4 invalid.
    pub fn exit_code(self) -> u8 {
        match self {
            Self::Pass => 0,
            Self::Fail => 1,
            Self::Inconclusive => 3,
            Self::Invalid => 4,
        }
    }

    /// The name in data and reports.
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
