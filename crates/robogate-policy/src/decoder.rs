//! Executes the raw actions of a model: scales, frames, arm modes and control rate.

use robogate_core::{Action, Command, Observation, Pose, TaskSpec};

use super::error::PolicyError;
use super::osc::Osc;
use super::profile::{ActionForm, Arm, Frame, Profile, Rotation, Side, Tool};
use super::query;
use super::rotation;

/// Distance between the last commanded and the measured position beyond which an absolute pose is approached from the
/// measured one, in metres. The steering of the arm does the same.
const LEAD_M: f64 = 0.04;

/// How the numbers of an action reach the task.
#[derive(Debug, Clone, PartialEq)]
enum Target {
    /// As motions of the tool, joint positions or vectors, as the profile says.
    Profile,
    /// As the normalised action of an environment with robosuite's `OSC_POSE` controller.
    Robosuite,
}

/// Converts the raw actions of a model to actions of the robot, one for each control period.
#[derive(Debug, Clone)]
pub struct Decoder {
    pub(crate) form: ActionForm,
    pub(crate) tool: Tool,
    profile: Profile,
    pub(crate) osc: Osc,
    pub(crate) period_s: f64,
    /// Number of control periods for each action.
    pub(crate) periods: u32,
    /// Control periods left for the present action.
    left: u32,
    raw: Vec<f64>,
    target: Target,
    /// Bounds of each element of a vector action. Empty for other actions.
    bounds: Vec<(f64, f64)>,
    /// The last commanded pose, for absolute poses.
    commanded: Option<Pose>,
}

/// A raw action that has the right size.
#[derive(Debug, Clone, Copy)]
struct Parts<'a> {
    arm: &'a [f64],
    gripper: f64,
}

impl Decoder {
    /// A decoder for the actions of this profile.
    pub fn new(profile: &Profile) -> Self {
        Self {
            form: profile.action.clone(),
            tool: profile.tool.clone(),
            profile: profile.clone(),
            osc: Osc::default(),
            period_s: 0.05,
            periods: 1,
            left: 0,
            raw: Vec::new(),
            target: Target::Profile,
            bounds: Vec::new(),
            commanded: None,
        }
    }

    /// Begins an episode of this task.
    ///
    /// # Errors
    /// If the control rate of the profile does not fit the task.
    pub fn begin(&mut self, task: &TaskSpec) -> Result<(), PolicyError> {
        self.period_s = task.control_period_s;
        self.periods = self.form.periods(task.control_period_s).map_err(PolicyError::Mismatch)?;
        let bounds = task.action.vector().map(|(low, high)| low.iter().copied().zip(high.iter().copied()).collect());
        self.bounds = bounds.unwrap_or_default();
        self.target =
            if is_robosuite(task) && self.form.arm == Arm::OscPose { Target::Robosuite } else { Target::Profile };
        (self.left, self.osc, self.commanded) = (0, Osc::default(), None);
        self.raw.clear();
        Ok(())
    }

    /// Whether the next action needs new numbers of the model.
    pub fn is_empty(&self) -> bool {
        self.left == 0
    }

    /// Takes the next raw action of the model. The numbers must be finite, and their count must be
    /// [`ActionForm::size`].
    pub fn put(&mut self, raw: Vec<f64>) {
        self.raw = raw;
        self.left = self.periods;
    }

    /// The action for the next control period.
    ///
    /// # Errors
    /// If the numbers do not fit the robot.
    pub fn next(&mut self, observation: &Observation) -> Result<Action, PolicyError> {
        let first = self.left == self.periods;
        self.left = self.left.saturating_sub(1);
        let raw = std::mem::take(&mut self.raw);
        let action = self.action(&raw, first, observation);
        self.raw = raw;
        action
    }

    fn action(&mut self, raw: &[f64], first: bool, observation: &Observation) -> Result<Action, PolicyError> {
        let raw = raw.get(..self.form.used()).unwrap_or(raw);
        if self.form.arm == Arm::Vector {
            // Networks overshoot the bounds slightly, and the task would reject such an action.
            let clamped = raw.iter().zip(self.bounds.iter().map(Some).chain(std::iter::repeat(None)));
            let numbers = clamped.map(|(n, bounds)| bounds.map_or(*n, |(low, high)| n.clamp(*low, *high))).collect();
            return Ok(Action { command: Command::Vector(numbers), gripper: None, phase: None });
        }
        let Some((gripper, arm)) = raw.split_last() else {
            return Err(PolicyError::Shape("the action has no numbers".to_owned()));
        };
        let parts = Parts { arm, gripper: *gripper };
        let gripper = self.gripper(parts.gripper)?;
        if self.target == Target::Robosuite {
            return self.robosuite(parts, gripper);
        }
        let command = match self.form.arm {
            Arm::ToolDelta | Arm::OscPose => self.tool_motion(parts, first, observation)?,
            Arm::ToolPose => self.tool_pose(parts, observation)?,
            Arm::JointPositions | Arm::JointDeltas | Arm::Vector => self.joints(parts, observation)?,
        };
        Ok(Action { command, gripper: Some(gripper), phase: None })
    }

    /// The gripper command of the robot for that of the model.
    fn gripper(&self, number: f64) -> Result<f64, PolicyError> {
        let (Some(threshold), Some(side)) = (self.form.gripper_threshold, self.form.gripper_open) else {
            let why = "the profile lacks action.gripper_threshold or action.gripper_open";
            return Err(PolicyError::Shape(why.to_owned()));
        };
        let open = match side {
            Side::Above => number > threshold,
            Side::Below => number < threshold,
        };
        Ok(if open { Action::OPEN } else { Action::CLOSE })
    }

    /// The translation and the rotation that an action commands, in metres and radians in the frame of the profile.
    pub(crate) fn scaled(&self, arm: &[f64]) -> Result<([f64; 3], [f64; 3]), PolicyError> {
        let form = &self.form;
        let clip = |n: f64| form.clip.map_or(n, |limit| n.clamp(-limit, limit));
        let [x, y, z, turn @ ..] = arm else {
            let (needed, got) = (3 + form.rotation.size(), arm.len());
            return Err(PolicyError::Shape(format!(
                "a motion of the tool needs {needed} numbers for the arm, got {got}"
            )));
        };
        let rotation_rad = match (form.rotation, turn) {
            (Rotation::AxisAngle, [a, b, c]) => [*a, *b, *c].map(|n| clip(n) * form.rotation_scale_rad),
            (Rotation::Euler, [a, b, c]) => {
                rotation::euler_to_vector([*a, *b, *c].map(|n| clip(n) * form.rotation_scale_rad))
            }
            (kind, numbers) => self.read_rotation(kind, numbers).map(rotation::shortest)?,
        };
        Ok(([*x, *y, *z].map(|n| clip(n) * form.position_scale_m), rotation_rad))
    }

    fn read_rotation(&self, kind: Rotation, numbers: &[f64]) -> Result<[f64; 4], PolicyError> {
        rotation::read(kind, numbers).ok_or_else(|| {
            PolicyError::Shape(format!(
                "the numbers {numbers:?} are not a rotation. Expected {} numbers: {kind:?}",
                kind.size()
            ))
        })
    }

    /// A motion of the tool, spread over the control periods of the action.
    fn tool_motion(
        &mut self,
        parts: Parts<'_>,
        first: bool,
        observation: &Observation,
    ) -> Result<Command, PolicyError> {
        let (mut translation_m, mut rotation_rad) = self.scaled(parts.arm)?;
        if self.form.frame == Frame::Tool {
            let frame = self.frame(observation)?;
            translation_m = rotation::rotate(frame, translation_m);
            rotation_rad = rotation::rotate(frame, rotation_rad);
        }
        if self.form.arm == Arm::OscPose {
            if first {
                self.osc.set_goal(translation_m, rotation_rad);
            }
            (translation_m, rotation_rad) = self.osc.advance(self.period_s);
        } else {
            let share = 1.0 / f64::from(self.periods);
            (translation_m, rotation_rad) = (translation_m.map(|n| n * share), rotation_rad.map(|n| n * share));
        }
        Ok(Command::ToolDelta { translation_m, rotation_rad })
    }

    /// Orientation of the model's tool frame in the base frame of the cell.
    pub(crate) fn frame(&self, observation: &Observation) -> Result<[f64; 4], PolicyError> {
        let pose = query::tool_pose(&self.profile, observation);
        pose.map(|pose| pose.orientation).ok_or_else(|| {
            PolicyError::Observation("the profile requires the pose of the tool, but it is not observed".to_owned())
        })
    }

    /// An absolute pose, as a motion from the last commanded one.
    fn tool_pose(&mut self, parts: Parts<'_>, observation: &Observation) -> Result<Command, PolicyError> {
        let [x, y, z, turn @ ..] = parts.arm else {
            return Err(PolicyError::Shape("a pose of the tool needs three numbers for the position".to_owned()));
        };
        let orientation = self.read_rotation(self.form.rotation, turn)?;
        let pose = Pose { position: [*x, *y, *z].map(|n| n * self.form.position_scale_m), orientation };
        let goal = rotation::cell_pose(&pose, self.tool.shift_m, self.tool.turn_rad);
        let from = self.start(observation)?;
        self.commanded = Some(goal);
        let mut translation_m = goal.position;
        translation_m.iter_mut().zip(from.position).for_each(|(to, from)| *to -= from);
        let turn = rotation::product(goal.orientation, rotation::inverse(from.orientation));
        Ok(Command::ToolDelta { translation_m, rotation_rad: rotation::shortest(turn) })
    }

    /// The pose from which an absolute pose is approached: the last commanded one, or the measured one if the tool is
    /// far from it.
    pub(crate) fn start(&self, observation: &Observation) -> Result<Pose, PolicyError> {
        let measured = observation.tool_pose().ok_or_else(|| {
            PolicyError::Observation("the profile requires the pose of the tool, but it is not observed".to_owned())
        })?;
        let far = |a: &Pose| a.position.iter().zip(measured.position).map(|(a, b)| (a - b).powi(2)).sum::<f64>();
        Ok(self.commanded.filter(|last| far(last) <= LEAD_M * LEAD_M).unwrap_or(measured))
    }

    /// Positions of the joints.
    fn joints(&self, parts: Parts<'_>, observation: &Observation) -> Result<Command, PolicyError> {
        let joints = observation.joint_positions();
        let arm = parts.arm;
        if arm.len() != joints.len() {
            let (got, expected) = (arm.len(), joints.len());
            return Err(PolicyError::Shape(format!("the action is for {got} joints, but the arm has {expected}")));
        }
        if self.form.arm == Arm::JointPositions {
            let unit = self.tool.joint_unit_rad.unwrap_or(1.0);
            return Ok(Command::JointPosition(arm.iter().map(|n| n * unit).collect()));
        }
        let clip = |n: f64| self.form.clip.map_or(n, |limit| n.clamp(-limit, limit));
        let share = self.form.rotation_scale_rad / f64::from(self.periods);
        Ok(Command::JointPosition(joints.iter().zip(arm).map(|(q, n)| q + clip(*n) * share).collect()))
    }

    /// The action of an environment with robosuite's controller, in which 1 is 0.05 m or 0.5 rad.
    fn robosuite(&self, parts: Parts<'_>, gripper: f64) -> Result<Action, PolicyError> {
        let (translation_m, rotation_rad) = self.scaled(parts.arm)?;
        let (metres, radians) = ROBOSUITE_UNIT;
        let numbers = translation_m.map(|n| n / metres).into_iter().chain(rotation_rad.map(|n| n / radians));
        let numbers = numbers.map(|n| n.clamp(-1.0, 1.0)).chain([gripper]).collect();
        Ok(Action { command: Command::Vector(numbers), gripper: None, phase: None })
    }
}

/// Motion for an action of 1 of robosuite's `OSC_POSE`, in metres and radians.
pub(crate) const ROBOSUITE_UNIT: (f64, f64) = (0.05, 0.5);

/// Whether the actions of the task are those of robosuite's `OSC_POSE` with a gripper: seven numbers from -1 to 1.
pub(crate) fn is_robosuite(task: &TaskSpec) -> bool {
    let unit = |bounds: &[f64], value: f64| bounds.iter().all(|n| (n - value).abs() < 1e-9);
    task.action.vector().is_some_and(|(low, high)| low.len() == 7 && unit(low, -1.0) && unit(high, 1.0))
        && task.observation.vectors.iter().any(|vector| vector.name == "eef_axis_angle")
}
