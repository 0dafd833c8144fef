//! Messages of `reset`.

use std::collections::BTreeMap;

use robogate_core::TaskInstance;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

use super::{ObservationMessage, ParameterValue, Proposed};

/// Request to begin an episode. `C` is the cell that a server without its own task must set up.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ResetRequest<C> {
    /// Index of the episode in its campaign.
    pub index: u64,
    /// Seed of the campaign.
    pub seed: u64,
    /// Requested parameters.
    pub parameters: BTreeMap<String, ParameterValue>,
    /// Cell. Nil for a server that scores itself.
    pub cell: Option<C>,
    /// Declared policy that proposes the actions of the episode.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub policy: Option<String>,
    /// Record the motion of all bodies: at most one frame in this time, in seconds.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub record_s: Option<f64>,
}

/// Reply to `reset`.
///
/// A server that scores itself sends `applied`, and `instance` if the episode has its own instruction or details. Any
/// other server sends `readback` of type `R` and a sample of type `S`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(bound(deserialize = "R: DeserializeOwned, S: DeserializeOwned"))]
pub struct ResetReply<R, S> {
    /// First observation.
    pub observation: ObservationMessage,
    /// Instruction and details of this episode. Default: the instruction of the task.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub instance: Option<TaskInstance>,
    /// Parameters as read back after they were applied.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub applied: Option<BTreeMap<String, ParameterValue>>,
    /// Hidden draws of the episode, by name. Nil for a draw without a value.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub draws: Option<BTreeMap<String, Option<f64>>>,
    /// Properties of the cell as read back from the engine.
    #[serde(default = "none", skip_serializing_if = "Option::is_none")]
    pub readback: Option<R>,
    /// Physical state at the start; key `sight` on the wire.
    #[serde(rename = "sight", default = "none", skip_serializing_if = "Option::is_none")]
    pub sample: Option<S>,
    /// First action of the policy of the request.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub proposed: Option<Proposed>,
}

/// The default of an optional key whose type has no default.
pub(super) fn none<T>() -> Option<T> {
    None
}
