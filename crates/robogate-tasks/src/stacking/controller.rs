//! The scripted controller: it plans all motions from nominal data at the start, see [`crate::arm::Script`].

use robogate_core::{Action, Fault, Observation, Policy, Seed, TaskInstance, TaskSpec};
use robogate_physics::trajectory::ToolLimit;
use robogate_physics::{Chain, GripperCommand, Robot, Unreachable};

use super::NAME;
use super::spec::{Briefing, phases};
use crate::arm::{
    CONTROL_PERIOD_S, FINELY, FREE, FREELY, Planner, Posture, Script, Way, drives_task, grasp_height, tool_down,
};

/// Height of the tool above the table on transit paths, in metres: a carried part passes over a stack of two.
const TRANSIT_HEIGHT_M: f64 = 0.25;
/// Height of a part above the part below it at its release, in metres.
pub(super) const RELEASE_ROOM_M: f64 = 0.003;
/// Height above a release from which a tool that moves in small steps goes finely, in metres.
const APPROACH_M: f64 = 0.01;
/// Limits of motion with a part in the hand, low enough that it does not slip.
pub(super) const CARRY: ToolLimit = ToolLimit { speed: 0.5, acceleration: 1.2 };
/// Limits of the last part of the way down onto the stack.
const LOWER: ToolLimit = ToolLimit { speed: 0.2, acceleration: 0.8 };

/// The scripted controller.
pub(super) struct Scripted {
    robot: Robot,
    chain: Chain,
    script: Script,
}

impl Scripted {
    /// The controller for a robot with these kinematics.
    pub(super) fn new(robot: Robot, chain: Chain) -> Self {
        let script = Script::new(chain.clone(), Vec::new());
        Self { robot, chain, script }
    }

    /// The postures in which the arm grasps and releases each part, from the bottom up. `None` if one is out of reach.
    pub(super) fn postures(&self, briefing: &Briefing) -> Option<[[Posture; 2]; 2]> {
        let chain = self.chain.holding(&self.robot.settings.gripper, briefing.size_m);
        let mut planner = Planner::new(&self.robot, &chain, CONTROL_PERIOD_S);
        (1..briefing.order.len()).try_for_each(|level| self.stack(&mut planner, briefing, level)).ok()?;
        // The last posture is that after the last release.
        let [a, b, c, d, _]: [Posture; 5] = Posture::of_plan(&self.chain, &planner.finish()).try_into().ok()?;
        Some([[a, b], [c, d]])
    }

    /// Appends the motions that put the part of a level on the stack.
    fn stack(&self, planner: &mut Planner<'_>, briefing: &Briefing, level: usize) -> Result<(), Unreachable> {
        use GripperCommand::{Close, Open};
        let [x, y, _] = briefing.parts[briefing.order[level]].position;
        let grasp = planner.grasp_height(briefing.size_m);
        let (yaw, joints) = planner.over([x, y], TRANSIT_HEIGHT_M, planner.square_yaw([x, y]))?;
        planner.swing(phases::APPROACH, joints, Open);
        planner.straight(phases::APPROACH, &[tool_down([x, y, grasp], yaw)], FREE, Open)?;
        planner.grip(phases::GRASP, Close);

        let (steps, place) = (level as f64, briefing.place(level));
        let at = |height: f64, yaw: f64| tool_down([place[0], place[1], height], yaw);
        // Cubes are equal after a quarter rotation.
        let (turned, _) = planner.over(place, TRANSIT_HEIGHT_M, yaw)?;
        let down = steps * briefing.size_m + grasp + RELEASE_ROOM_M;
        let lifted = tool_down([x, y, TRANSIT_HEIGHT_M], yaw);
        planner.straight(phases::CARRY, &[lifted, at(TRANSIT_HEIGHT_M, turned)], CARRY, Close)?;
        planner.straight(phases::CARRY, &[at(down, turned)], LOWER, Close)?;
        planner.grip(phases::RELEASE, Open);
        planner.straight(phases::RELEASE, &[at(TRANSIT_HEIGHT_M, turned)], FREE, Open)
    }
}

/// The way of a tool that moves in small steps.
pub(super) fn way(robot: &Robot, instance: &TaskInstance) -> Result<Way, Fault> {
    let briefing = Briefing::of(instance)?;
    let gripper = &robot.settings.gripper;
    let grasp = grasp_height(gripper, briefing.size_m);
    let mut way = Way::for_square(gripper);
    for level in 1..briefing.order.len() {
        let [x, y, _] = briefing.parts[briefing.order[level]].position;
        let [u, v] = briefing.place(level);
        let down = level as f64 * briefing.size_m + grasp + RELEASE_ROOM_M;
        way.go(phases::APPROACH, [x, y, TRANSIT_HEIGHT_M], &FREELY, false);
        way.go(phases::APPROACH, [x, y, grasp], &FREELY, false);
        way.grip(phases::GRASP, true);
        way.go(phases::CARRY, [x, y, TRANSIT_HEIGHT_M], &FREELY, true);
        way.go(phases::CARRY, [u, v, TRANSIT_HEIGHT_M], &FREELY, true);
        way.go(phases::CARRY, [u, v, down + APPROACH_M], &FREELY, true);
        way.go(phases::CARRY, [u, v, down], &FINELY, true);
        way.grip(phases::RELEASE, false);
        way.go(phases::RELEASE, [u, v, TRANSIT_HEIGHT_M], &FREELY, false);
    }
    Ok(way)
}

impl Policy for Scripted {
    fn check(&self, task: &TaskSpec) -> Result<(), String> {
        drives_task(NAME, &self.robot, task)
    }

    fn reset(&mut self, _: &TaskSpec, instance: &TaskInstance, _: Seed) -> Result<(), Fault> {
        let briefing = Briefing::of(instance)?;
        let chain = self.chain.holding(&self.robot.settings.gripper, briefing.size_m);
        let mut planner = Planner::new(&self.robot, &chain, CONTROL_PERIOD_S);
        // If a pose is out of reach, the controller runs the reachable part of its plan and then waits. This is a failure
        // of the controller (a timeout), not a fault of the simulator.
        let reachable = (1..briefing.order.len()).try_for_each(|level| self.stack(&mut planner, &briefing, level));
        if reachable.is_err() {
            planner.swing(phases::APPROACH, self.robot.settings.arm.home_rad.clone(), GripperCommand::Open);
        }
        let stages = planner.finish();
        self.script = Script::new(chain, stages);
        Ok(())
    }

    fn act(&mut self, observation: &Observation) -> Result<Action, Fault> {
        Ok(self.script.act(observation))
    }
}
