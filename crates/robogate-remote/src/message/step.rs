//! Messages of `step`.

use std::collections::BTreeMap;
use std::fmt;

use robogate_core::{Command, Contact, Ending, FailureMode};
use serde::de::{DeserializeOwned, IgnoredAny};
use serde::{Deserialize, Deserializer, Serialize};

use super::ObservationMessage;
use super::reset::none;

/// Request to run actions.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct StepRequest {
    /// Number of control periods run so far in this episode.
    pub tick: u64,
    /// Kind of the actions.
    pub action_space: ActionKind,
    /// Actions, one for each control period.
    pub actions: Vec<Vec<f64>>,
    /// Largest number of further control periods that the server may run with the actions of its own policy.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub ahead: u32,
}

fn is_zero(number: &u32) -> bool {
    *number == 0
}

/// The kinds of actions. Each action ends with the number of the gripper, if the task declares one.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ActionKind {
    /// A position for each joint.
    JointPosition,
    /// Translation and rotation of the tool, in units of the task's `tool_delta`.
    ToolDelta,
    /// The numbers of the task's own vector.
    Vector,
}

impl ActionKind {
    /// The kind of a command.
    pub fn of(command: &Command) -> Self {
        match command {
            Command::JointPosition(_) => Self::JointPosition,
            Command::ToolDelta { .. } => Self::ToolDelta,
            Command::Vector(_) => Self::Vector,
        }
    }
}

impl fmt::Display for ActionKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::JointPosition => "joint_position",
            Self::ToolDelta => "tool_delta",
            Self::Vector => "vector",
        })
    }
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
/// A server that scores itself sends `measures`, `ending` and `events`. Any other server sends samples of type `S` and
/// `clearance_m`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(bound(deserialize = "S: DeserializeOwned"))]
pub struct Period<S> {
    /// Observation at the end of the period.
    pub observation: ObservationMessage,
    /// Hash of the full state of the simulator.
    pub state_hash: u64,
    /// Measures of the episode so far, by name. Nil for a measure without a value.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub measures: Option<BTreeMap<String, Option<f64>>>,
    /// How the episode ended, if it did.
    #[serde(default)]
    pub ending: Option<EndingMessage>,
    /// The ending that the episode will have if the last action is repeated until the time limit, if that is certain.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub foregone: Option<EndingMessage>,
    /// Events for the timeline of a replay.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub events: Option<Vec<String>>,
    /// Physical state after each time step; key `sights` on the wire.
    #[serde(rename = "sights", default = "none", skip_serializing_if = "Option::is_none")]
    pub samples: Option<Vec<S>>,
    /// Smallest distance between the robot and a fixture, in metres.
    #[serde(default)]
    pub clearance_m: Option<f64>,
    /// Next action of the policy that proposes the actions of the episode.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub proposed: Option<Proposed>,
}

/// An action that a policy of the server proposes.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Proposed {
    /// Kind of the action.
    pub action_space: ActionKind,
    /// The numbers of the action, as in a request.
    pub action: Vec<f64>,
}

/// How an episode ended.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct EndingMessage {
    /// Failure mode. Nil for a success. Any other value is a failure, whether or not the task declares it.
    #[serde(deserialize_with = "failure")]
    pub failure: Option<FailureMode>,
    /// Simulated time of the end, in seconds.
    pub time_s: f64,
    /// Contact that decided the outcome.
    #[serde(default)]
    pub contact: Option<Contact>,
}

/// Read a failure. A value that cannot be used as a name must not become a success, and must not hide the failure in an
/// invalid episode.
fn failure<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Option<FailureMode>, D::Error> {
    #[derive(Deserialize)]
    #[serde(untagged)]
    enum Name {
        Text(String),
        Other(IgnoredAny),
    }
    Ok(Option::<Name>::deserialize(deserializer)?.map(|name| match name {
        Name::Text(text) => FailureMode::from_foreign(&text),
        Name::Other(_) => FailureMode::UNKNOWN,
    }))
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
