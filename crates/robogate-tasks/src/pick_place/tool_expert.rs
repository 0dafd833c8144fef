//! An expert that moves the tool in small steps: the positive control for policies that command the tool.
//!
//! It follows the waypoints of the [scripted controller](super::Scripted), but plans no joint path: each step goes from
//! the observed pose towards the next waypoint. So it also works through an arm that lags behind its commands.

use std::f64::consts::PI;

use nalgebra::{Isometry3, Quaternion, Translation3, UnitQuaternion, Vector3};
use robogate_core::{Action, Command, Fault, FaultKind, Observation, Policy, Pose, Seed, TaskInstance, TaskSpec, Word};
use robogate_physics::{Gripper, Robot};

use super::Shape;
use super::scripted::{RELEASE_ROOM_M, TRANSIT_HEIGHT_M, grasp_height, grasp_offset};
use super::spec::{Briefing, phases};

/// Speed limit of the tool, in m/s. An arm under robosuite's `OSC_POSE` reaches 0.26 m/s.
const SPEED_M_S: f64 = 0.2;
/// Acceleration limit of the tool, in m/s².
const ACCELERATION_M_S2: f64 = 0.6;
/// Speed limit of rotations, in rad/s.
const TURN_RAD_S: f64 = 0.8;
/// A waypoint is reached within this distance, in metres ...
const POSITION_TOLERANCE_M: f64 = 0.004;
/// ... and this angle, in radians.
const ANGLE_TOLERANCE_RAD: f64 = 0.05;
/// The gripper is at rest if its opening changed by less than this in a control period, in metres ...
const GRIPPER_SETTLED_M: f64 = 1e-4;
/// ... for this many control periods.
const SETTLE_TICKS: usize = 4;
/// Number of control periods for which a gripper without fingers gets time to act.
const CUP_TICKS: usize = 12;

/// A waypoint of the tool.
#[derive(Debug, Clone)]
struct Waypoint {
    phase: Word,
    position: Vector3<f64>,
    /// Rotation of the tool about the vertical axis, or `None` to keep the present one.
    yaw: Option<f64>,
    closed: bool,
    /// Whether the gripper must be at rest before the next waypoint.
    settles: bool,
}

/// The expert.
#[derive(Debug, Clone)]
pub struct ToolExpert {
    robot: Robot,
    waypoints: Vec<Waypoint>,
    current: usize,
    period_s: f64,
    speed_m_s: f64,
    last_opening: Option<f64>,
    /// Number of control periods for which the gripper has been at rest.
    rest: usize,
    /// Number of control periods at the waypoint.
    there: usize,
    /// Yaws at which the gripper can grasp the object. The nearest to the first pose is used.
    yaws: Vec<f64>,
}

impl ToolExpert {
    /// Creates the expert for a robot.
    pub fn new(robot: Robot) -> Self {
        Self {
            robot,
            waypoints: Vec::new(),
            current: 0,
            period_s: 0.05,
            speed_m_s: 0.0,
            last_opening: None,
            rest: 0,
            there: 0,
            yaws: Vec::new(),
        }
    }

    fn plan(&self, task: &Briefing) -> Vec<Waypoint> {
        let [w, x, y, z] = task.object_pose.orientation;
        let object_yaw = UnitQuaternion::from_quaternion(Quaternion::new(w, x, y, z)).euler_angles().2;
        let offset = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), object_yaw) * grasp_offset(&self.robot, task);
        let [object, target] = [task.object_pose.position, task.target_pose.position]
            .map(|at| Vector3::new(at[0] + offset.x, at[1] + offset.y, 0.0));
        let grasp = grasp_height(&self.robot, &task.object_extent_m);
        let place = grasp + RELEASE_ROOM_M;
        let point = |phase, at: &Vector3<f64>, height, closed, settles| Waypoint {
            phase,
            position: Vector3::new(at.x, at.y, height),
            yaw: None,
            closed,
            settles,
        };
        vec![
            point(phases::APPROACH_ABOVE, &object, TRANSIT_HEIGHT_M, false, false),
            point(phases::DESCEND, &object, grasp, false, false),
            point(phases::GRASP, &object, grasp, true, true),
            point(phases::LIFT, &object, TRANSIT_HEIGHT_M, true, false),
            point(phases::MOVE_TO_TARGET, &target, TRANSIT_HEIGHT_M, true, false),
            point(phases::MOVE_TO_TARGET, &target, place, true, false),
            point(phases::RELEASE, &target, place, false, true),
            point(phases::RELEASE, &target, TRANSIT_HEIGHT_M, false, false),
        ]
    }

    /// Chooses the yaw of all waypoints once the first pose is known.
    fn choose_yaw(&mut self, tool: &Isometry3<f64>) {
        if self.waypoints.first().is_none_or(|waypoint| waypoint.yaw.is_some()) {
            return;
        }
        let x = tool.rotation * Vector3::x();
        let now = x.y.atan2(x.x);
        let off = |yaw: f64| (yaw - now).sin().atan2((yaw - now).cos());
        let yaw = self.yaws.iter().copied().min_by(|a, b| off(*a).abs().total_cmp(&off(*b).abs())).unwrap_or(now);
        self.waypoints.iter_mut().for_each(|waypoint| waypoint.yaw = Some(yaw));
    }

    /// Whether the gripper has been at rest for long enough at the waypoint.
    fn settled(&self) -> bool {
        let ticks = if self.last_opening.is_some() { SETTLE_TICKS } else { CUP_TICKS };
        self.rest.min(self.there) > ticks
    }
}

fn isometry(pose: &Pose) -> Isometry3<f64> {
    let ([x, y, z], [w, i, j, k]) = (pose.position, pose.orientation);
    let rotation = UnitQuaternion::from_quaternion(Quaternion::new(w, i, j, k));
    Isometry3::from_parts(Translation3::new(x, y, z), rotation)
}

impl Policy for ToolExpert {
    fn check(&self, task: &TaskSpec) -> Result<(), String> {
        if task.name == super::NAME && task.action.tool_delta().is_some() {
            return Ok(());
        }
        Err(format!("the expert drives the tool in pick_place, not in {}", task.name))
    }

    fn reset(&mut self, task: &TaskSpec, instance: &TaskInstance, _: Seed) -> Result<(), Fault> {
        let briefing = Briefing::of(instance)?;
        self.waypoints = self.plan(&briefing);
        let [w, x, y, z] = briefing.object_pose.orientation;
        let yaw = UnitQuaternion::from_quaternion(Quaternion::new(w, x, y, z)).euler_angles().2;
        self.yaws = match self.robot.settings.gripper {
            Gripper::ParallelJaw(_) => {
                let symmetry = Shape::from_name(&briefing.shape).map_or(PI, Shape::grasp_symmetry);
                let count = (2.0 * PI / symmetry).round() as usize;
                (0..count).map(|k| yaw + k as f64 * symmetry).collect()
            }
            Gripper::Suction(_) => Vec::new(),
        };
        self.period_s = task.control_period_s;
        (self.current, self.speed_m_s, self.last_opening, self.rest, self.there) = (0, 0.0, None, 0, 0);
        Ok(())
    }

    fn act(&mut self, observation: &Observation) -> Result<Action, Fault> {
        let pose = observation.tool_pose().ok_or_else(|| {
            Fault::new(FaultKind::Setup, "the expert needs the pose of the tool, but the observation has none")
        })?;
        let tool = isometry(&pose);
        self.choose_yaw(&tool);
        let opening = observation.gripper_opening_m();
        let still = match (self.last_opening, opening) {
            (Some(before), Some(now)) => (before - now).abs() < GRIPPER_SETTLED_M,
            _ => true,
        };
        self.rest = if still { self.rest + 1 } else { 0 };
        self.last_opening = opening;
        let off = |waypoint: &Waypoint| {
            let down = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), PI);
            let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), waypoint.yaw.unwrap_or_default()) * down;
            (waypoint.position - tool.translation.vector, (turn * tool.rotation.inverse()).scaled_axis())
        };
        let (mut translation, mut rotation) = off(&self.waypoints[self.current]);
        if translation.norm() <= POSITION_TOLERANCE_M && rotation.norm() <= ANGLE_TOLERANCE_RAD {
            self.there += 1;
            let settles = self.waypoints[self.current].settles;
            if (!settles || self.settled()) && self.current + 1 < self.waypoints.len() {
                self.current += 1;
                (self.there, self.speed_m_s) = (0, 0.0);
                (translation, rotation) = off(&self.waypoints[self.current]);
            }
        }
        let waypoint = &self.waypoints[self.current];
        let (distance, angle) = (translation.norm(), rotation.norm());
        // Speed up to the limit, and slow down before the waypoint.
        let limit = SPEED_M_S.min((2.0 * ACCELERATION_M_S2 * distance).sqrt());
        self.speed_m_s = limit.min(self.speed_m_s + ACCELERATION_M_S2 * self.period_s);
        let share = |length: f64, step: f64| if length > 1e-9 { (step / length).min(0.7) } else { 0.0 };
        let move_by = translation * share(distance, self.speed_m_s * self.period_s);
        let turn_by = rotation * share(angle, TURN_RAD_S * self.period_s);
        Ok(Action {
            command: Command::ToolDelta { translation_m: move_by.into(), rotation_rad: turn_by.into() },
            gripper: Some(if waypoint.closed { Action::CLOSE } else { Action::OPEN }),
            phase: Some(waypoint.phase),
        })
    }
}
