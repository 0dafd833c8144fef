//! Messages of `step`.

use std::collections::BTreeMap;
use std::fmt;

use robogate_core::{Command, Contact, Ending, FailureMode, TaskSpec};
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
    /// The object that the gripper acts on from now on, for a server that does not score itself. `None` keeps it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub object: Option<usize>,
    /// Whether the client reads these control periods as arrays in frames of their own.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub packed: bool,
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
    /// Further control periods, whose numbers are in frames after the header.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub packed: Option<Packed>,
    /// Results of the control periods after those.
    #[serde(default = "Vec::new", skip_serializing_if = "Vec::is_empty")]
    pub later: Vec<Period<S>>,
}

/// Control periods in which nothing but the observation, the next action and the state changes.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Packed {
    /// The only vector of the observation.
    pub vector: String,
    /// The number of control periods.
    pub periods: usize,
}

impl Packed {
    /// The control periods that the frames contain, for a task with this vector and these actions. The first of them is the
    /// one after `tick` control periods.
    ///
    /// # Errors
    /// If frames and task do not agree, or if a number is not finite.
    pub fn unpack<S>(&self, frames: &[Vec<u8>], task: &TaskSpec, tick: u64) -> Result<Vec<Period<S>>, String> {
        let known = task.observation.vectors.iter().find(|vector| vector.name == *self.vector);
        let known = known.ok_or_else(|| format!("the task has no vector `{}`", self.vector))?;
        let (low, _) = task.action.vector().ok_or("the task takes no vectors")?;
        let [observations, actions, hashes] = frames else {
            return Err(format!("{} frames after the header of packed control periods; expected 3", frames.len()));
        };
        let observations = doubles(observations, self.periods, known.length, "observations")?;
        let actions = doubles(actions, self.periods, low.len(), "actions")?;
        let (hashes, rest) = hashes.as_chunks::<8>();
        if hashes.len() != self.periods || !rest.is_empty() {
            return Err(format!("{} state hashes; expected {}", hashes.len(), self.periods));
        }
        let period = |at: usize| Period {
            observation: ObservationMessage {
                time_s: (tick + 1 + at as u64) as f64 * task.control_period_s,
                vectors: BTreeMap::from([(self.vector.clone(), row(&observations, known.length, at))]),
            },
            state_hash: u64::from_le_bytes(hashes[at]),
            measures: Some(BTreeMap::new()),
            ending: None,
            foregone: None,
            events: None,
            samples: None,
            clearance_m: None,
            proposed: Some(Proposed { action_space: ActionKind::Vector, action: row(&actions, low.len(), at) }),
        };
        Ok((0..self.periods).map(period).collect())
    }
}

/// A row of an array with rows of this length.
fn row(numbers: &[f64], length: usize, at: usize) -> Vec<f64> {
    numbers.chunks_exact(length).nth(at).map(<[f64]>::to_vec).unwrap_or_default()
}

/// The finite numbers of a frame with so many rows of this length.
fn doubles(frame: &[u8], rows: usize, length: usize, what: &str) -> Result<Vec<f64>, String> {
    let (chunks, rest) = frame.as_chunks::<8>();
    if length == 0 || Some(chunks.len()) != rows.checked_mul(length) || !rest.is_empty() {
        return Err(format!("the frame of the {what} has {} bytes; expected {rows} x {length} doubles", frame.len()));
    }
    let numbers: Vec<f64> = chunks.iter().map(|bytes| f64::from_le_bytes(*bytes)).collect();
    match numbers.iter().position(|number| !number.is_finite()) {
        Some(at) => Err(format!("number {at} of the {what} is not finite")),
        None => Ok(numbers),
    }
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

#[cfg(test)]
mod tests {
    use super::super::Empty;
    use super::*;

    fn task() -> TaskSpec {
        serde_json::from_str(
            r#"{"name": "push", "version": 1, "instruction": "", "control_period_s": 0.05, "time_limit_s": 1.0, "failure_modes": [], "measures": [], "phases": [], "parameters": [],
                "observation": {"vectors": [{"name": "seen", "length": 2}], "cameras": []},
                "action": {"spaces": [{"kind": "vector", "names": ["x"], "low": [-1], "high": [1]}]}}"#,
        )
        .unwrap()
    }

    fn frames(numbers: &[f64], actions: &[f64], hashes: &[u64]) -> Vec<Vec<u8>> {
        let bytes = |numbers: &[f64]| numbers.iter().flat_map(|n| n.to_le_bytes()).collect();
        vec![bytes(numbers), bytes(actions), hashes.iter().flat_map(|n| n.to_le_bytes()).collect()]
    }

    #[test]
    fn packed_periods_are_those_of_the_list() {
        let packed = Packed { vector: "seen".to_owned(), periods: 2 };
        let found = packed.unpack::<Empty>(&frames(&[1.0, 2.0, 3.0, 4.0], &[0.5, -0.5], &[7, u64::MAX]), &task(), 3);
        let found = found.unwrap();
        assert_eq!(found[1].observation.vectors["seen"], [3.0, 4.0]);
        assert!((found[1].observation.time_s - 0.25).abs() < 1e-12);
        assert_eq!((found[0].state_hash, found[1].state_hash), (7, u64::MAX));
        assert_eq!(found[1].proposed.as_ref().map(|next| &*next.action), Some(&[-0.5][..]));
    }

    #[test]
    fn wrong_frames_are_rejected() {
        let packed = |vector: &str, periods| Packed { vector: vector.to_owned(), periods };
        let good = || frames(&[1.0, 2.0], &[0.5], &[7]);
        for (packed, frames, part) in [
            (packed("other", 1), good(), "no vector `other`"),
            (packed("seen", 2), good(), "expected 2 x 2 doubles"),
            (packed("seen", usize::MAX), good(), "doubles"),
            (packed("seen", 1), good()[..2].to_vec(), "2 frames"),
            (packed("seen", 1), frames(&[1.0, f64::NAN], &[0.5], &[7]), "number 1 of the observations is not finite"),
            (packed("seen", 1), frames(&[1.0, 2.0], &[0.5], &[]), "0 state hashes"),
        ] {
            let why = packed.unpack::<Empty>(&frames, &task(), 0).unwrap_err();
            assert!(why.contains(part), "{why}");
        }
    }
}
