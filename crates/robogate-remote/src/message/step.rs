//! Messages of `step`.

use robogate_core::{Contact, Ending, FailureMode, Measures};
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

use super::reset::none;
use super::{ActionSpace, ObservationMessage};

/// Request to run actions.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct StepRequest {
    /// Number of control periods run so far in this episode.
    pub tick: u64,
    /// Action space of the actions.
    pub action_space: ActionSpace,
    /// Actions, one for each control period.
    pub actions: Vec<Vec<f64>>,
}

/// Reply to `step`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(bound(deserialize = "S: DeserializeOwned"))]
pub struct StepReply<S> {
    /// Results, one for each action that was run.
    pub steps: Vec<Period<S>>,
}

/// Result of one control period.
///
/// A server that scores itself sends `measures`, `ending` and `events`. Any other sends samples of type `S` and
/// `clearance_m`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(bound(deserialize = "S: DeserializeOwned"))]
pub struct Period<S> {
    /// Observation at the end of the period.
    pub observation: ObservationMessage,
    /// Hash of the full state of the simulator.
    pub state_hash: u64,
    /// Measures of the episode so far.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub measures: Option<Measures>,
    /// How the episode ended, if it did.
    #[serde(default)]
    pub ending: Option<EndingMessage>,
    /// Events for the timeline of a replay.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub events: Option<Vec<String>>,
    /// Physical state after each time step; key `sights` on the wire.
    #[serde(rename = "sights", default = "none", skip_serializing_if = "Option::is_none")]
    pub samples: Option<Vec<S>>,
    /// Smallest distance between the robot and a fixture, in metres.
    #[serde(default)]
    pub clearance_m: Option<f64>,
}

/// How an episode ended.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct EndingMessage {
    /// Failure mode; nothing for a success.
    pub failure: Option<FailureMode>,
    /// Simulated time of the end, in seconds.
    pub time_s: f64,
    /// Contact that decided the outcome.
    pub contact: Option<Contact>,
}

impl From<Ending> for EndingMessage {
    fn from(ending: Ending) -> Self {
        Self { failure: ending.failure, time_s: ending.time_s, contact: ending.contact }
    }
}

impl From<EndingMessage> for Ending {
    fn from(message: EndingMessage) -> Self {
        Self { failure: message.failure, time_s: message.time_s, contact: message.contact }
    }
}
