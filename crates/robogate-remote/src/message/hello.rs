//! What a server reports about itself.

use serde::{Deserialize, Serialize};

use crate::limits;

/// Reply to `hello`: identity and capabilities of a server.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Hello {
    /// Program that answers.
    pub server: Program,
    /// Physics engine.
    pub engine: Engine,
    /// Robot.
    pub robot: Robot,
    /// Time step of the engine, in seconds.
    pub time_step_s: f64,
    /// Time between two actions, in seconds.
    pub control_period_s: f64,
    /// Simulated time after which an episode is a timeout, in seconds.
    pub time_limit_s: f64,
    /// Joints of the arm, from base to tip.
    pub joints: Vec<String>,
    /// Action spaces that the server accepts.
    pub action_spaces: Vec<ActionSpace>,
    /// Scale of the `tool_delta` action space.
    pub tool_delta: Option<DeltaScale>,
    /// Cameras.
    pub cameras: Vec<Camera>,
    /// Always `wxyz`.
    pub quaternion_order: String,
    /// Always `top_left`.
    pub image_origin: String,
    /// Parameters that the server can apply.
    pub parameters: Vec<String>,
    /// Whether the server has its own task and reports how an episode ended; key `judges` on the wire.
    #[serde(rename = "judges")]
    pub scores_itself: bool,
    /// Whether the same reset and actions give the same state hashes.
    pub deterministic: bool,
}

/// Name and version of a program.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Program {
    /// Name.
    pub name: String,
    /// Version.
    pub version: String,
}

/// A physics engine.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Engine {
    /// Name.
    pub name: String,
    /// Version.
    pub version: String,
    /// Solver, for an engine that has several.
    pub solver: Option<String>,
}

/// Name of a robot and hash of its files.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Robot {
    /// Name.
    pub name: String,
    /// SHA-256 of the files, if there are any.
    pub sha256: Option<String>,
}

/// How actions are given.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ActionSpace {
    /// Joint positions, then the gripper.
    JointPosition,
    /// Translation and rotation of the tool, then the gripper.
    ToolDelta,
}

/// What a value of 1 means in a `tool_delta` action.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct DeltaScale {
    /// For translations, in metres.
    pub translation_m: f64,
    /// For rotations, in radians.
    pub rotation_rad: f64,
}

/// A camera.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Camera {
    /// Name.
    pub name: String,
    /// Width in pixels.
    pub width: usize,
    /// Height in pixels.
    pub height: usize,
}

impl Hello {
    /// Number of time steps in a control period.
    pub fn steps_per_period(&self) -> usize {
        (self.control_period_s / self.time_step_s).round() as usize
    }

    /// Check that the values are allowed by the protocol.
    pub fn check(&self) -> Result<(), String> {
        let require = |holds: bool, what: &str| if holds { Ok(()) } else { Err(format!("hello: {what}")) };
        let multiple = |a: f64, b: f64| a > 0.0 && b >= a && b / a <= 1e6 && (b / a - (b / a).round()).abs() <= 1e-6;
        let size = |n: usize| (1..=limits::PIXELS).contains(&n);
        require((1..=limits::JOINTS).contains(&self.joints.len()), "joints must have 1 to 32 names")?;
        require(!self.action_spaces.is_empty(), "action_spaces must not be empty")?;
        require(
            multiple(self.time_step_s, self.control_period_s),
            "control_period_s must be an integer multiple of time_step_s",
        )?;
        require(
            multiple(self.control_period_s, self.time_limit_s),
            "time_limit_s must be an integer multiple of control_period_s",
        )?;
        require(self.quaternion_order == "wxyz", "quaternion_order must be wxyz")?;
        require(self.image_origin == "top_left", "image_origin must be top_left")?;
        require(self.cameras.len() <= limits::CAMERAS, "at most 16 cameras are allowed")?;
        let sizes = self.cameras.iter().all(|camera| size(camera.width) && size(camera.height));
        require(sizes, "the width and height of a camera must be 1 to 4096 pixels")?;
        require(self.parameters.len() <= limits::PARAMETERS, "at most 256 parameters are allowed")?;
        let delta = self.action_spaces.contains(&ActionSpace::ToolDelta);
        require(
            delta == self.tool_delta.is_some(),
            "tool_delta must be given if and only if it is one of the action_spaces",
        )?;
        let positive = self.tool_delta.is_none_or(|scale| scale.translation_m > 0.0 && scale.rotation_rad > 0.0);
        require(positive, "tool_delta must be positive")?;
        require(
            self.scores_itself || self.action_spaces == [ActionSpace::JointPosition],
            "action_spaces must be [joint_position] for a server that does not score itself",
        )
    }
}
