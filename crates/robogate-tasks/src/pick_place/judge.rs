//! The judge: resolves scenarios, adds encoder errors, converts actions to joint commands and decides outcomes.
//!
//! The same judge serves an engine in this process ([`super::PickPlace`]) and in another one ([`super::remote`]), with
//! the same random draws, read-back and referee.

use robogate_core::{
    Action, Assignment, Ending, FEASIBLE, Fault, FaultKind, Infeasibility, Observation, Scenario, Start, Step,
};
use robogate_physics::{
    ArmState, Chain, Fixture, GripperCommand, Readback, Robot, Steering, StepView, SuctionLaw, Touches, Visual, pose,
};

use super::PickPlaceForesight;
use super::cell::{CONTROL_PERIOD_S, ResolvedCell, TOLERANCE_M};
use super::parameters::ReadbackContext;
use super::referee::{self, Goal, Referee};
use super::spec::observation;
use super::{Rules, feasibility};

/// Largest clearance that is measured, in metres.
const CLEARANCE_LIMIT_M: f64 = 0.25;

/// An arm is at rest if no joint is faster than this, in rad/s.
const STILL_JOINT_SPEED: f64 = 2e-3;

/// The outcome is certain if arm and object have been at rest for this many control periods.
const STILL_TICKS: u32 = 8;

/// The judge of the task on a robot.
pub(crate) struct Judge {
    robot: Robot,
    chain: Chain,
    grip_force_n: f64,
    rules: Rules,
    suction: SuctionLaw,
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
    /// Grip force as a multiple of the robot's setting; `None` if the engine is in another process.
    pub(crate) grip_force_scale: Option<f64>,
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
    /// Number of control periods for which arm and object have been at rest.
    still_ticks: u32,
    /// 1 if some policy may complete the scenario, otherwise 0.
    feasible: f64,
}

impl Judge {
    pub(crate) fn new(robot: Robot, chain: Chain, grip_force_n: f64) -> Self {
        Self { robot, chain, grip_force_n, rules: Rules::default(), suction: SuctionLaw::Vacuum, episode: None }
    }

    pub(crate) fn rules(&self) -> &Rules {
        &self.rules
    }

    /// Replaces the rules of all later episodes.
    pub(crate) fn set_rules(&mut self, rules: Rules) {
        self.rules = rules;
    }

    /// Sets the law of the suction cup, for checks of feasibility.
    pub(crate) fn set_suction(&mut self, law: SuctionLaw) {
        self.suction = law;
    }

    /// The knowledge about episodes before they run.
    pub(crate) fn foresight(&self) -> PickPlaceForesight {
        PickPlaceForesight::new(&self.robot, &self.chain, self.grip_force_n, &self.rules)
    }

    pub(crate) fn robot(&self) -> &Robot {
        &self.robot
    }

    pub(crate) fn chain(&self) -> &Chain {
        &self.chain
    }

    /// The reason why no policy can complete a scenario, if it is known.
    pub(crate) fn infeasibility(&self, requested: &Assignment) -> Option<Infeasibility> {
        let scale = self.rules.workspace_scale(&self.robot);
        feasibility::infeasibility(requested, &self.robot, scale, self.grip_force_n, self.suction)
    }

    /// Resolves the cell that a plant must set up for a scenario. Ends the running episode.
    pub(crate) fn resolve(&mut self, scenario: &Scenario) -> Result<ResolvedCell, Fault> {
        self.episode = None;
        ResolvedCell::new(scenario, &self.robot, &self.rules)
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
        let mut briefing = cell.briefing();
        briefing.orientation_tolerance_rad = self.rules.orientation_tolerance_rad;
        let Acting { engine, visual, grip_threshold_m, grip_force_scale } = acting;
        let context =
            ReadbackContext { cell: &cell, engine, visual, grip_threshold_m, grip_force_scale, briefing: &briefing };
        let applied = context.applied(&scenario.requested);
        let instance = briefing.instance();
        let mut episode = Episode {
            steering: Steering::default(),
            referee: Referee::new(
                Goal { target: cell.target, tolerance_m: TOLERANCE_M, shape: cell.parameters.shape },
                self.rules,
                self.grip_force_n * cell.parameters.gripper.force_scale,
            ),
            measured: Vec::new(),
            gripper: GripperCommand::Open,
            ticks: 0,
            still_ticks: 0,
            feasible: if self.infeasibility(&scenario.requested).is_none() { 1.0 } else { 0.0 },
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
        body: impl Fn(usize) -> String,
    ) -> Result<Step, Fault> {
        let Some(episode) = &mut self.episode else {
            return Err(Fault::new(FaultKind::Setup, "no episode is running"));
        };
        episode.ticks += 1;
        let arm_rests = arm_state.joint_velocities.iter().all(|speed| speed.abs() < STILL_JOINT_SPEED);
        episode.still_ticks = if arm_rests && episode.referee.at_rest() { episode.still_ticks + 1 } else { 0 };
        if let Some(clearance) = clearance {
            episode.referee.note_clearance(clearance);
        }
        let observation = episode.observation(arm_state, &self.chain);
        let (cell, referee) = (&episode.cell, &mut episode.referee);
        let decided = referee.ending(|collision| {
            let fixture = |index: usize| cell.scene.fixtures.get(index).map_or_else(String::new, |it| it.name.clone());
            (body(collision.robot_body), collision.hit.name(fixture, &body))
        });
        let over = (episode.ticks + 1) as f64 * CONTROL_PERIOD_S > self.rules.time_limit_s + 0.5 * CONTROL_PERIOD_S;
        let mut measures = referee.measures();
        measures.set(FEASIBLE, Some(episode.feasible));
        let step = Step {
            observation,
            events: referee.take_events(),
            measures,
            ending: decided.or_else(|| over.then(|| at_limit(referee, &self.rules))),
            state_hash,
        };
        if step.ending.is_some() {
            self.episode = None;
        }
        Ok(step)
    }

    /// The ending at the time limit, if it is certain for a policy that repeats its last action: arm and object are at
    /// rest, and no other body will move.
    pub(crate) fn foregone_ending(&self) -> Option<Ending> {
        let episode = self.episode.as_ref()?;
        let now = episode.ticks as f64 * CONTROL_PERIOD_S;
        // A body that has just stopped may have pushed something.
        let settling_s = f64::from(STILL_TICKS) * CONTROL_PERIOD_S;
        let moves = |fixture: &Fixture| fixture.motion.is_some_and(|motion| motion.ends_s + settling_s > now);
        let certain = episode.still_ticks >= STILL_TICKS && !episode.cell.scene.fixtures.iter().any(moves);
        certain.then(|| at_limit(&episode.referee, &self.rules))
    }

    /// Ends the running episode without a result.
    pub(crate) fn abandon(&mut self) {
        self.episode = None;
    }
}

/// The ending of an episode that reaches the time limit in the present state.
fn at_limit(referee: &Referee, rules: &Rules) -> Ending {
    Ending { failure: Some(referee.mode_at_limit()), time_s: rules.time_limit_s, contact: None }
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
