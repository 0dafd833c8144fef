//! Errors in replies.

use robogate_core::{Fault, FaultKind};
use serde::{Deserialize, Serialize};

/// The reason why a request was not executed.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct ErrorReply {
    /// Class of the error.
    pub kind: ErrorKind,
    /// Description for the user, one line.
    pub detail: String,
}

/// Classes of errors.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ErrorKind {
    /// The scenario cannot be set up.
    Setup,
    /// A parameter is unknown, or its value after the reset differs from the requested one.
    NotApplied,
    /// The action has the wrong length or is not finite.
    BadAction,
    /// The physics diverged.
    Diverged,
    /// The request violates the protocol.
    Unsupported,
    /// The request breaks the protocol.
    BadRequest,
    /// Any other failure inside the server.
    Internal,
}

impl ErrorKind {
    /// The kind of fault that an episode gets from this error.
    pub fn fault(self) -> FaultKind {
        match self {
            Self::Setup | Self::Unsupported => FaultKind::Setup,
            Self::NotApplied => FaultKind::NotApplied,
            Self::BadAction => FaultKind::BadAction,
            Self::Diverged => FaultKind::Diverged,
            Self::BadRequest | Self::Internal => FaultKind::Unavailable,
        }
    }

    /// Whether the error ends the running episode.
    pub fn ends_episode(self) -> bool {
        matches!(self, Self::Setup | Self::NotApplied | Self::Diverged | Self::Internal)
    }
}

impl From<&Fault> for ErrorReply {
    fn from(fault: &Fault) -> Self {
        let kind = match fault.kind {
            FaultKind::Setup => ErrorKind::Setup,
            FaultKind::NotApplied => ErrorKind::NotApplied,
            FaultKind::BadAction => ErrorKind::BadAction,
            FaultKind::Diverged => ErrorKind::Diverged,
            FaultKind::Unavailable => ErrorKind::Internal,
        };
        Self { kind, detail: fault.detail.clone() }
    }
}
