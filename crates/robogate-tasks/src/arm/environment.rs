//! A task for an arm as an environment on an engine in this process.

use std::sync::Arc;

use nalgebra::Isometry3;
use robogate_camera::Cameras;
use robogate_core::{
    Action, Assignment, CameraSpec, Contact, Ending, Environment, FailureMode, Fault, FaultKind, Foresight, Image,
    Measures, Observation, Policy, Scenario, Start, Step, TaskInstance, TaskSpec, Trajectory, Word,
};
use robogate_physics::{
    ArmState, Chain, Collision, Engine, GripperCommand, Plant, Readback, Robot, Scene, Steering, StepView, SuctionLaw,
    Visual, pose,
};

use super::{Film, camera_specs, observation, posture, render};

/// Distance to the part within which a suction cup takes hold, in metres.
pub(crate) const GRIP_THRESHOLD_M: f64 = 0.01;

/// Time between two actions, in seconds.
pub(crate) const CONTROL_PERIOD_S: f64 = 0.05;

/// The rules of a task: what [`ArmEnvironment`] needs in addition to engine, drives and cameras. They make it an
/// [`super::ArmTask`].
pub(crate) trait Rules {
    /// The referee of an episode.
    type Trial: Trial + 'static;

    /// The name on the command line, as in the declaration.
    const NAME: &'static str;
    /// A short description.
    const SUMMARY: &'static str;
    /// The parameter space for all grippers, as TOML.
    const SPACE: &'static str;
    /// The name of the built-in suite.
    const SUITE: &'static str;

    /// The scripted controller for a robot with these kinematics.
    fn scripted(robot: Robot, chain: Chain) -> Box<dyn Policy>;

    /// The task specification for this robot with these cameras.
    fn spec(&self, robot: &Robot, cameras: Vec<CameraSpec>) -> TaskSpec;

    /// Resolves a scenario for this robot, whose gripper holds with `grip_force_n` newtons. All random draws are done.
    ///
    /// # Errors
    /// A setup fault if the scenario cannot be set up.
    fn resolve(&self, scenario: &Scenario, robot: &Robot, grip_force_n: f64) -> Result<Resolved<Self::Trial>, Fault>;

    /// The draws and features of episodes on this robot, whose gripper holds with `grip_force_n` newtons.
    fn foresight(&self, robot: &Robot, chain: &Chain, grip_force_n: f64) -> Arc<dyn Foresight>;
}

/// Everything about an episode that is fixed before it starts.
pub(crate) struct Resolved<T> {
    /// The scene that the engine loads.
    pub(crate) scene: Scene,
    /// Bias of each joint's encoder: measured minus true position, in radians.
    pub(crate) bias: Vec<f64>,
    /// The information that the policy receives.
    pub(crate) instance: TaskInstance,
    /// The referee.
    pub(crate) trial: T,
}

/// The referee of one episode. The first decisive event ends it.
pub(crate) trait Trial {
    /// The applied values of the requested parameters, from the state of engine and cameras.
    fn applied(&self, requested: &Assignment, engine: &Readback, visual: &Visual, bias: &[f64]) -> Assignment;

    /// The free body that the gripper acts on in the next control period, with the tool at `tcp` and all free bodies.
    fn select(&mut self, command: GripperCommand, tcp: &Isometry3<f64>, bodies: &[Isometry3<f64>]) -> usize;

    /// Observes one time step.
    fn observe(&mut self, sight: &Sight<'_>);

    /// Vectors that the policy observes in addition to those of the arm, at the end of a control period.
    fn sensed(&mut self) -> Vec<(Word, Vec<f64>)>;

    /// The measures so far.
    fn measures(&self) -> Measures;

    /// What it has decided and reported so far.
    fn record(&mut self) -> &mut Record;
}

/// What a referee has decided and reported so far.
#[derive(Debug, Default)]
pub(crate) struct Record {
    ruling: Option<Ruling>,
    events: Vec<String>,
}

impl Record {
    /// Reports an event.
    pub(crate) fn note(&mut self, event: impl Into<String>) {
        self.events.push(event.into());
    }

    /// Ends the episode, unless an earlier event has ended it. `failure` is `None` for success.
    pub(crate) fn end(&mut self, failure: Option<FailureMode>, time_s: f64, collision: Option<Collision>) {
        self.ruling.get_or_insert(Ruling { failure, time_s, collision });
    }

    /// Whether the decisive event has happened.
    pub(crate) fn is_over(&self) -> bool {
        self.ruling.is_some()
    }
}

/// The state that a referee gets after one time step.
pub(crate) struct Sight<'a> {
    /// Simulated time after the step, in seconds.
    pub(crate) time: f64,
    /// The gripper command.
    pub(crate) command: GripperCommand,
    /// Gripper, contacts, tool and the selected body.
    pub(crate) view: &'a StepView<'a>,
    /// The engine, for everything else.
    pub(crate) engine: &'a dyn Engine,
}

/// The decisive event of an episode.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Ruling {
    /// The failure mode; `None` for success.
    failure: Option<FailureMode>,
    /// Simulated time, in seconds.
    time_s: f64,
    /// The contact that decided it, if it was a collision.
    collision: Option<Collision>,
}

/// A task for an arm as an environment.
pub(crate) struct ArmEnvironment<R: Rules> {
    rules: R,
    task: Arc<TaskSpec>,
    plant: Plant<Box<dyn Engine>>,
    foresight: Arc<dyn Foresight>,
    /// The cameras, or the reason why the robot cannot be rendered.
    cameras: Result<Cameras, String>,
    /// The recorder of trajectories, if they are recorded.
    film: Option<Film>,
    running: Option<Running<R::Trial>>,
}

/// The running episode.
struct Running<T> {
    trial: T,
    bias: Vec<f64>,
    bodies: usize,
    fixtures: Vec<String>,
    steering: Steering,
    /// Joint positions as the encoders measure them, in radians.
    measured: Vec<f64>,
    ticks: u64,
}

impl<R: Rules> ArmEnvironment<R> {
    /// Creates the task on this engine, see [`super::ArmTask::environment`].
    ///
    /// # Errors
    /// If the control period is not an integer multiple of the engine's time step, or the gripper cannot apply the grip
    /// force.
    pub(crate) fn new(
        rules: R,
        engine: Box<dyn Engine>,
        grip_force_n: Option<f64>,
        suction: SuctionLaw,
        picture_px: usize,
    ) -> Result<Self, String> {
        let plant = Plant::new(engine, CONTROL_PERIOD_S, grip_force_n)?.with_suction(suction);
        let cameras = Cameras::new(plant.engine.robot()).map(|cameras| cameras.with_size(picture_px, picture_px));
        let task = Arc::new(rules.spec(plant.engine.robot(), camera_specs(&cameras)));
        let foresight = rules.foresight(plant.engine.robot(), plant.engine.chain(), plant.grip_force_n());
        Ok(Self { rules, task, plant, foresight, cameras, film: None, running: None })
    }

    /// The engine.
    #[cfg(test)]
    pub(crate) fn engine(&self) -> &dyn Engine {
        &*self.plant.engine
    }
}

impl<R: Rules> Environment for ArmEnvironment<R> {
    fn task(&self) -> &Arc<TaskSpec> {
        &self.task
    }

    fn foresight(&self) -> Option<Arc<dyn Foresight>> {
        Some(Arc::clone(&self.foresight))
    }

    fn reset(&mut self, scenario: &Scenario) -> Result<Start, Fault> {
        self.running = None;
        let Self { rules, plant, cameras, film, .. } = self;
        let Resolved { scene, bias, instance, trial } =
            rules.resolve(scenario, plant.engine.robot(), plant.grip_force_n())?;
        plant.load(&scene, GRIP_THRESHOLD_M)?;
        let mut visual = scene.visual;
        if let Ok(cameras) = cameras {
            cameras.set_up(&scene);
            visual = cameras.visual().unwrap_or(visual);
        }
        if let Some(film) = film {
            film.start(&plant.engine, &scene);
        }
        let touches = plant.engine.touches();
        if touches.collision.is_some() || touches.body_on_object || touches.fingers.iter().any(Option::is_some) {
            return Err(Fault::new(FaultKind::Setup, "the robot starts in contact"));
        }
        let applied = trial.applied(&scenario.requested, &plant.engine.read_back()?, &visual, &bias);
        let mut running = Running {
            trial,
            bias,
            bodies: 1 + scene.others.len(),
            fixtures: scene.fixtures.into_iter().map(|fixture| fixture.name).collect(),
            steering: Steering::default(),
            measured: Vec::new(),
            ticks: 0,
        };
        let observation = running.observation(plant);
        self.running = Some(running);
        Ok(Start { instance, observation, applied })
    }

    fn step(&mut self, action: &Action) -> Result<Step, Fault> {
        let Self { plant, film, .. } = self;
        let mut running = self.running.take().ok_or_else(|| Fault::new(FaultKind::Setup, "no episode is running"))?;
        let home = &plant.engine.robot().settings.arm.home_rad;
        let wanted = running.steering.joints(&action.command, &running.measured, plant.engine.chain(), home)?;
        // The servo closes its loop on the encoders, so the true joint positions are off by the bias.
        let targets: Vec<f64> = wanted.iter().zip(&running.bias).map(|(q, bias)| q - bias).collect();
        let command = GripperCommand::of(action);
        let bodies: Vec<_> = (0..running.bodies).map(|body| plant.engine.free_body(body)).collect();
        plant.select(running.trial.select(command, &plant.engine.tcp(), &bodies));
        let begun = running.ticks as f64;
        plant.run(&targets, command, &mut |engine, view| {
            let time = (begun + view.fraction) * CONTROL_PERIOD_S;
            running.trial.observe(&Sight { time, command, view, engine });
            if let Some(film) = film {
                film.observe(engine, view);
            }
        })?;
        if let Some(film) = film {
            film.end_period(&plant.engine);
        }
        running.ticks += 1;
        let ending = running.trial.record().ruling.map(|ruling| {
            let body = |body: usize| plant.engine.robot_body(body);
            let fixture = |index: usize| running.fixtures.get(index).cloned().unwrap_or_default();
            let contact = ruling.collision.map(|collision| Contact {
                robot_body: body(collision.robot_body),
                other_body: collision.hit.name(fixture, body),
                force_n: collision.force,
            });
            Ending { failure: ruling.failure, time_s: ruling.time_s, contact }
        });
        let step = Step {
            observation: running.observation(plant),
            events: std::mem::take(&mut running.trial.record().events),
            measures: running.trial.measures(),
            state_hash: plant.state_hash(),
            ending,
        };
        if step.ending.is_none() {
            self.running = Some(running);
        }
        Ok(step)
    }

    fn render(&mut self) -> Result<Vec<Image>, Fault> {
        let engine = &self.plant.engine;
        render(&self.cameras, |bodies| posture(engine, bodies))
    }

    fn record_trajectory(&mut self, period_s: Option<f64>) {
        self.film = period_s.map(|period_s| Film::new(period_s, CONTROL_PERIOD_S));
    }

    fn take_trajectory(&mut self) -> Option<Trajectory> {
        self.film.as_mut()?.take(self.cameras.as_ref().ok()?)
    }
}

impl<T: Trial> Running<T> {
    /// The observation of the arm, with the encoders' bias, and what the task senses.
    fn observation(&mut self, plant: &Plant<Box<dyn Engine>>) -> Observation {
        let state = plant.arm_state();
        self.measured = state.joint_positions.iter().zip(&self.bias).map(|(q, bias)| q + bias).collect();
        let tool = pose(&plant.engine.chain().tcp_at(&self.measured));
        let measured = ArmState { joint_positions: self.measured.clone(), ..state };
        let mut observation = observation(self.ticks as f64 * CONTROL_PERIOD_S, measured, tool);
        observation.vectors.extend(self.trial.sensed());
        observation
    }
}

/// The bias of each encoder, drawn uniformly between minus and plus `bound` (rad).
pub(crate) fn encoder_bias(scenario: &Scenario, robot: &Robot, bound: f64) -> Vec<f64> {
    let mut stream = scenario.seed.stream("encoder-bias");
    robot.settings.arm.joints.iter().map(|_| stream.between(-bound, bound)).collect()
}
