//! The messages: what `bridges/PROTOCOL.md` says, as types.

use std::collections::BTreeMap;
use std::sync::Arc;

use robogate_core::{
    Assignment, Contact, Ending, FailureMode, Fault, FaultKind, Measures, Observation, Pose, TaskSpec, Value,
};
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

use super::bounds::{self, Malformed};

/// A header's bytes.
pub fn encode(header: &impl Serialize) -> Result<Vec<u8>, Malformed> {
    rmp_serde::to_vec_named(header).map_err(|why| Malformed::Shape(why.to_string()))
}

/// The header in these bytes, held to the bounds.
pub fn decode<T: DeserializeOwned>(bytes: &[u8]) -> Result<T, Malformed> {
    bounds::check(bytes)?;
    rmp_serde::from_slice(bytes).map_err(|why| Malformed::Shape(format!("the header: {why}")))
}

/// What every request begins with.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Request<T> {
    /// Version of the protocol.
    pub v: u64,
    /// What is asked for.
    pub op: String,
    /// The episode that is meant.
    pub episode: u64,
    /// The rest.
    #[serde(flatten)]
    pub body: T,
}

/// What every reply begins with.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Envelope {
    /// Version of the protocol.
    pub v: u64,
    /// The episode that was meant.
    pub episode: u64,
    /// Whether it was done.
    pub ok: bool,
    /// Why not.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub error: Option<Refusal>,
}

/// A reply that says what was done.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Reply<T> {
    /// How it begins.
    #[serde(flatten)]
    pub envelope: Envelope,
    /// The rest.
    #[serde(flatten)]
    pub body: T,
}

/// Why a request was not done.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Refusal {
    /// The class of error.
    pub kind: ErrorKind,
    /// One line for people.
    pub detail: String,
}

/// Classes of error on the wire.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ErrorKind {
    /// The scenario cannot be set up.
    Setup,
    /// A parameter was refused or came out different.
    NotApplied,
    /// Something that is no action.
    BadAction,
    /// The physics is not to be believed any more.
    Diverged,
    /// The server cannot do this at all.
    Unsupported,
    /// The request breaks the protocol.
    BadRequest,
    /// Anything else.
    Internal,
}

impl ErrorKind {
    /// The fault that an episode has by it.
    pub fn fault(self) -> FaultKind {
        match self {
            Self::Setup | Self::Unsupported => FaultKind::Setup,
            Self::NotApplied => FaultKind::NotApplied,
            Self::BadAction => FaultKind::BadAction,
            Self::Diverged => FaultKind::Diverged,
            Self::BadRequest | Self::Internal => FaultKind::Unavailable,
        }
    }

    /// Whether no episode is under way after it.
    pub fn ends_episode(self) -> bool {
        matches!(self, Self::Setup | Self::NotApplied | Self::Diverged | Self::Internal)
    }
}

impl From<&Fault> for Refusal {
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

/// How actions are given.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ActionSpace {
    /// Joint positions, then the gripper.
    JointPosition,
    /// A way and a turn of the tool, then the gripper.
    ToolDelta,
}

/// Who a server is and what it can do.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Hello {
    /// The program that answers.
    pub server: Program,
    /// The physics.
    pub engine: Engine,
    /// The robot.
    pub robot: Robot,
    /// The engine's time step, in seconds.
    pub time_step_s: f64,
    /// Time between two actions, in seconds.
    pub control_period_s: f64,
    /// An episode is a timeout from here on, in seconds.
    pub time_limit_s: f64,
    /// The arm's joints, base to tip.
    pub joints: Vec<String>,
    /// The action spaces that it takes.
    pub action_spaces: Vec<ActionSpace>,
    /// What 1 means in a tool delta.
    pub tool_delta: Option<DeltaScale>,
    /// The cameras.
    pub cameras: Vec<Camera>,
    /// `wxyz`.
    pub quaternion_order: String,
    /// `top_left`.
    pub image_origin: String,
    /// The parameters that it can apply.
    pub parameters: Vec<String>,
    /// Whether it has a world and a task of its own.
    pub judges: bool,
    /// Whether the same reset and actions give the same state hashes.
    pub deterministic: bool,
}

/// A program by name and version.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Program {
    /// Its name.
    pub name: String,
    /// Its version.
    pub version: String,
}

/// A physics engine.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Engine {
    /// Its name.
    pub name: String,
    /// Its version.
    pub version: String,
    /// Which of its solvers, where it has several.
    pub solver: Option<String>,
}

/// A robot by its name and its files.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Robot {
    /// Its name.
    pub name: String,
    /// The hash of its files, where it has some.
    pub sha256: Option<String>,
}

/// What 1 means in a tool delta.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct DeltaScale {
    /// Of the way, in metres.
    pub translation_m: f64,
    /// Of the turn, in radians.
    pub rotation_rad: f64,
}

/// A camera.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Camera {
    /// Its name.
    pub name: String,
    /// Pixels in a row.
    pub width: usize,
    /// Rows.
    pub height: usize,
}

impl Hello {
    /// Time steps in a control period.
    pub fn steps_per_period(&self) -> usize {
        (self.control_period_s / self.time_step_s).round() as usize
    }

    /// Holds it to the protocol.
    pub fn check(&self) -> Result<(), String> {
        let demand = |holds: bool, what: &str| if holds { Ok(()) } else { Err(format!("hello: {what}")) };
        let whole = |a: f64, b: f64| a > 0.0 && b >= a && b / a <= 1e6 && (b / a - (b / a).round()).abs() <= 1e-6;
        let size = |n: usize| (1..=bounds::PIXELS).contains(&n);
        demand((1..=bounds::JOINTS).contains(&self.joints.len()), "joints must be 1 to 32")?;
        demand(!self.action_spaces.is_empty(), "action_spaces must not be empty")?;
        demand(
            whole(self.time_step_s, self.control_period_s),
            "control_period_s must be a whole number of time steps",
        )?;
        demand(whole(self.control_period_s, self.time_limit_s), "time_limit_s must be a whole number of periods")?;
        demand(self.quaternion_order == "wxyz", "quaternion_order must be wxyz")?;
        demand(self.image_origin == "top_left", "image_origin must be top_left")?;
        demand(self.cameras.len() <= bounds::CAMERAS, "cameras must be 16 at most")?;
        demand(self.cameras.iter().all(|c| size(c.width) && size(c.height)), "a camera must have 1 to 4096 pixels")?;
        demand(self.parameters.len() <= bounds::PARAMETERS, "parameters must be 256 at most")?;
        let delta = self.action_spaces.contains(&ActionSpace::ToolDelta);
        demand(delta == self.tool_delta.is_some(), "tool_delta must be there exactly where it is an action space")?;
        let positive = self.tool_delta.is_none_or(|scale| scale.translation_m > 0.0 && scale.rotation_rad > 0.0);
        demand(positive, "tool_delta must be positive")?;
        demand(
            self.judges || self.action_spaces == [ActionSpace::JointPosition],
            "action_spaces must be joint_position alone where the server does not judge",
        )
    }
}

/// Nothing more.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Nothing {}

/// What a reset asks for. `C` is the cell of a server that does not judge.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Reset<C> {
    /// The episode's index in its campaign.
    pub index: u64,
    /// The campaign's seed.
    pub seed: u64,
    /// The parameters asked for.
    pub parameters: BTreeMap<String, Number>,
    /// The cell, or nil.
    pub cell: Option<C>,
}

/// A parameter's value.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum Number {
    /// A whole number.
    Integer(i64),
    /// Any number.
    Float(f64),
    /// A word.
    Word(String),
}

/// An assignment as a map.
pub(super) fn parameters(assignment: &Assignment) -> BTreeMap<String, Number> {
    let number = |value: &Value| match value {
        Value::Integer(n) => Number::Integer(*n),
        Value::Number(x) => Number::Float(*x),
        Value::Category(word) => Number::Word(word.to_string()),
    };
    assignment.iter().map(|(name, value)| (name.to_owned(), number(value))).collect()
}

/// A map as an assignment, in the order of `like` as far as it names them.
pub(super) fn assignment(map: &BTreeMap<String, Number>, like: &Assignment) -> Assignment {
    let value = |number: &Number| match number {
        Number::Integer(n) => Value::Integer(*n),
        Number::Float(x) => Value::Number(*x),
        Number::Word(word) => Value::Category(word.as_str().into()),
    };
    let known = like.iter().filter_map(|(name, _)| map.get_key_value(name));
    let other = map.iter().filter(|(name, _)| like.get(name).is_none());
    known.chain(other).map(|(name, number)| (Arc::from(name.as_str()), value(number))).collect()
}

/// What a reset answers. Of a judging server `R` and `S` stand for nothing.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(bound(deserialize = "R: DeserializeOwned, S: DeserializeOwned"))]
pub struct Begun<R, S> {
    /// The first observation.
    pub observation: Seen,
    /// What the policy may know.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub task: Option<TaskSpec>,
    /// The parameters after they were applied.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub applied: Option<BTreeMap<String, Number>>,
    /// What the engine holds of the cell.
    #[serde(default = "none", skip_serializing_if = "Option::is_none")]
    pub readback: Option<R>,
    /// The start.
    #[serde(default = "none", skip_serializing_if = "Option::is_none")]
    pub sight: Option<S>,
}

fn none<T>() -> Option<T> {
    None
}

/// An observation, without images.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Seen {
    /// Simulated time since the start, in seconds.
    pub time_s: f64,
    /// In radians (metres for a sliding joint).
    pub joint_positions: Vec<f64>,
    /// Per second.
    pub joint_velocities: Vec<f64>,
    /// Between the fingers, in metres.
    pub gripper_opening_m: Option<f64>,
    /// The tool centre point.
    pub tool_pose: Pose,
}

impl From<&Observation> for Seen {
    fn from(observation: &Observation) -> Self {
        Self {
            time_s: observation.time_s,
            joint_positions: observation.joint_positions.clone(),
            joint_velocities: observation.joint_velocities.clone(),
            gripper_opening_m: observation.gripper_opening_m,
            tool_pose: observation.tool_pose,
        }
    }
}

impl Seen {
    /// The observation, where it is one of this many joints at this time.
    pub(super) fn observation(self, joints: usize, time_s: f64) -> Result<Observation, String> {
        let (positions, velocities) = (self.joint_positions.len(), self.joint_velocities.len());
        if positions != joints || velocities != joints {
            return Err(format!("{positions} joint positions and {velocities} velocities for {joints} joints"));
        }
        if (self.time_s - time_s).abs() > 1e-6 {
            return Err(format!("an observation at {} s where {time_s} s was due", self.time_s));
        }
        check_pose("tool_pose", &self.tool_pose)?;
        Ok(Observation {
            time_s,
            joint_positions: self.joint_positions,
            joint_velocities: self.joint_velocities,
            gripper_opening_m: self.gripper_opening_m,
            tool_pose: self.tool_pose,
            images: Vec::new(),
        })
    }
}

/// Whether a pose's quaternion is one of a rotation.
pub(super) fn check_pose(what: &str, pose: &Pose) -> Result<(), String> {
    let squared: f64 = pose.orientation.iter().map(|x| x * x).sum();
    if (squared - 1.0).abs() <= 2e-6 {
        return Ok(());
    }
    Err(format!("{what} has the quaternion {:?}, which is of no rotation", pose.orientation))
}

/// What a step asks for.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Steps {
    /// Control periods run so far.
    pub tick: u64,
    /// How the actions are given.
    pub action_space: ActionSpace,
    /// One for each control period.
    pub actions: Vec<Vec<f64>>,
}

/// What a step answers.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(bound(deserialize = "S: DeserializeOwned"))]
pub struct Stepped<S> {
    /// One for each action that was run.
    pub steps: Vec<Period<S>>,
}

/// One control period.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(bound(deserialize = "S: DeserializeOwned"))]
pub struct Period<S> {
    /// At its end.
    pub observation: Seen,
    /// Over the simulator's full state.
    pub state_hash: u64,
    /// What was measured so far.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub measures: Option<Measures>,
    /// The decisive event.
    #[serde(default)]
    pub ending: Option<End>,
    /// For the story of a replay.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub events: Option<Vec<String>>,
    /// One for each time step.
    #[serde(default = "none", skip_serializing_if = "Option::is_none")]
    pub sights: Option<Vec<S>>,
    /// Smallest distance between the robot and a fixture, in metres.
    #[serde(default)]
    pub clearance_m: Option<f64>,
}

/// How an episode ended.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct End {
    /// Nothing is success.
    pub failure: Option<FailureMode>,
    /// When, in simulated seconds.
    pub time_s: f64,
    /// The contact that decided it.
    pub contact: Option<Contact>,
}

impl From<Ending> for End {
    fn from(ending: Ending) -> Self {
        Self { failure: ending.failure, time_s: ending.time_s, contact: ending.contact }
    }
}

impl From<End> for Ending {
    fn from(end: End) -> Self {
        Self { failure: end.failure, time_s: end.time_s, contact: end.contact }
    }
}

/// Which cameras a render asks for.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Render {
    /// All of them where it is left out.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub cameras: Option<Vec<String>>,
}

/// What a render answers.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Rendered {
    /// Control periods run so far.
    pub tick: u64,
    /// The pictures.
    pub images: Vec<Picture>,
}

/// A picture and the frame that it is in.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Picture {
    /// The camera's name.
    pub camera: String,
    /// Pixels in a row.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// The frame, 1 and up.
    pub frame: usize,
}

/// What a hash answers.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Hashed {
    /// Control periods run so far.
    pub tick: u64,
    /// As in the last step; before the first it may be nil.
    pub state_hash: Option<u64>,
}
