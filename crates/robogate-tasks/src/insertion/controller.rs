//! The scripted controller: it picks the peg up by a plan from nominal data, then feels its way into the hole
//! ([`crate::arm::Feel`]).

use nalgebra::{UnitQuaternion, Vector3};
use robogate_core::{Action, Command, Fault, Observation, Policy, Seed, TaskInstance, TaskSpec, Word};
use robogate_physics::trajectory::ToolLimit;
use robogate_physics::{Chain, Gripper, GripperCommand, Robot, Unreachable};

use super::NAME;
use super::parts::{DEPTH_M, HEAD_HEIGHT_M, HEAD_M, SHAFT_M};
use super::spec::{Briefing, phases};
use crate::arm::{
    CONTROL_PERIOD_S, FINELY, FREE, FREELY, Feel, Feeling, Fit, Planner, Posture, SEATED_M, Script, Way, drives_task,
    tool_down,
};

/// Height of the peg's tip above the block before the search, in metres.
const ABOVE_M: f64 = 0.006;
/// Height of the tool above the table on transit paths, in metres.
const TRANSIT_HEIGHT_M: f64 = 0.24;
/// Limits of motion with the peg in the hand.
pub(super) const CARRY: ToolLimit = ToolLimit { speed: 0.4, acceleration: 1.0 };
/// Gap between a cup and the head in the grasp, in metres.
const CUP_ROOM_M: f64 = 0.002;
/// Forces of search and insertion, in newtons.
const SEARCH_N: f64 = 5.0;
pub(super) const INSERT_N: f64 = 14.0;

/// The scripted controller.
pub(super) struct Scripted {
    robot: Robot,
    chain: Chain,
    script: Script,
    feel: Option<Feel>,
}

fn phase(stage: Feeling) -> Word {
    match stage {
        Feeling::Touch => phases::TOUCH,
        Feeling::Search { .. } => phases::SEARCH,
        Feeling::Insert { .. } | Feeling::Lift { .. } => phases::INSERT,
        Feeling::Release { .. } => phases::RELEASE,
    }
}

impl Scripted {
    /// The controller for a robot with these kinematics.
    pub(super) fn new(robot: Robot, chain: Chain) -> Self {
        let chain = chain.holding(&robot.settings.gripper, HEAD_M);
        let script = Script::new(chain.clone(), Vec::new());
        Self { robot, chain, script, feel: None }
    }

    /// The postures in which the arm grasps the peg and arrives over the hole. `None` if one is out of reach.
    pub(super) fn postures(&self, briefing: &Briefing) -> Option<[Posture; 2]> {
        let mut planner = Planner::new(&self.robot, &self.chain, CONTROL_PERIOD_S);
        self.pick(&mut planner, briefing).ok()?;
        Posture::of_plan(&self.chain, &planner.finish()).try_into().ok()
    }

    /// Appends the motions that bring the peg over the hole. Returns the orientation of the tool there.
    fn pick(&self, planner: &mut Planner<'_>, briefing: &Briefing) -> Result<UnitQuaternion<f64>, Unreachable> {
        use GripperCommand::{Close, Open};
        let ([x, y, _], [hx, hy, hz]) = (briefing.peg.position, briefing.hole.position);
        let tool = tool_height(&self.robot.settings.gripper);
        // The peg is square, so the tool may be rotated by quarters.
        let (yaw, joints) = planner.over([x, y], TRANSIT_HEIGHT_M, planner.square_yaw([x, y]))?;
        planner.swing(phases::PICK, joints, Open);
        planner.straight(phases::PICK, &[tool_down([x, y, tool], yaw)], FREE, Open)?;
        planner.grip(phases::PICK, Close);
        let (turned, _) = planner.over([hx, hy], TRANSIT_HEIGHT_M, yaw)?;
        let goals = [
            tool_down([x, y, TRANSIT_HEIGHT_M], yaw),
            tool_down([hx, hy, TRANSIT_HEIGHT_M], turned),
            tool_down([hx, hy, hz + ABOVE_M + tool], turned),
        ];
        planner.straight(phases::PICK, &goals, CARRY, Close)?;
        Ok(goals[2].rotation)
    }
}

/// The way of a tool that moves in small steps. It does not feel its way, so it needs a peg and a hole at their places.
pub(super) fn way(robot: &Robot, instance: &TaskInstance) -> Result<Way, Fault> {
    let briefing = Briefing::of(instance)?;
    let gripper = &robot.settings.gripper;
    let ([x, y, _], [hx, hy, hz]) = (briefing.peg.position, briefing.hole.position);
    let tool = tool_height(gripper);
    let mut way = Way::for_square(gripper);
    way.go(phases::PICK, [x, y, TRANSIT_HEIGHT_M], &FREELY, false);
    way.go(phases::PICK, [x, y, tool], &FINELY, false);
    way.grip(phases::PICK, true);
    way.go(phases::PICK, [x, y, TRANSIT_HEIGHT_M], &FREELY, true);
    way.go(phases::PICK, [hx, hy, TRANSIT_HEIGHT_M], &FREELY, true);
    way.go(phases::TOUCH, [hx, hy, hz + ABOVE_M + tool], &FINELY, true);
    way.go(phases::INSERT, [hx, hy, hz - DEPTH_M + SEATED_M + tool], &FINELY, true);
    way.grip(phases::RELEASE, false);
    way.go(phases::RELEASE, [hx, hy, TRANSIT_HEIGHT_M], &FREELY, false);
    Ok(way)
}

/// Height of the tool above the peg's tip in the grasp, in metres.
pub(super) fn tool_height(gripper: &Gripper) -> f64 {
    match gripper {
        Gripper::ParallelJaw(_) => SHAFT_M + 0.5 * HEAD_HEIGHT_M,
        Gripper::Suction(_) => SHAFT_M + HEAD_HEIGHT_M + CUP_ROOM_M,
    }
}

impl Policy for Scripted {
    fn check(&self, task: &TaskSpec) -> Result<(), String> {
        drives_task(NAME, &self.robot, task)
    }

    fn reset(&mut self, _: &TaskSpec, instance: &TaskInstance, _: Seed) -> Result<(), Fault> {
        let briefing = Briefing::of(instance)?;
        let mut planner = Planner::new(&self.robot, &self.chain, CONTROL_PERIOD_S);
        let [x, y, z] = briefing.hole.position;
        // If a pose is out of reach, the controller runs the reachable part of its plan and then waits. This is a failure
        // of the controller (a timeout), not a fault of the simulator.
        let down = self.pick(&mut planner, &briefing);
        if down.is_err() {
            planner.swing(phases::PICK, self.robot.settings.arm.home_rad.clone(), GripperCommand::Open);
        }
        self.feel = down.ok().map(|down| {
            let fit = Fit {
                clearance_m: briefing.clearance_m,
                chamfer_m: briefing.chamfer_m,
                hole: Vector3::new(x, y, z),
                depth_m: DEPTH_M,
                tool_m: tool_height(&self.robot.settings.gripper),
                down,
                search_n: SEARCH_N,
                insert_n: INSERT_N,
                stiffness: briefing.arm_stiffness,
                coupled: false,
                slips: false,
            };
            Feel::new(&self.robot, fit)
        });
        self.script = Script::new(self.chain.clone(), planner.finish());
        Ok(())
    }

    fn act(&mut self, observation: &Observation) -> Result<Action, Fault> {
        let measured = observation.joint_positions();
        let Some(feel) = self.feel.as_mut().filter(|feel| feel.has_begun() || self.script.is_done(measured)) else {
            return Ok(self.script.act(observation));
        };
        let joints = feel.joints(&self.chain, measured, self.script.end().unwrap_or(measured));
        let gripper = if feel.is_done() { GripperCommand::Open } else { GripperCommand::Close };
        Ok(Action {
            command: Command::JointPosition(joints),
            gripper: Some(gripper.number()),
            phase: Some(phase(feel.stage())),
        })
    }
}
