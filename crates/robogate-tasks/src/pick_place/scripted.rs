//! The scripted controller: the paper's baseline (section 4.1).
//!
//! Six phases are planned at the start from nominal data: the object's pose and dimensions, the target and the robot. A
//! phase ends when its path has been commanded, the measured tool pose is within 5 mm and 0.05 rad of the end, and the
//! gripper is at rest if it moves in this phase. The encoders' bias and the true pose of the object are unknown to the
//! controller.
//!
//! A tool that is pushed more than 10 mm off its path stops there and waits, like a robot with a contact guard. The
//! controller has then given up. It also gives up at the end of its plan.

use std::f64::consts::PI;

use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};
use robogate_core::{Action, Command, Fault, Observation, Policy, Seed, TaskInstance, TaskSpec, Word};
use robogate_physics::trajectory::{ToolLimit, joint_path, straight_path};
use robogate_physics::{Chain, Gripper, GripperCommand, Robot, Unreachable};

use super::Shape;
use super::cell::CONTROL_PERIOD_S;
use super::spec::{Briefing, phases};

/// A phase ends within this distance of its goal, in metres ...
const POSITION_TOLERANCE_M: f64 = 0.005;
/// ... and this angle, in radians (paper, section 4.1).
const ANGLE_TOLERANCE_RAD: f64 = 0.05;
/// The tool stops if it is off its path by more than this, in metres.
const GUARD_M: f64 = 0.01;
/// Height of the tool above the table on transit paths, in metres: the carried object passes over the highest obstacle.
pub(super) const TRANSIT_HEIGHT_M: f64 = 0.25;
/// Gap between fingertips and table in the grasp, in metres.
const TIP_ROOM_M: f64 = 0.004;
/// Gap between palm and object in the grasp, in metres.
const PALM_ROOM_M: f64 = 0.002;
/// Gap between a cup and the top of the object, in metres. It is well below the grip threshold.
const CUP_ROOM_M: f64 = 0.002;
/// Height of the object above the table at its release, in metres.
pub(super) const RELEASE_ROOM_M: f64 = 0.003;
/// The gripper is at rest if its opening changed by less than this in a control period, in metres.
const GRIPPER_SETTLED_M: f64 = 1e-4;
/// ... for this many control periods: it needs time to start and to build up its force.
const SETTLE_TICKS: usize = 4;
/// The controller gives up this many control periods after the end of its plan.
const IDLE_TICKS: usize = 10;
/// Limits of free motion.
const FREE: ToolLimit = ToolLimit { speed: 0.5, acceleration: 2.0 };
/// Limits of motion with the object in hand. They are low, so that weight and not acceleration decides whether it
/// slips.
const CARRY: ToolLimit = ToolLimit { speed: 0.6, acceleration: CARRY_ACCELERATION_M_S2 };
/// Largest acceleration of the tool with the object in hand.
pub(super) const CARRY_ACCELERATION_M_S2: f64 = 1.2;

/// The scripted controller.
#[derive(Debug, Clone)]
pub struct Scripted {
    robot: Robot,
    chain: Chain,
    /// The plan of the running episode, phase by phase.
    plan: Vec<Stage>,
    current: usize,
    tick: usize,
    last_opening: Option<f64>,
    /// The last two commands, the older one first.
    commanded: Option<[Vec<f64>; 2]>,
    /// Joint positions at which the guard stopped the arm.
    stopped: Option<Vec<f64>>,
    /// Number of control periods for which the gripper has been at rest.
    rest: usize,
}

/// One phase of a plan.
#[derive(Debug, Clone)]
struct Stage {
    phase: Word,
    /// Joint positions for every control period. The last one is kept until the phase ends.
    path: Vec<Vec<f64>>,
    gripper: GripperCommand,
    /// Whether the gripper must be at rest for the phase to end.
    settles: bool,
}

impl Scripted {
    /// Creates the controller for a robot with these kinematics.
    pub fn new(robot: Robot, chain: Chain) -> Self {
        Self {
            robot,
            chain,
            plan: Vec::new(),
            current: 0,
            tick: 0,
            last_opening: None,
            commanded: None,
            stopped: None,
            rest: 0,
        }
    }

    /// The tool pose above `at`, pointing down. The fingers close along the direction `yaw` + 90 degrees.
    fn above(at: &[f64; 3], height: f64, yaw: f64) -> Isometry3<f64> {
        let down = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), PI);
        let rotation = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), yaw);
        Isometry3::from_parts(Translation3::new(at[0], at[1], height), rotation * down)
    }

    /// Candidate yaws of the tool for an object with this `yaw`. For fingers these are the symmetric yaws of the
    /// object. A cup is symmetric in all yaws: its yaw follows the arm's base, which keeps the wrist posture.
    fn grasp_yaws(&self, task: &Briefing, at: &[f64; 3], yaw: f64) -> Vec<f64> {
        let home = &self.robot.settings.arm.home_rad;
        match &self.robot.settings.gripper {
            Gripper::ParallelJaw(_) => {
                let symmetry = Shape::from_name(&task.shape).map_or(PI, Shape::grasp_symmetry);
                let count = (2.0 * PI / symmetry).round() as usize;
                (0..count).map(|k| yaw + k as f64 * symmetry).collect()
            }
            Gripper::Suction(_) => {
                let x = self.chain.tcp_at(home).rotation * Vector3::x();
                vec![self.carry_yaw(home, x.y.atan2(x.x), at)]
            }
        }
    }

    /// The grasp yaw with the smallest joint motion from home, and the joint positions above the object with this yaw.
    fn choose_grasp(&self, task: &Briefing, at: &[f64; 3], yaw: f64) -> Result<(f64, Vec<f64>), Unreachable> {
        let home = &self.robot.settings.arm.home_rad;
        let mut best: Option<(f64, f64, Vec<f64>)> = None;
        let mut failure = None;
        for yaw in self.grasp_yaws(task, at, yaw) {
            let goal = Self::above(at, TRANSIT_HEIGHT_M, yaw);
            match self.chain.reach(&goal, home) {
                Ok(q) => {
                    let bend = q.iter().zip(home).map(|(q, home)| (q - home).abs()).fold(0.0, f64::max);
                    if best.as_ref().is_none_or(|(least, ..)| bend < *least) {
                        best = Some((bend, yaw, q));
                    }
                }
                Err(unreachable) => failure = Some(unreachable),
            }
        }
        match (best, failure) {
            (Some((_, yaw, q)), _) => Ok((yaw, q)),
            (None, Some(unreachable)) => Err(unreachable),
            (None, None) => unreachable!("an object has at least one grasp yaw"),
        }
    }

    /// The grasp offset in the base frame, for an object with this yaw.
    fn rotated_offset(&self, task: &Briefing, yaw: f64) -> Vector3<f64> {
        UnitQuaternion::from_axis_angle(&Vector3::z_axis(), yaw) * grasp_offset(&self.robot, task)
    }

    /// Joint positions of the planned grasp, without the path to it.
    pub(super) fn planned_grasp(&self, task: &Briefing) -> Result<Vec<f64>, Unreachable> {
        let yaw = yaw_of(task);
        let object = &offset_by(&task.object_pose.position, self.rotated_offset(task, yaw));
        let (yaw, above) = self.choose_grasp(task, object, yaw)?;
        let goal = Self::above(object, grasp_height(&self.robot, &task.object_extent_m), yaw);
        self.chain.inverse(&goal, &above, &self.robot.settings.arm.home_rad)
    }

    fn plan(&self, task: &Briefing) -> Result<Vec<Stage>, (Vec<Stage>, Unreachable)> {
        let mut plan = Vec::new();
        match self.fill(task, &mut plan) {
            Ok(()) => Ok(plan),
            Err(unreachable) => Err((plan, unreachable)),
        }
    }

    fn fill(&self, task: &Briefing, plan: &mut Vec<Stage>) -> Result<(), Unreachable> {
        use GripperCommand::{Close, Open};
        let arm = &self.robot.settings.arm;
        let (home, period) = (&arm.home_rad, CONTROL_PERIOD_S);
        let straight = |from: &[f64], to, limit| straight_path(&self.chain, from, &to, home, arm, limit, period);
        let stage = |phase, path, gripper, settles| Stage { phase, path, gripper, settles };

        let object_yaw = yaw_of(task);
        let rotated = |yaw| self.rotated_offset(task, yaw);
        let object = &offset_by(&task.object_pose.position, rotated(object_yaw));
        let (yaw, above) = self.choose_grasp(task, object, object_yaw)?;
        plan.push(stage(phases::APPROACH_ABOVE, joint_path(home, &above, arm, period), Open, false));

        let height = grasp_height(&self.robot, &task.object_extent_m);
        let speed = task.approach_speed_m_s.unwrap_or(FREE.speed);
        let path = straight(&above, Self::above(object, height, yaw), ToolLimit { speed, ..FREE })?;
        let down = end_of(&path, &above);
        plan.push(stage(phases::DESCEND, path, Open, false));
        plan.push(stage(phases::GRASP, vec![down.clone()], Close, true));

        let path = straight(&down, Self::above(object, TRANSIT_HEIGHT_M, yaw), CARRY)?;
        let up = end_of(&path, &down);
        plan.push(stage(phases::LIFT, path, Close, false));

        // Across to the target, with the smallest rotation of the tool.
        let goal = &task.target_pose.position;
        let mut placed = self.carry_yaw(&up, yaw, goal);
        if task.orientation_tolerance_rad.is_some() {
            placed = aligned(placed, yaw - object_yaw, Shape::from_name(&task.shape));
        }
        let target = &offset_by(goal, rotated(object_yaw + placed - yaw));
        let yaw = placed;
        let mut path = straight(&up, Self::above(target, TRANSIT_HEIGHT_M, yaw), CARRY)?;
        let across = end_of(&path, &up);
        let place = height + RELEASE_ROOM_M;
        let lowered = straight(&across, Self::above(target, place, yaw), CARRY)?;
        let lowered_end = end_of(&lowered, &across);
        path.extend(lowered);
        plan.push(stage(phases::MOVE_TO_TARGET, path, Close, false));

        plan.push(stage(phases::RELEASE, vec![lowered_end.clone()], Open, true));
        let away = straight(&lowered_end, Self::above(target, TRANSIT_HEIGHT_M, yaw), FREE)?;
        plan.push(stage(phases::RELEASE, away, Open, false));
        Ok(())
    }

    /// Whether the tool is off its commanded path. The servo lags the commands by half a control period, so the tool
    /// should be halfway between the last two.
    fn pushed_off(&self, measured: &[f64]) -> bool {
        let Some([before, last]) = &self.commanded else { return false };
        let middle: Vec<f64> = before.iter().zip(last).map(|(a, b)| 0.5 * (a + b)).collect();
        let off = self.chain.tcp_at(&middle).translation.vector - self.chain.tcp_at(measured).translation.vector;
        off.norm() > GUARD_M
    }

    /// Yaw of the tool at the target. It follows the arm's base, which keeps the wrist posture.
    fn carry_yaw(&self, joints: &[f64], yaw: f64, target: &[f64; 3]) -> f64 {
        let from = self.chain.tcp_at(joints).translation.vector;
        yaw + target[1].atan2(target[0]) - from.y.atan2(from.x)
    }
}

/// The object's yaw, in radians.
fn yaw_of(task: &Briefing) -> f64 {
    let [w, x, y, z] = task.object_pose.orientation;
    UnitQuaternion::from_quaternion(nalgebra::Quaternion::new(w, x, y, z)).euler_angles().2
}

/// A point moved horizontally.
fn offset_by(centre: &[f64; 3], offset: Vector3<f64>) -> [f64; 3] {
    [centre[0] + offset.x, centre[1] + offset.y, centre[2]]
}

/// Height of the tool centre point above the table during the grasp, in metres. For fingers it is the object's centre,
/// but high enough to keep the fingertips off the table and the palm off the object. For a cup it is just above the
/// object.
pub(super) fn grasp_height(robot: &Robot, extent: &[f64; 3]) -> f64 {
    match &robot.settings.gripper {
        Gripper::ParallelJaw(jaw) => {
            (0.5 * extent[2]).max(extent[2] - (jaw.palm_m - PALM_ROOM_M)).max(jaw.tip_m + TIP_ROOM_M)
        }
        Gripper::Suction(_) => extent[2] + CUP_ROOM_M,
    }
}

/// Horizontal offset from the object's centre to the grasp point, in the object's frame, in metres.
pub(super) fn grasp_offset(robot: &Robot, task: &Briefing) -> Vector3<f64> {
    match (&robot.settings.gripper, Shape::from_name(&task.shape)) {
        (Gripper::Suction(_), Some(shape)) => {
            let [x, y] = shape.top(task.object_extent_m[0]);
            Vector3::new(x, y, 0.0)
        }
        _ => Vector3::zeros(),
    }
}

/// The yaw of the tool nearest to `placed` at which the object has the orientation of the target, all in radians.
/// `in_hand` is the yaw of the tool relative to the object, and the target has the yaw 0.
fn aligned(placed: f64, in_hand: f64, shape: Option<Shape>) -> f64 {
    let copies = match shape {
        Some(Shape::Cylinder | Shape::Sphere) => return placed,
        Some(Shape::Box) => 4.0,
        Some(Shape::L | Shape::Irregular) | None => 1.0,
    };
    let turn = 2.0 * PI / copies;
    in_hand + turn * ((placed - in_hand) / turn).round()
}

/// The last point of a path, or `start` if it is empty.
fn end_of(path: &[Vec<f64>], start: &[f64]) -> Vec<f64> {
    path.last().map_or_else(|| start.to_vec(), Clone::clone)
}

impl Policy for Scripted {
    fn check(&self, task: &TaskSpec) -> Result<(), String> {
        let joints = task.action.joints();
        if task.name != super::NAME || joints != Some(&*self.robot.settings.arm.joints) {
            return Err(format!(
                "the scripted controller drives pick_place on {}, not {}",
                self.robot.name(),
                task.name
            ));
        }
        Ok(())
    }

    fn reset(&mut self, _: &TaskSpec, instance: &TaskInstance, _: Seed) -> Result<(), Fault> {
        let task = &Briefing::of(instance)?;
        // If a pose is out of reach, the controller runs the reachable part of its plan and then waits. This is a failure
        // of the controller (a timeout), not a fault of the simulator.
        self.plan = self.plan(task).unwrap_or_else(|(begun, _)| begun);
        if self.plan.is_empty() {
            let path = vec![self.robot.settings.arm.home_rad.clone()];
            self.plan.push(Stage {
                phase: phases::APPROACH_ABOVE,
                path,
                gripper: GripperCommand::Open,
                settles: false,
            });
        }
        (self.current, self.tick, self.last_opening, self.rest) = (0, 0, None, 0);
        (self.commanded, self.stopped) = (None, None);
        Ok(())
    }

    fn act(&mut self, observation: &Observation) -> Result<Action, Fault> {
        let opening = observation.gripper_opening_m();
        let measured = observation.joint_positions();
        let moved = match (self.last_opening, opening) {
            (Some(before), Some(now)) => (before - now).abs(),
            _ => 0.0,
        };
        self.rest = if moved < GRIPPER_SETTLED_M { self.rest + 1 } else { 0 };
        self.last_opening = opening;
        if self.pushed_off(measured) {
            self.stopped.get_or_insert_with(|| measured.to_vec());
        }
        let stage = &self.plan[self.current];
        if self.stopped.is_none() && self.tick >= stage.path.len() && self.current + 1 < self.plan.len() {
            let end = &stage.path[stage.path.len() - 1];
            let goal = self.chain.tcp_at(end);
            let off = goal.inverse() * self.chain.tcp_at(measured);
            let there =
                off.translation.vector.norm() <= POSITION_TOLERANCE_M && off.rotation.angle() <= ANGLE_TOLERANCE_RAD;
            if there && (!stage.settles || self.rest.min(self.tick) >= SETTLE_TICKS) {
                (self.current, self.tick) = (self.current + 1, 0);
            }
        }
        let stage = &self.plan[self.current];
        let joints = self.stopped.as_ref().unwrap_or(&stage.path[self.tick.min(stage.path.len() - 1)]).clone();
        self.tick += 1;
        let last = self.commanded.take().map_or_else(|| measured.to_vec(), |[_, last]| last);
        self.commanded = Some([last, joints.clone()]);
        Ok(Action {
            command: Command::JointPosition(joints),
            gripper: Some(stage.gripper.number()),
            phase: Some(stage.phase),
        })
    }

    fn gave_up(&self) -> bool {
        // A stopped arm keeps its position and its phase, and a finished plan its last command.
        let finished = |stage: &Stage| self.tick >= stage.path.len() + IDLE_TICKS;
        self.stopped.is_some()
            || self.plan.get(self.current..).is_some_and(|rest| matches!(rest, [last] if finished(last)))
    }
}
