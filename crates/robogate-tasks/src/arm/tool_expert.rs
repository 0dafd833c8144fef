//! An expert that moves the tool in small steps: the positive control for policies that command the tool.
//!
//! It follows the waypoints of a task, but plans no joint path: each step goes from the observed pose towards the next
//! waypoint. So it also works through an arm that lags behind its commands.

use std::f64::consts::{FRAC_PI_2, PI};
use std::sync::Arc;

use nalgebra::{Isometry3, UnitQuaternion, Vector3};
use robogate_core::{Action, Command, Fault, FaultKind, Observation, Policy, Seed, TaskInstance, TaskSpec, Word};
use robogate_physics::{Gripper, Robot, isometry};

use super::tool_down;

/// Acceleration limit of the tool, in m/s².
const ACCELERATION_M_S2: f64 = 0.6;
/// Speed limit of rotations, in rad/s.
const TURN_RAD_S: f64 = 0.8;
/// The gripper is at rest if its opening changed by less than this in a control period, in metres ...
const GRIPPER_SETTLED_M: f64 = 1e-4;
/// ... for this many control periods.
const SETTLE_TICKS: usize = 4;
/// Number of control periods for which a gripper without fingers gets time to act.
const CUP_TICKS: usize = 12;

/// How the tool goes to a waypoint.
#[derive(Debug)]
pub(crate) struct Pace {
    /// Speed limit, in m/s. An arm under robosuite's `OSC_POSE` reaches 0.26 m/s.
    speed_m_s: f64,
    /// Largest part of the remaining way in one step.
    share: f64,
    /// The waypoint is reached within this distance, in metres ...
    within_m: f64,
    /// ... and this angle, in radians.
    within_rad: f64,
}

/// Through free space.
pub(crate) static FREELY: Pace = Pace { speed_m_s: 0.2, share: 0.7, within_m: 0.004, within_rad: 0.05 };
/// To a place that the part must fit.
pub(crate) static FINELY: Pace = Pace { speed_m_s: 0.03, share: 0.35, within_m: 5e-4, within_rad: 0.01 };

/// A waypoint of the tool, which points down.
#[derive(Debug, Clone)]
pub(crate) struct Waypoint {
    pub(crate) phase: Word,
    /// Position of the tool, in metres.
    pub(crate) at: [f64; 3],
    pub(crate) pace: &'static Pace,
    pub(crate) closed: bool,
    /// Whether the gripper must be at rest before the next waypoint.
    pub(crate) settles: bool,
}

/// The way of the tool in an episode.
#[derive(Debug, Clone, Default)]
pub(crate) struct Way {
    pub(crate) points: Vec<Waypoint>,
    /// Yaws at which the gripper can grasp the part. The nearest to the first pose is used; without one, the tool does not
    /// turn.
    pub(crate) yaws: Vec<f64>,
}

impl Way {
    /// A way that begins nowhere. Fingers grasp a part at `yaw` and after each turn by `symmetry`, both in radians.
    pub(crate) fn new(gripper: &Gripper, yaw: f64, symmetry: f64) -> Self {
        let count = (2.0 * PI / symmetry).round() as usize;
        let yaws = match gripper {
            Gripper::ParallelJaw(_) => (0..count).map(|k| yaw + k as f64 * symmetry).collect(),
            Gripper::Suction(_) => Vec::new(),
        };
        Self { points: Vec::new(), yaws }
    }

    /// As [`Self::new`], for a square part without a yaw.
    pub(crate) fn for_square(gripper: &Gripper) -> Self {
        Self::new(gripper, 0.0, FRAC_PI_2)
    }

    /// Appends a motion to a position (m) with the gripper open or closed.
    pub(crate) fn go(&mut self, phase: Word, at: [f64; 3], pace: &'static Pace, closed: bool) {
        self.points.push(Waypoint { phase, at, pace, closed, settles: false });
    }

    /// Appends a wait at the last position until the gripper has opened or closed.
    pub(crate) fn grip(&mut self, phase: Word, closed: bool) {
        if let Some(Waypoint { at, pace, .. }) = self.points.last().cloned() {
            self.points.push(Waypoint { phase, at, pace, closed, settles: true });
        }
    }
}

/// The way of the tool in an episode of a task.
pub(crate) type WayOf = Arc<dyn Fn(&Robot, &TaskInstance) -> Result<Way, Fault> + Send + Sync>;

/// The expert.
#[derive(Clone)]
pub(crate) struct ToolExpert {
    /// The task that it drives.
    task: &'static str,
    way_of: WayOf,
    robot: Robot,
    way: Way,
    /// Yaw of the tool in all waypoints, once the first pose is known.
    yaw: Option<f64>,
    current: usize,
    period_s: f64,
    speed_m_s: f64,
    last_opening: Option<f64>,
    /// Number of control periods for which the gripper has been at rest.
    rest: usize,
    /// Number of control periods at the waypoint.
    there: usize,
}

impl ToolExpert {
    /// Creates the expert of the task `task` for a robot.
    pub(crate) fn new(task: &'static str, way_of: WayOf, robot: Robot) -> Self {
        Self {
            task,
            way_of,
            robot,
            way: Way::default(),
            yaw: None,
            current: 0,
            period_s: 0.05,
            speed_m_s: 0.0,
            last_opening: None,
            rest: 0,
            there: 0,
        }
    }

    /// The yaw of all waypoints, with the tool at this pose in the beginning.
    fn choose_yaw(&self, tool: &Isometry3<f64>) -> f64 {
        let x = tool.rotation * Vector3::x();
        let now = x.y.atan2(x.x);
        let off = |yaw: f64| (yaw - now).sin().atan2((yaw - now).cos());
        self.way.yaws.iter().copied().min_by(|a, b| off(*a).abs().total_cmp(&off(*b).abs())).unwrap_or(now)
    }

    /// Whether the gripper has been at rest for long enough at the waypoint.
    fn settled(&self) -> bool {
        let ticks = if self.last_opening.is_some() { SETTLE_TICKS } else { CUP_TICKS };
        self.rest.min(self.there) > ticks
    }
}

impl Policy for ToolExpert {
    fn check(&self, task: &TaskSpec) -> Result<(), String> {
        if task.name == *self.task && task.action.tool_delta().is_some() {
            return Ok(());
        }
        Err(format!("the expert drives the tool in {}, not in {}", self.task, task.name))
    }

    fn reset(&mut self, task: &TaskSpec, instance: &TaskInstance, _: Seed) -> Result<(), Fault> {
        let way = (self.way_of)(&self.robot, instance)?;
        *self = Self {
            way,
            period_s: task.control_period_s,
            ..Self::new(self.task, Arc::clone(&self.way_of), self.robot.clone())
        };
        Ok(())
    }

    fn act(&mut self, observation: &Observation) -> Result<Action, Fault> {
        let pose = observation.tool_pose().ok_or_else(|| {
            Fault::new(FaultKind::Setup, "the expert needs the pose of the tool, but the observation has none")
        })?;
        let tool = isometry(&pose.position, &pose.orientation);
        let yaw = self.yaw.unwrap_or_else(|| self.choose_yaw(&tool));
        self.yaw = Some(yaw);
        let opening = observation.gripper_opening_m();
        let still = match (self.last_opening, opening) {
            (Some(before), Some(now)) => (before - now).abs() < GRIPPER_SETTLED_M,
            _ => true,
        };
        self.rest = if still { self.rest + 1 } else { 0 };
        self.last_opening = opening;
        let off = |waypoint: &Waypoint| {
            let goal = tool_down(waypoint.at, yaw);
            let turn: UnitQuaternion<f64> = goal.rotation * tool.rotation.inverse();
            (goal.translation.vector - tool.translation.vector, turn.scaled_axis())
        };
        let Some(waypoint) = self.way.points.get(self.current) else {
            return Err(Fault::new(FaultKind::Setup, "the expert has no waypoints"));
        };
        let (mut translation, mut rotation) = off(waypoint);
        if translation.norm() <= waypoint.pace.within_m && rotation.norm() <= waypoint.pace.within_rad {
            self.there += 1;
            if (!waypoint.settles || self.settled()) && self.current + 1 < self.way.points.len() {
                self.current += 1;
                (self.there, self.speed_m_s) = (0, 0.0);
                (translation, rotation) = off(&self.way.points[self.current]);
            }
        }
        let Waypoint { pace, closed, phase, .. } = self.way.points[self.current];
        let (distance, angle) = (translation.norm(), rotation.norm());
        // Speed up to the limit, and slow down before the waypoint.
        let limit = pace.speed_m_s.min((2.0 * ACCELERATION_M_S2 * distance).sqrt());
        self.speed_m_s = limit.min(self.speed_m_s + ACCELERATION_M_S2 * self.period_s);
        let share = |length: f64, step: f64| if length > 1e-9 { (step / length).min(pace.share) } else { 0.0 };
        let move_by = translation * share(distance, self.speed_m_s * self.period_s);
        let turn_by = rotation * share(angle, TURN_RAD_S * self.period_s);
        Ok(Action {
            command: Command::ToolDelta { translation_m: move_by.into(), rotation_rad: turn_by.into() },
            gripper: Some(if closed { Action::CLOSE } else { Action::OPEN }),
            phase: Some(phase),
        })
    }
}
