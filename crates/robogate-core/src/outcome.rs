//! Outcomes: how episodes end.

use std::fmt;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::{Word, WordError};

/// How an episode ended. A fault is not a failure, because it says nothing about the policy.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Outcome {
    /// The policy completed the task.
    Success,
    /// The policy failed with this failure mode.
    Failure(FailureMode),
    /// Infrastructure fault: the episode says nothing about the policy.
    Invalid(Fault),
}

impl Outcome {
    /// `success`, the failure mode, or `invalid`: the text in the dictionary's `outcome` column.
    pub fn as_str(&self) -> &'static str {
        match self {
            Self::Success => "success",
            Self::Failure(mode) => mode.as_str(),
            Self::Invalid(_) => "invalid",
        }
    }
}

/// The way in which a policy failed, declared by the task or not.
///
/// Any word can be a failure mode, except the reserved values of an `outcome` column: `success`, `invalid` and `none`.
/// An undeclared mode counts as a failure, and reports mark it.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize, JsonSchema)]
#[serde(try_from = "Word", into = "Word")]
#[schemars(with = "Word")]
pub struct FailureMode(Word);

impl FailureMode {
    /// The time limit passed before the episode ended. Every task has this mode.
    pub const TIMEOUT: Self = Self(Word::constant("timeout"));

    /// A failure without a usable description.
    pub const UNKNOWN: Self = Self(Word::constant("unknown"));

    const RESERVED: [&'static str; 3] = ["success", "invalid", "none"];

    /// The failure mode with this name.
    pub fn new(name: &str) -> Result<Self, FailureModeError> {
        Self::try_from(Word::new(name)?)
    }

    /// Creates a failure mode at compile time.
    pub const fn constant(name: &'static str) -> Self {
        Self(Word::constant(name))
    }

    /// Converts the word of an external environment or file to a failure mode. It always gives a failure: the nearest
    /// valid name, or [`Self::UNKNOWN`] if no valid character is left.
    pub fn from_foreign(name: &str) -> Self {
        Word::nearest(name).and_then(|word| Self::try_from(word).ok()).unwrap_or(Self::UNKNOWN)
    }

    /// The name in data files and reports.
    pub const fn as_str(self) -> &'static str {
        self.0.as_str()
    }
}

impl fmt::Display for FailureMode {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.fmt(f)
    }
}

impl fmt::Debug for FailureMode {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "FailureMode({})", self.0)
    }
}

impl TryFrom<Word> for FailureMode {
    type Error = FailureModeError;

    fn try_from(name: Word) -> Result<Self, FailureModeError> {
        // The comparison ignores case, because some readers of the file treat `Invalid` and `invalid` as the same.
        match Self::RESERVED.iter().any(|reserved| reserved.eq_ignore_ascii_case(name.as_str())) {
            true => Err(FailureModeError::Reserved { name }),
            false => Ok(Self(name)),
        }
    }
}

impl From<FailureMode> for Word {
    fn from(mode: FailureMode) -> Self {
        mode.0
    }
}

/// The reason why a name cannot be a failure mode.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum FailureModeError {
    /// It is not a word.
    #[error(transparent)]
    Word(#[from] WordError),
    /// The name is reserved.
    #[error("`{name}` cannot be a failure mode: `success`, `invalid` and `none` are reserved")]
    Reserved {
        /// The name.
        name: Word,
    },
}

/// A technical problem that makes an episode invalid.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, thiserror::Error)]
#[error("{kind}: {detail}")]
pub struct Fault {
    /// The class of fault.
    pub kind: FaultKind,
    /// The problem, with the offending values.
    pub detail: String,
}

impl Fault {
    /// Creates a fault of this kind.
    pub fn new(kind: FaultKind, detail: impl Into<String>) -> Self {
        Self { kind, detail: detail.into() }
    }
}

/// Classes of fault.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum FaultKind {
    /// The environment's state is not finite, or its engine reported divergence.
    Diverged,
    /// The scenario could not be set up (an object that starts in contact, an unknown parameter).
    Setup,
    /// A parameter read back from the environment differs from the requested one.
    NotApplied,
    /// The policy's answer is not a valid action of the task (wrong length, not finite or out of bounds).
    BadAction,
    /// The policy or environment disconnected or did not answer in time.
    Unavailable,
}

impl fmt::Display for FaultKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Diverged => "diverged",
            Self::Setup => "setup",
            Self::NotApplied => "not_applied",
            Self::BadAction => "bad_action",
            Self::Unavailable => "unavailable",
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn reserved_names_stay_failures() {
        for name in ["success", "Invalid", "none", "", "\u{7}", " "] {
            assert!(FailureMode::new(name).is_err(), "{name:?}");
            assert_eq!(FailureMode::from_foreign(name), FailureMode::UNKNOWN, "{name:?}");
        }
        assert_eq!(FailureMode::from_foreign("jammed").as_str(), "jammed");
        assert_eq!(FailureMode::from_foreign("jammed at 40 N").as_str(), "jammed_at_40_N");
    }
}
