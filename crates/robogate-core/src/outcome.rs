//! How an episode went.

use std::fmt;

use serde::{Deserialize, Serialize};

/// How an episode went. A fault is not a failure: it says nothing about the policy.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Outcome {
    /// The task was done.
    Success,
    /// The policy failed, in this way.
    Failure(FailureMode),
    /// Nothing can be said about the policy: something under it broke.
    Invalid(Fault),
}

impl Outcome {
    /// `success`, the failure mode, or `invalid`: the word in the dictionary's `outcome` column.
    pub fn word(&self) -> &'static str {
        match self {
            Self::Success => "success",
            Self::Failure(mode) => mode.word(),
            Self::Invalid(_) => "invalid",
        }
    }
}

/// How a policy fails. The four modes of the paper (section 3.2).
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum FailureMode {
    /// The gripper closed without the object.
    GraspMiss,
    /// The object was lost between grasp and release.
    GripLoss,
    /// A robot link or finger touched something that is not the object.
    Collision,
    /// The time limit passed before the task was done.
    Timeout,
}

impl FailureMode {
    /// Every mode, in the order in which reports list them.
    pub const ALL: [Self; 4] = [Self::GraspMiss, Self::GripLoss, Self::Collision, Self::Timeout];

    /// The mode's word in data and reports.
    pub fn word(self) -> &'static str {
        match self {
            Self::GraspMiss => "grasp_miss",
            Self::GripLoss => "grip_loss",
            Self::Collision => "collision",
            Self::Timeout => "timeout",
        }
    }
}

/// Why an episode is no evidence.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, thiserror::Error)]
#[error("{kind}: {detail}")]
pub struct Fault {
    /// The class of fault.
    pub kind: FaultKind,
    /// What happened, with the offending values.
    pub detail: String,
}

impl Fault {
    /// A fault of this kind.
    pub fn new(kind: FaultKind, detail: impl Into<String>) -> Self {
        Self { kind, detail: detail.into() }
    }
}

/// Classes of fault.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum FaultKind {
    /// The simulator's state is not finite, or its engine reported that it diverged.
    Diverged,
    /// The scenario could not be set up (an object that starts in contact, an unknown parameter).
    Setup,
    /// A parameter read back from the simulator is not the one that was asked for.
    NotApplied,
    /// The policy answered with something that is no action (wrong length, not finite).
    BadAction,
    /// The policy or simulator went away or did not answer in time.
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
