//! The judge: resolves scenarios, adds encoder errors, converts actions to joint commands and reports the outcome.
//!
//! The same judge serves an engine in this process ([`super::ArmEnvironment`]) and in another one
//! ([`super::remote`]), with the same random draws, read-back and referee.

use std::sync::Arc;

use nalgebra::{Isometry3, Vector3};
use robogate_core::{
    Action, Assignment, CameraSpec, Contact, Ending, FEASIBLE, FailureMode, FailureModeSpec, Fault, FaultKind,
    Foresight, Infeasibility, Observation, Scenario, Severity, Start, Step, TaskSpec, vectors,
};
use robogate_physics::{
    ArmState, Chain, Engine, Fixture, GripperCommand, Robot, Side, Steering, StepView, Touches, Wrench, pose,
};

use super::forces::{self, Forces, STRUCK, Wrist};
use super::rules::{Bodies, Found, Resolved, Rules, Sight, Trial};
use super::settings::{WristSensor, on_robot};
use super::table::is_of_missing_joint;
use super::{CONTROL_PERIOD_S, HasSettings, mode, observation};
use crate::settings::setting_specs;

/// Largest clearance that is measured, in metres.
pub(crate) const CLEARANCE_LIMIT_M: f64 = 0.25;

/// An arm is at rest if no joint is faster than this, in rad/s.
const STILL_JOINT_SPEED: f64 = 2e-3;

/// The outcome is certain if arm and parts have been at rest for this many control periods.
const STILL_TICKS: u32 = 8;

/// The judge of a task on a robot.
pub(crate) struct Judge {
    rules: Arc<dyn Rules>,
    robot: Robot,
    chain: Chain,
    grip_force_n: f64,
    /// The limit of contact forces, in newtons. `None` without one.
    force_limit_n: Option<f64>,
    task: Arc<TaskSpec>,
    foresight: Option<Arc<dyn Foresight>>,
    episode: Option<Episode>,
}

/// The running episode.
struct Episode {
    trial: Box<dyn Trial>,
    forces: Forces,
    bias: Vec<f64>,
    fixtures: Vec<Fixture>,
    steering: Steering,
    /// Joint positions as the encoders measure them, in radians.
    measured: Vec<f64>,
    gripper: GripperCommand,
    /// The sensor at the wrist, if the robot has one.
    wrist: Option<Wrist>,
    ticks: u64,
    /// Number of control periods for which arm and parts have been at rest.
    still_ticks: u32,
    /// 1 if some policy may complete the scenario, otherwise 0.
    feasible: f64,
}

impl Judge {
    /// The judge under these rules, for a gripper that holds with `grip_force_n` newtons and cameras of these sizes.
    pub(crate) fn new<T: Rules + HasSettings + 'static>(
        rules: &T,
        (robot, chain): (Robot, Chain),
        grip_force_n: f64,
        cameras: Vec<CameraSpec>,
    ) -> Self {
        let settings = setting_specs(&rules.rows(), rules.defaults(), rules).into_iter();
        let settings = settings.filter_map(|spec| on_robot(spec, &robot, grip_force_n));
        let force_limit_n = rules.limits_forces().then(|| forces::limit_n(&robot, rules.arm().contact_force_limit_n));
        let joints = robot.settings.arm.joints.len();
        let mut parameters = rules.parameters().specs(&robot.settings.gripper);
        parameters.retain(|parameter| !is_of_missing_joint(&parameter.name, joints));
        let mut task = TaskSpec {
            time_limit_s: rules.arm().time_limit_s,
            parameters,
            settings: settings.collect(),
            ..rules.spec(&robot, cameras)
        };
        if rules.arm().wrist_sensor == WristSensor::On {
            task.observation.vectors.push(Wrist::spec());
        }
        task.measures.extend(forces::force_measures(&robot, force_limit_n.is_some()));
        if let Some(limit_n) = force_limit_n {
            let meaning =
                format!("A contact of the robot had more than {limit_n} N, or more than that and the grip force.");
            // Before the timeout, which is always last.
            let struck = mode(STRUCK, Severity::Critical, &meaning);
            let struck = FailureModeSpec { published_as: Some(FailureMode::TIMEOUT), ..struck };
            task.failure_modes.insert(task.failure_modes.len() - 1, struck);
        }
        let foresight = rules.foresight(&robot, &chain, grip_force_n);
        let rules = Arc::new(rules.clone());
        Self { rules, robot, chain, grip_force_n, force_limit_n, task: Arc::new(task), foresight, episode: None }
    }

    /// Another judge of the same task, without an episode.
    #[cfg(feature = "mujoco")]
    pub(crate) fn another(&self) -> Self {
        Self {
            rules: Arc::clone(&self.rules),
            robot: self.robot.clone(),
            chain: self.chain.clone(),
            grip_force_n: self.grip_force_n,
            force_limit_n: self.force_limit_n,
            task: Arc::clone(&self.task),
            foresight: self.foresight.clone(),
            episode: None,
        }
    }

    /// The task.
    pub(crate) fn task(&self) -> &Arc<TaskSpec> {
        &self.task
    }

    /// The knowledge about episodes before they run, if there is any.
    pub(crate) fn foresight(&self) -> Option<Arc<dyn Foresight>> {
        self.foresight.clone()
    }

    pub(crate) fn robot(&self) -> &Robot {
        &self.robot
    }

    pub(crate) fn chain(&self) -> &Chain {
        &self.chain
    }

    /// The reason why no policy can complete a scenario, if it is known.
    pub(crate) fn infeasibility(&self, requested: &Assignment) -> Option<Infeasibility> {
        self.rules.infeasibility(requested, &self.robot, self.grip_force_n)
    }

    /// Resolves the scene that a plant must set up for a scenario. Ends the running episode.
    pub(crate) fn resolve(&mut self, scenario: &Scenario) -> Result<Resolved, Fault> {
        self.episode = None;
        self.rules.resolve(scenario, &self.robot, self.grip_force_n)
    }

    /// Starts the episode in a scene that a plant has set up. `touches` and `arm_state` are the initial ones.
    pub(crate) fn start(
        &mut self,
        scenario: &Scenario,
        resolved: Resolved,
        found: &Found<'_>,
        touches: &Touches,
        arm_state: ArmState,
    ) -> Result<Start, Fault> {
        if touches.collision.is_some() || touches.body_on_object || touches.fingers.iter().any(Option::is_some) {
            return Err(Fault::new(FaultKind::Setup, "the robot starts in contact"));
        }
        let Resolved { scene, bias, instance, trial, .. } = resolved;
        let applied = trial.applied(&scenario.requested, found, &bias);
        let mut episode = Episode {
            trial,
            // The gripper of this unit may be stronger than the model's.
            forces: Forces::new(self.force_limit_n, found.grip_force_scale.unwrap_or(1.0) * self.grip_force_n),
            bias,
            fixtures: scene.fixtures,
            steering: Steering::default(),
            measured: Vec::new(),
            gripper: GripperCommand::Open,
            wrist: (self.rules.arm().wrist_sensor == WristSensor::On).then(Wrist::default),
            ticks: 0,
            still_ticks: 0,
            feasible: if self.infeasibility(&scenario.requested).is_none() { 1.0 } else { 0.0 },
        };
        let observation = episode.observation(arm_state, &self.chain);
        self.episode = Some(episode);
        Ok(Start { instance, observation, applied })
    }

    /// Joint positions (rad) to which a plant must drive the arm in the next control period.
    pub(crate) fn command(&mut self, action: &Action) -> Result<Vec<f64>, Fault> {
        let Some(episode) = &mut self.episode else { return Err(no_episode()) };
        let home = &self.robot.settings.arm.home_rad;
        let wanted = episode.steering.joints(&action.command, &episode.measured, &self.chain, home)?;
        episode.gripper = GripperCommand::of(action);
        // The servo closes its loop on the encoders, so the true joint positions are off by the bias.
        Ok(wanted.iter().zip(&episode.bias).map(|(q, bias)| q - bias).collect())
    }

    /// The free body that the gripper acts on in the next control period, with the tool at `tcp`. `None` keeps it.
    pub(crate) fn select(&mut self, tcp: &Isometry3<f64>, bodies: &dyn Bodies) -> Option<usize> {
        let episode = self.episode.as_mut()?;
        episode.trial.select(episode.gripper, tcp, bodies)
    }

    /// Observes one time step of the running control period.
    pub(crate) fn observe(&mut self, view: &StepView<'_>, bodies: &dyn Bodies) {
        let Some(episode) = &mut self.episode else { return };
        let time = (episode.ticks as f64 + view.fraction) * CONTROL_PERIOD_S;
        let sight = Sight { time, command: episode.gripper, view, bodies };
        episode.trial.observe(&sight);
        episode.forces.feel(&sight, episode.trial.record());
        if let (Some(wrist), Some(wrench)) = (&mut episode.wrist, bodies.hand_wrench()) {
            wrist.feel(&wrench);
        }
    }

    /// The clearance (m) at or above which no measure changes. `None` if the task does not measure it.
    pub(crate) fn clearance_bound(&self) -> Option<f64> {
        self.episode.as_ref().and_then(|episode| episode.trial.clearance_bound())
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
        let Some(episode) = &mut self.episode else { return Err(no_episode()) };
        episode.ticks += 1;
        let arm_rests = arm_state.joint_velocities.iter().all(|speed| speed.abs() < STILL_JOINT_SPEED);
        episode.still_ticks = if arm_rests && episode.trial.at_rest() { episode.still_ticks + 1 } else { 0 };
        if let Some(clearance) = clearance {
            episode.trial.note_clearance(clearance);
        }
        let observation = episode.observation(arm_state, &self.chain);
        let over = (episode.ticks + 1) as f64 * CONTROL_PERIOD_S > self.task.time_limit_s + 0.5 * CONTROL_PERIOD_S;
        let ruling = episode.trial.record().ruling();
        let decided = ruling.map(|ruling| {
            let name = |index: usize| episode.fixtures.get(index).map_or_else(String::new, |it| it.name.clone());
            let contact = ruling.collision.map(|collision| Contact {
                robot_body: body(collision.robot_body),
                other_body: collision.hit.name(name, &body),
                force_n: collision.force,
            });
            Ending { failure: ruling.failure, time_s: ruling.time_s, contact }
        });
        let mut measures = episode.trial.measures();
        episode.forces.measure(&mut measures);
        measures.set(FEASIBLE, Some(episode.feasible));
        let step = Step {
            observation,
            events: episode.trial.record().take_events(),
            measures,
            ending: decided.or_else(|| over.then(|| episode.at_limit(&self.task))),
            state_hash,
        };
        if step.ending.is_some() {
            self.episode = None;
        }
        Ok(step)
    }

    /// The ending at the time limit, if it is certain for a policy that repeats its last action: arm and parts are at
    /// rest, and no other body will move.
    pub(crate) fn foregone_ending(&self) -> Option<Ending> {
        let episode = self.episode.as_ref()?;
        let now = episode.ticks as f64 * CONTROL_PERIOD_S;
        // A body that has just stopped may have pushed something.
        let settling_s = f64::from(STILL_TICKS) * CONTROL_PERIOD_S;
        let moves = |fixture: &Fixture| fixture.motion.is_some_and(|motion| motion.ends_s() + settling_s > now);
        let certain = episode.still_ticks >= STILL_TICKS && !episode.fixtures.iter().any(moves);
        certain.then(|| episode.at_limit(&self.task))
    }

    /// Ends the running episode without a result.
    pub(crate) fn abandon(&mut self) {
        self.episode = None;
    }
}

fn no_episode() -> Fault {
    Fault::new(FaultKind::Setup, "no episode is running")
}

impl Episode {
    /// The ending of an episode that reaches the time limit in the present state.
    fn at_limit(&self, task: &TaskSpec) -> Ending {
        Ending { failure: Some(self.trial.mode_at_limit()), time_s: task.time_limit_s, contact: None }
    }

    /// The observation of an arm, with the encoders' bias.
    fn observation(&mut self, arm_state: ArmState, chain: &Chain) -> Observation {
        self.measured = arm_state.joint_positions.iter().zip(&self.bias).map(|(q, bias)| q + bias).collect();
        let tool = pose(&chain.tcp_at(&self.measured));
        let measured = ArmState { joint_positions: self.measured.clone(), ..arm_state };
        let mut seen = observation(self.ticks as f64 * CONTROL_PERIOD_S, measured, tool);
        seen.vectors.extend(self.wrist.as_mut().map(|wrist| (vectors::WRIST_WRENCH, wrist.take())));
        seen
    }
}

impl Bodies for Box<dyn Engine> {
    fn pose(&self, body: usize) -> Isometry3<f64> {
        self.free_body(body)
    }

    fn velocity(&self, body: usize) -> (Vector3<f64>, Vector3<f64>) {
        self.free_body_velocity(body)
    }

    fn support(&self) -> Vector3<f64> {
        Engine::support(&**self).force
    }

    fn hand_wrench(&self) -> Option<Wrench> {
        Engine::hand_wrench(&**self)
    }

    fn joint(&self, body: usize) -> Option<[f64; 2]> {
        self.body_joint(body)
    }

    fn force_between(&self, one: Side, other: Side) -> Option<f64> {
        Engine::force_between(&**self, one, other)
    }
}
