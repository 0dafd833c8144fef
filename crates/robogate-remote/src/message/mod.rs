//! The messages of `bridges/PROTOCOL.md` as types.

mod error;
mod hello;
mod motion;
mod observation;
mod parameters;
mod render;
mod reset;
mod step;

use serde::{Deserialize, Serialize};

pub use error::{ErrorKind, ErrorReply};
pub use hello::{Engine, Hello, HostedPolicy, Program, Robot};
pub use motion::{MotionReply, ShapeMessage, SolidMessage};
pub use observation::ObservationMessage;
pub use parameters::ParameterValue;
pub(crate) use parameters::{from_wire, to_wire};
pub use render::{HashReply, ImageInfo, RenderReply, RenderRequest};
pub use reset::{ResetReply, ResetRequest};
pub use step::{ActionKind, EndingMessage, Packed, Period, Proposed, StepReply, StepRequest};

/// The header of a request: common keys, then those of the operation.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Request<T> {
    /// Version of the protocol.
    pub v: u64,
    /// Name of the operation.
    pub op: String,
    /// Identifier of the episode, chosen by the client; 0 for `hello`.
    pub episode: u64,
    /// Keys of the operation.
    #[serde(flatten)]
    pub body: T,
}

/// The keys that every reply has.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Envelope {
    /// Version of the protocol.
    pub v: u64,
    /// Identifier of the episode, copied from the request.
    pub episode: u64,
    /// Whether the request was executed.
    pub ok: bool,
    /// The reason why the request was not executed.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub error: Option<ErrorReply>,
}

/// The header of a reply to a request that was executed.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Reply<T> {
    /// Keys that every reply has.
    #[serde(flatten)]
    pub envelope: Envelope,
    /// Keys of the operation.
    #[serde(flatten)]
    pub body: T,
}

/// A message body without keys.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Empty {}
