//! The judge: resolves scenarios, adds encoder errors, converts actions to joint commands and decides outcomes.
//!
//! The same judge serves an engine in this process ([`super::PickPlace`]) and in another one ([`super::remote`]), with
//! the same random draws, read-back and referee.

use robogate_core::{Action, Fault, FaultKind, Observation, Scenario, Start, Step};
use robogate_physics::{ArmState, Chain, GripperCommand, Readback, Robot, Steering, StepView, Touches, Visual, pose};

use super::PickPlaceForesight;
use super::cell::{CONTROL_PERIOD_S, ResolvedCell, TOLERANCE_M};
use super::parameters::ReadbackContext;
use super::referee::{self, Referee};
use super::spec::observation;

/// Largest clearance that is measured, in metres.
const CLEARANCE_LIMIT_M: f64 = 0.25;

/// The judge of the task on a robot.
pub(crate) struct Judge {
    robot: Robot,
    chain: Chain,
    grip_force_n: f64,
    episode: Option<Episode>,
}

/// The components of a cell from which parameters are read back.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Acting<'a> {
    /// State of the engine.
    pub(crate) engine: &'a Readback,
    /// State of the cameras.
    pub(crate) visual: &'a Visual,
    /// Threshold of the suction cup, in metres; `None` without a cup.
    pub(crate) grip_threshold_m: Option<f64>,
}

/// The running episode.
struct Episode {
    cell: ResolvedCell,
    steering: Steering,
    referee: Referee,
    /// Joint positions as the encoders measure them, in radians.
    measured: Vec<f64>,
    gripper: GripperCommand,
    ticks: u64,
}

impl Judge {
    pub(crate) fn new(robot: Robot, chain: Chain, grip_force_n: f64) -> Self {
        Self { robot, chain, grip_force_n, episode: None }
    }

    /// The knowledge about episodes before they run.
    pub(crate) fn foresight(&self) -> PickPlaceForesight {
        PickPlaceForesight::new(&self.robot, &self.chain, self.grip_force_n)
    }

    pub(crate) fn robot(&self) -> &Robot {
        &self.robot
    }

    pub(crate) fn chain(&self) -> &Chain {
        &self.chain
    }

    /// Resolves the cell that a plant must set up for a scenario. Ends the running episode.
    pub(crate) fn resolve(&mut self, scenario: &Scenario) -> Result<ResolvedCell, Fault> {
        self.episode = None;
        ResolvedCell::new(scenario, &self.robot)
    }

    /// Starts the episode in a cell that a plant has set up. `touches` and `arm_state` are the initial ones.
    pub(crate) fn start(
        &mut self,
        scenario: &Scenario,
        cell: ResolvedCell,
        acting: Acting<'_>,
        touches: &Touches,
        arm_state: ArmState,
    ) -> Result<Start, Fault> {
        if touches.collision.is_some() || touches.body_on_object || touches.fingers.iter().any(Option::is_some) {
            return Err(Fault::new(FaultKind::Setup, "the robot starts in contact"));
        }
        let briefing = cell.briefing();
        let Acting { engine, visual, grip_threshold_m } = acting;
        let context = ReadbackContext { cell: &cell, engine, visual, grip_threshold_m, briefing: &briefing };
        let applied = context.applied(&scenario.requested);
        let instance = briefing.instance();
        let mut episode = Episode {
            steering: Steering::default(),
            referee: Referee::new(cell.target, TOLERANCE_M, self.grip_force_n),
            measured: Vec::new(),
            gripper: GripperCommand::Open,
            ticks: 0,
            cell,
        };
        let observation = episode.observation(arm_state, &self.chain);
        self.episode = Some(episode);
        Ok(Start { instance, observation, applied })
    }

    /// Joint positions (rad) to which a plant must drive the arm in the next control period.
    pub(crate) fn command(&mut self, action: &Action) -> Result<Vec<f64>, Fault> {
        let Some(episode) = &mut self.episode else {
            return Err(Fault::new(FaultKind::Setup, "no episode is running"));
        };
        let home = &self.robot.settings.arm.home_rad;
        let wanted = episode.steering.joints(&action.command, &episode.measured, &self.chain, home)?;
        episode.gripper = GripperCommand::of(action);
        // The servo closes its loop on the encoders, so the true joint positions are off by the bias.
        Ok(wanted.iter().zip(&episode.cell.bias).map(|(q, bias)| q - bias).collect())
    }

    /// Observes one time step of the running control period.
    pub(crate) fn observe(&mut self, view: &StepView<'_>) {
        let Some(episode) = &mut self.episode else { return };
        episode.referee.observe(&referee::Sight {
            time: (episode.ticks as f64 + view.fraction) * CONTROL_PERIOD_S,
            gripper: episode.gripper,
            hand: view.gripper,
            touches: view.touches,
            object: view.object,
            velocity: view.velocity,
            tcp: view.tcp,
        });
    }

    /// The clearance (m) at or above which no measure changes.
    pub(crate) fn clearance_bound(&self) -> f64 {
        let smallest = self.episode.as_ref().and_then(|episode| episode.referee.min_clearance());
        smallest.unwrap_or(CLEARANCE_LIMIT_M)
    }

    /// Ends the control period. `clearance` is the distance between robot and fixtures in metres, if it is small.
    /// `body` returns the name of a body of the robot.
    pub(crate) fn finish(
        &mut self,
        arm_state: ArmState,
        clearance: Option<f64>,
        state_hash: u64,
        body: impl FnOnce(usize) -> String,
    ) -> Result<Step, Fault> {
        let Some(episode) = &mut self.episode else {
            return Err(Fault::new(FaultKind::Setup, "no episode is running"));
        };
        episode.ticks += 1;
        if let Some(clearance) = clearance {
            episode.referee.note_clearance(clearance);
        }
        let observation = episode.observation(arm_state, &self.chain);
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

    /// Ends the running episode without a result.
    pub(crate) fn abandon(&mut self) {
        self.episode = None;
    }
}

impl Episode {
    /// The observation of an arm, with the encoders' bias.
    fn observation(&mut self, arm_state: ArmState, chain: &Chain) -> Observation {
        self.measured = arm_state.joint_positions.iter().zip(&self.cell.bias).map(|(q, bias)| q + bias).collect();
        let tool = pose(&chain.tcp_at(&self.measured));
        let measured = ArmState { joint_positions: self.measured.clone(), ..arm_state };
        observation(self.ticks as f64 * CONTROL_PERIOD_S, measured, tool)
    }
}
