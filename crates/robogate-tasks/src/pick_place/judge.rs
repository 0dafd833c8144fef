//! The task around a plant: what it is told to set up, what the policy sees and asks for, and how it ends.
//!
//! The same for every plant, be it an engine in this process ([`super::PickPlace`]) or behind a socket
//! ([`super::remote`]): one set of random draws, one reading back, one referee.

use robogate_core::{Action, Fault, FaultKind, GripperCommand, Observation, Scenario, Start, Step};
use robogate_physics::{ArmState, Chain, Readback, Robot, Steering, StepView, Touches, Visual, pose};

use super::cell::{CONTROL_PERIOD_S, ResolvedCell, TOLERANCE_M};
use super::referee::{self, Referee};

/// Clearance beyond this is not measured, in metres.
const CLEARANCE_LIMIT_M: f64 = 0.25;

/// Runs the task on a robot.
pub(crate) struct Judge {
    robot: Robot,
    chain: Chain,
    grip_force_n: f64,
    episode: Option<Episode>,
}

/// The episode under way.
struct Episode {
    cell: ResolvedCell,
    steering: Steering,
    referee: Referee,
    /// Joint positions as the encoders read them, in radians.
    measured: Vec<f64>,
    told: GripperCommand,
    ticks: u64,
}

impl Judge {
    pub(crate) fn new(robot: Robot, chain: Chain, grip_force_n: f64) -> Self {
        Self { robot, chain, grip_force_n, episode: None }
    }

    pub(crate) fn robot(&self) -> &Robot {
        &self.robot
    }

    pub(crate) fn chain(&self) -> &Chain {
        &self.chain
    }

    /// The cell that a plant has to set up. No episode is under way any more.
    pub(crate) fn brief(&mut self, scenario: &Scenario) -> Result<ResolvedCell, Fault> {
        self.episode = None;
        ResolvedCell::new(scenario, &self.robot)
    }

    /// Begins the episode in a cell that a plant has set up: what it holds, how it looks, who touches whom, how
    /// the arm is.
    pub(crate) fn start(
        &mut self,
        scenario: &Scenario,
        cell: ResolvedCell,
        (held, visual): (&Readback, &Visual),
        touches: &Touches,
        arm_state: ArmState,
    ) -> Result<Start, Fault> {
        if touches.collision.is_some() || touches.body_on_object || touches.fingers.iter().any(Option::is_some) {
            return Err(Fault::new(FaultKind::Setup, "the robot starts in contact"));
        }
        let applied = cell.applied(&scenario.requested, held, visual);
        let task = cell.task();
        let mut episode = Episode {
            steering: Steering::default(),
            referee: Referee::new(cell.target, TOLERANCE_M, self.grip_force_n),
            measured: Vec::new(),
            told: GripperCommand::Open,
            ticks: 0,
            cell,
        };
        let observation = episode.observe(arm_state, &self.chain);
        self.episode = Some(episode);
        Ok(Start { task, observation, applied })
    }

    /// Where a plant has to drive the arm's joints (rad) in the next control period.
    pub(crate) fn command(&mut self, action: &Action) -> Result<Vec<f64>, Fault> {
        let Some(episode) = &mut self.episode else {
            return Err(Fault::new(FaultKind::Setup, "no episode is under way"));
        };
        let home = &self.robot.settings.arm.home_rad;
        let wanted = episode.steering.joints(&action.arm, &episode.measured, &self.chain, home)?;
        episode.told = action.gripper;
        // The servo closes its loop on the encoders: what they read too much, the arm lacks.
        Ok(wanted.iter().zip(&episode.cell.bias).map(|(q, bias)| q - bias).collect())
    }

    /// Looks at one time step of the control period under way.
    pub(crate) fn look(&mut self, view: &StepView<'_>) {
        let Some(episode) = &mut self.episode else { return };
        episode.referee.look(&referee::Sight {
            time: (episode.ticks as f64 + view.fraction) * CONTROL_PERIOD_S,
            gripper: episode.told,
            hand: view.gripper,
            touches: view.touches,
            object: view.object,
            velocity: view.velocity,
            tcp: view.tcp,
        });
    }

    /// Clearance from here on (m) tells nothing new.
    pub(crate) fn clearance_bound(&self) -> f64 {
        let smallest = self.episode.as_ref().and_then(|episode| episode.referee.measures().min_clearance_m);
        smallest.unwrap_or(CLEARANCE_LIMIT_M)
    }

    /// Ends the control period: how the arm is, how near it is to anything (m) and the plant's state. `body` names a
    /// body of the robot.
    pub(crate) fn finish(
        &mut self,
        arm_state: ArmState,
        clearance: Option<f64>,
        state_hash: u64,
        body: impl FnOnce(usize) -> String,
    ) -> Result<Step, Fault> {
        let Some(episode) = &mut self.episode else {
            return Err(Fault::new(FaultKind::Setup, "no episode is under way"));
        };
        episode.ticks += 1;
        if let Some(clearance) = clearance {
            episode.referee.note_clearance(clearance);
        }
        let observation = episode.observe(arm_state, &self.chain);
        let (cell, referee) = (&episode.cell, &mut episode.referee);
        let step = Step {
            observation,
            events: referee.take_events(),
            measures: referee.measures(),
            ending: referee.ending(|collision| {
                let fixture = cell.scene.fixtures.get(collision.fixture);
                (body(collision.robot_body), fixture.map_or_else(String::new, |fixture| fixture.name.clone()))
            }),
            state_hash,
        };
        if referee.decided() {
            self.episode = None;
        }
        Ok(step)
    }

    /// Gives the episode up.
    pub(crate) fn abandon(&mut self) {
        self.episode = None;
    }
}

impl Episode {
    /// What the policy sees of an arm: the encoders' bias is in it.
    fn observe(&mut self, arm_state: ArmState, chain: &Chain) -> Observation {
        self.measured = arm_state.joint_positions.iter().zip(&self.cell.bias).map(|(q, bias)| q + bias).collect();
        Observation {
            time_s: self.ticks as f64 * CONTROL_PERIOD_S,
            tool_pose: pose(&chain.tcp_at(&self.measured)),
            joint_positions: self.measured.clone(),
            joint_velocities: arm_state.joint_velocities,
            gripper_opening_m: arm_state.opening_m,
            images: Vec::new(),
        }
    }
}
