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

use nalgebra::{Isometry3, UnitQuaternion, Vector3};
use robogate_core::{Action, Fault, Observation, Policy, Pose, Seed, TaskInstance, TaskSpec};
use robogate_physics::trajectory::{TRANSIT_HEIGHTS_M, ToolLimit};
use robogate_physics::{Chain, Gripper, GripperCommand, Robot, Unreachable};

use super::Shape;
use super::spec::{Briefing, phases};
use crate::arm::{
    CONTROL_PERIOD_S, FREE, FREELY, Planner, Script, Stage, Way, carry_yaw, cup_yaw, drives_task, nearest, tool_down,
};

/// Height of the tool above the table on transit paths, in metres, where the arm reaches it.
const TRANSIT_HEIGHT_M: f64 = TRANSIT_HEIGHTS_M[0];
/// Height of the object above the table at its release, in metres.
const RELEASE_ROOM_M: f64 = 0.003;
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
    /// The plan of the running episode and the progress in it.
    script: Script,
}

impl Scripted {
    /// Creates the controller for a robot with these kinematics.
    pub fn new(robot: Robot, chain: Chain) -> Self {
        let script = Script::new(chain.clone(), Vec::new());
        Self { robot, chain, script }
    }

    /// The tool pose above `at`, pointing down. The fingers close along the direction `yaw` + 90 degrees.
    fn above(at: &[f64; 3], height: f64, yaw: f64) -> Isometry3<f64> {
        tool_down([at[0], at[1], height], yaw)
    }

    /// Candidate yaws of the tool for an object with this `yaw`. For fingers these are the symmetric yaws of the
    /// object. A cup is symmetric in all yaws: its yaw follows the arm's base, which keeps the wrist posture.
    fn grasp_yaws(&self, task: &Briefing, at: &[f64; 3], yaw: f64) -> Vec<f64> {
        match &self.robot.settings.gripper {
            Gripper::ParallelJaw(_) => {
                let symmetry = Shape::from_name(&task.shape).map_or(PI, Shape::grasp_symmetry);
                let count = (2.0 * PI / symmetry).round() as usize;
                (0..count).map(|k| yaw + k as f64 * symmetry).collect()
            }
            Gripper::Suction(_) => vec![cup_yaw(&self.robot, &self.chain, [at[0], at[1]])],
        }
    }

    /// The controller of an arm that holds the object of this task.
    fn holding(&self, task: &Briefing) -> Self {
        let shape = Shape::from_name(&task.shape);
        let width_m = shape.map_or(1.0, Shape::grasp_width) * task.object_extent_m[1];
        Self { chain: self.chain.holding(&self.robot.settings.gripper, width_m), ..self.clone() }
    }

    /// The grasp yaw with the smallest joint motion from home, and the joint positions at this height above the object with this yaw.
    fn choose_grasp(
        &self,
        task: &Briefing,
        at: &[f64; 3],
        yaw: f64,
        transit_m: f64,
    ) -> Result<(f64, Vec<f64>), Unreachable> {
        let yaws = self.grasp_yaws(task, at, yaw);
        let goals: Vec<_> = yaws.iter().map(|yaw| Self::above(at, transit_m, *yaw)).collect();
        nearest(&self.chain, &self.robot.settings.arm.home_rad, &goals).map(|(index, q)| (yaws[index], q))
    }

    /// The grasp offset in the base frame, for an object with this yaw.
    fn rotated_offset(&self, task: &Briefing, yaw: f64) -> Vector3<f64> {
        UnitQuaternion::from_axis_angle(&Vector3::z_axis(), yaw) * grasp_offset(&self.robot, task)
    }

    /// Joint positions of the planned grasp, without the path to it.
    pub(super) fn planned_grasp(&self, task: &Briefing) -> Result<Vec<f64>, Unreachable> {
        let yaw = yaw_of(task);
        let object = &offset_by(&task.object_pose.position, self.rotated_offset(task, yaw));
        let planned = self.holding(task);
        let chosen = |transit_m: &f64| planned.choose_grasp(task, object, yaw, *transit_m);
        let first = chosen(&TRANSIT_HEIGHT_M);
        let lower = || TRANSIT_HEIGHTS_M[1..].iter().find_map(|height| chosen(height).ok());
        let (yaw, above) = first.or_else(|unreachable| lower().ok_or(unreachable))?;
        let goal = Self::above(object, grasp_height(&self.robot, &task.object_extent_m), yaw);
        planned.chain.inverse(&goal, &above, &self.robot.settings.arm.home_rad)
    }

    fn plan(&self, planner: &mut Planner<'_>, task: &Briefing, transit_m: f64) -> Result<(), Unreachable> {
        use GripperCommand::{Close, Open};
        let object_yaw = yaw_of(task);
        let rotated = |yaw| self.rotated_offset(task, yaw);
        let object = &offset_by(&task.object_pose.position, rotated(object_yaw));
        let (yaw, above) = self.choose_grasp(task, object, object_yaw, transit_m)?;
        planner.swing(phases::APPROACH_ABOVE, above, Open);

        let height = grasp_height(&self.robot, &task.object_extent_m);
        let speed = task.approach_speed_m_s.unwrap_or(FREE.speed);
        planner.straight(phases::DESCEND, &[Self::above(object, height, yaw)], ToolLimit { speed, ..FREE }, Open)?;
        planner.grip(phases::GRASP, Close);
        planner.straight(phases::LIFT, &[Self::above(object, transit_m, yaw)], CARRY, Close)?;

        // Across to the target, with the smallest rotation of the tool.
        let goal = &task.target_pose.position;
        let mut placed = carry_yaw(&self.chain, planner.at(), yaw, [goal[0], goal[1]]);
        if task.orientation_tolerance_rad.is_some() {
            placed = aligned(placed, yaw - object_yaw, Shape::from_name(&task.shape));
        }
        let target = &offset_by(goal, rotated(object_yaw + placed - yaw));
        let [over, down] = [transit_m, height + RELEASE_ROOM_M].map(|z| Self::above(target, z, placed));
        planner.straight(phases::MOVE_TO_TARGET, &[over, down], CARRY, Close)?;
        planner.grip(phases::RELEASE, Open);
        planner.straight(phases::RELEASE, &[over], FREE, Open)
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
    crate::arm::grasp_height(&robot.settings.gripper, extent[2])
}

/// Horizontal offset from the object's centre to the grasp point, in the object's frame, in metres.
fn grasp_offset(robot: &Robot, task: &Briefing) -> Vector3<f64> {
    match (&robot.settings.gripper, Shape::from_name(&task.shape)) {
        (Gripper::Suction(_), Some(shape)) => {
            let [x, y] = shape.top(task.object_extent_m[0]);
            Vector3::new(x, y, 0.0)
        }
        _ => Vector3::zeros(),
    }
}

/// The way of a tool that moves in small steps.
pub(super) fn way(robot: &Robot, instance: &TaskInstance) -> Result<Way, Fault> {
    let task = &Briefing::of(instance)?;
    let yaw = yaw_of(task);
    let symmetry = Shape::from_name(&task.shape).map_or(PI, Shape::grasp_symmetry);
    let offset = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), yaw) * grasp_offset(robot, task);
    let over = |pose: &Pose, height: f64| [pose.position[0] + offset.x, pose.position[1] + offset.y, height];
    let grasp = grasp_height(robot, &task.object_extent_m);
    let mut way = Way::new(&robot.settings.gripper, yaw, symmetry);
    way.go(phases::APPROACH_ABOVE, over(&task.object_pose, TRANSIT_HEIGHT_M), &FREELY, false);
    way.go(phases::DESCEND, over(&task.object_pose, grasp), &FREELY, false);
    way.grip(phases::GRASP, true);
    way.go(phases::LIFT, over(&task.object_pose, TRANSIT_HEIGHT_M), &FREELY, true);
    way.go(phases::MOVE_TO_TARGET, over(&task.target_pose, TRANSIT_HEIGHT_M), &FREELY, true);
    way.go(phases::MOVE_TO_TARGET, over(&task.target_pose, grasp + RELEASE_ROOM_M), &FREELY, true);
    way.grip(phases::RELEASE, false);
    way.go(phases::RELEASE, over(&task.target_pose, TRANSIT_HEIGHT_M), &FREELY, false);
    Ok(way)
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

impl Policy for Scripted {
    fn check(&self, task: &TaskSpec) -> Result<(), String> {
        drives_task(super::NAME, &self.robot, task)
    }

    fn reset(&mut self, _: &TaskSpec, instance: &TaskInstance, _: Seed) -> Result<(), Fault> {
        let task = &Briefing::of(instance)?;
        let arm = self.holding(task);
        let planned = |transit_m: &f64| {
            let mut planner = Planner::new(&arm.robot, &arm.chain, CONTROL_PERIOD_S);
            let reachable = arm.plan(&mut planner, task, *transit_m);
            (planner.finish(), reachable.is_ok())
        };
        let (mut plan, reachable) = planned(&TRANSIT_HEIGHT_M);
        // If a pose is out of reach, the controller runs the reachable part of its plan and then waits. This is a failure
        // of the controller (a timeout), not a fault of the simulator.
        if !reachable && let Some((lower, _)) = TRANSIT_HEIGHTS_M[1..].iter().map(planned).find(|(_, whole)| *whole) {
            plan = lower;
        }
        if plan.is_empty() {
            let path = vec![self.robot.settings.arm.home_rad.clone()];
            let gripper = GripperCommand::Open;
            plan.push(Stage::of(phases::APPROACH_ABOVE, path, gripper));
        }
        self.script = Script::new(arm.chain, plan);
        Ok(())
    }

    fn act(&mut self, observation: &Observation) -> Result<Action, Fault> {
        Ok(self.script.act(observation))
    }

    fn gave_up(&self) -> bool {
        self.script.gave_up()
    }
}
