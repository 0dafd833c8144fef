//! The reply to `hello`.

use robogate_core::{ActionSpace, Domain, ParameterSpace, TaskSpec, Value, vectors};
use serde::{Deserialize, Serialize};

use crate::limits;

/// Reply to `hello`: identity of a server, and the task that it declares.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Hello {
    /// Program that answers.
    pub server: Program,
    /// Physics engine.
    pub engine: Engine,
    /// Robot. `None` for a world without one.
    #[serde(default)]
    pub robot: Option<Robot>,
    /// Time step of the engine, in seconds, if it is constant.
    #[serde(default)]
    pub time_step_s: Option<f64>,
    /// The task. A server that only computes physics declares its observations, the actions that it accepts and the
    /// parameters that it applies itself.
    pub task: TaskSpec,
    /// The space that is sampled by default.
    #[serde(default)]
    pub space: Option<ParameterSpace>,
    /// Policies that run in the server. The first is the default.
    #[serde(default)]
    pub policies: Vec<HostedPolicy>,
    /// Always `wxyz`.
    pub quaternion_order: String,
    /// Always `top_left`.
    pub image_origin: String,
    /// Whether the server reports how an episode ended. Otherwise it computes physics for a task of the client.
    pub scores_itself: bool,
    /// Whether the same reset and actions give the same state hashes.
    pub deterministic: bool,
    /// Whether the server records the motion of all bodies.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub records_motion: bool,
}

/// A policy that runs in the server and proposes the actions of an episode.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct HostedPolicy {
    /// Name.
    pub name: String,
    /// Description of one line.
    #[serde(default)]
    pub meaning: String,
    /// Version of the policy, or hash of its files, if it is known.
    #[serde(default)]
    pub version: String,
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
    #[serde(default)]
    pub solver: Option<String>,
    /// SHA-256 (hex) of its library, if the server states it. Another build of the same version can give other bits.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sha256: Option<String>,
}

/// Name of a robot and hash of its files.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Robot {
    /// Name.
    pub name: String,
    /// SHA-256 of the files, if there are any.
    #[serde(default)]
    pub sha256: Option<String>,
}

/// The values of `quaternion_order` and `image_origin`. They are declared so that a mismatch is detected early.
const ORDER: (&str, &str) = ("wxyz", "top_left");

impl Hello {
    /// A deterministic server that scores itself, without a robot, a constant time step or its own space.
    pub fn new(task: TaskSpec, server: Program, engine: Engine) -> Self {
        Self {
            server,
            engine,
            robot: None,
            time_step_s: None,
            task,
            space: None,
            policies: Vec::new(),
            quaternion_order: ORDER.0.to_owned(),
            image_origin: ORDER.1.to_owned(),
            scores_itself: true,
            deterministic: true,
            records_motion: false,
        }
    }

    /// Number of time steps in a control period. 0 if the time step is not constant.
    pub fn steps_per_period(&self) -> usize {
        self.time_step_s.map_or(0, |step_s| (self.task.control_period_s / step_s).round() as usize)
    }

    /// Check that the values are allowed by the protocol.
    pub fn check(&self) -> Result<(), String> {
        let require = |holds: bool, what: &str| if holds { Ok(()) } else { Err(format!("hello: {what}")) };
        let task = &self.task;
        task.check().map_err(|why| format!("hello: the declared task is not valid: {why}"))?;
        let ticks = task.limit_ticks().map_err(|why| format!("hello: task: {why}"))?;
        require(ticks <= limits::TICKS, "task.time_limit_s must be at most 1,000,000 control periods")?;
        let multiple = |a: f64, b: f64| a > 0.0 && b >= a && b / a <= 1e6 && (b / a - (b / a).round()).abs() <= 1e-6;
        require(
            self.time_step_s.is_none_or(|step_s| multiple(step_s, task.control_period_s)),
            "task.control_period_s must be an integer multiple of time_step_s",
        )?;
        require(self.quaternion_order == ORDER.0, "quaternion_order must be wxyz")?;
        require(self.image_origin == ORDER.1, "image_origin must be top_left")?;
        let cameras = &task.observation.cameras;
        let size = |n: usize| (1..=limits::PIXELS).contains(&n);
        require(cameras.len() <= limits::CAMERAS, "at most 16 cameras are allowed")?;
        let sizes = cameras.iter().all(|camera| size(camera.width) && size(camera.height));
        require(sizes, "the width and height of a camera must be 1 to 4096 pixels")?;
        require(task.parameters.len() <= limits::PARAMETERS, "at most 256 parameters are allowed")?;
        let lengths = task.observation.vectors.iter().all(|vector| vector.length <= limits::NUMBERS);
        require(lengths, "an observed vector may have at most 4096 numbers")?;
        let mut policies: Vec<&str> = self.policies.iter().map(|policy| &*policy.name).collect();
        let allowed = |c: char| c.is_ascii_alphanumeric() || matches!(c, '_' | '-' | '.');
        let named = |name: &&str| (1..=64).contains(&name.len()) && name.chars().all(allowed);
        require(policies.iter().all(named), "a policy's name must have 1 to 64 letters, digits, `_`, `-` and `.`")?;
        policies.sort_unstable();
        require(policies.windows(2).all(|pair| pair[0] != pair[1]), "two policies have the same name")?;
        self.check_names()?;
        self.check_space()?;
        require(
            self.scores_itself || self.is_physics(),
            "a server that does not score itself must accept joint_position only, with a gripper, observe \
             joint_positions, and have a constant time_step_s",
        )
    }

    /// Whether the declaration is that of a server that computes physics.
    fn is_physics(&self) -> bool {
        let joints = matches!(&self.task.action.spaces[..], [ActionSpace::JointPosition { .. }]);
        let observed = self.length(vectors::JOINT_POSITIONS.as_str()).is_some();
        joints && observed && self.task.action.gripper.is_some() && self.time_step_s.is_some()
    }

    fn length(&self, vector: &str) -> Option<usize> {
        let mut declared = self.task.observation.vectors.iter();
        declared.find(|spec| spec.name == vector).map(|spec| spec.length)
    }

    /// Check the vectors and actions with a fixed meaning.
    fn check_names(&self) -> Result<(), String> {
        let joints = self.task.action.joints().map(<[String]>::len);
        if joints.is_some_and(|joints| joints > limits::JOINTS) {
            return Err(format!("hello: joint_position has more than {} joints", limits::JOINTS));
        }
        let fixed = [
            (vectors::JOINT_POSITIONS, joints),
            (vectors::JOINT_VELOCITIES, joints),
            (vectors::TOOL_POSE, Some(7)),
            (vectors::GRIPPER_OPENING, Some(1)),
        ];
        for (name, expected) in fixed {
            if let (Some(found), Some(expected)) = (self.length(name.as_str()), expected)
                && found != expected
            {
                return Err(format!("hello: the vector {name} is declared with {found} numbers; expected {expected}"));
            }
        }
        Ok(())
    }

    /// Check that the server accepts all values of its space.
    fn check_space(&self) -> Result<(), String> {
        for parameter in self.space.iter().flat_map(ParameterSpace::parameters) {
            let Some(spec) = self.task.parameter(&parameter.name) else {
                return Err(format!("hello: space: the task declares no parameter `{}`", parameter.name));
            };
            let ends: Vec<Value> = match &parameter.domain {
                Domain::Continuous { low, high, .. } => [*low, *high].map(Value::Number).to_vec(),
                Domain::Integer { low, high } => [*low, *high].map(Value::Integer).to_vec(),
                Domain::Categorical { choices } => choices.iter().cloned().map(Value::Category).collect(),
            };
            ends.iter().try_for_each(|value| spec.accepts(value)).map_err(|why| format!("hello: space: {why}"))?;
        }
        Ok(())
    }
}
