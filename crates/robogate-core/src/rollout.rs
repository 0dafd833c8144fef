//! The [`Environment`] and [`Policy`] traits, and the loop that runs an episode.

use std::sync::Arc;

use crate::{
    Action, Assignment, Contact, Episode, FailureMode, Fault, FaultKind, Foresight, Image, Infeasibility, Measures,
    Observation, Outcome, Scenario, Seed, TaskInstance, TaskSpec, Trajectory, Word,
};

/// The result of a reset.
#[derive(Debug, Clone, PartialEq)]
pub struct Start {
    /// Information about this episode that the policy may use.
    pub instance: TaskInstance,
    /// The first observation.
    pub observation: Observation,
    /// The parameters read back after they were set.
    pub applied: Assignment,
}

/// The result of one step.
#[derive(Debug, Clone, PartialEq)]
pub struct Step {
    /// The next observation.
    pub observation: Observation,
    /// Measurements up to now.
    pub measures: Measures,
    /// The decisive event, if there was one.
    pub ending: Option<Ending>,
    /// Events in this step, for the timeline of a replay.
    pub events: Vec<String>,
    /// Hash of the environment's full state.
    pub state_hash: u64,
}

/// The decisive event of an episode.
#[derive(Debug, Clone, PartialEq)]
pub struct Ending {
    /// The failure mode. `None` means success.
    pub failure: Option<FailureMode>,
    /// Simulated time of the event, in seconds.
    pub time_s: f64,
    /// The contact that decided the outcome, if there was one.
    pub contact: Option<Contact>,
}

/// The measure with the simulated time at which the policy gave up ([`Policy::gave_up`]), in seconds. The rollout records
/// it for tasks that declare it.
pub const GAVE_UP: Word = Word::constant("gave_up_s");

/// A world in which a policy performs a task.
pub trait Environment {
    /// The task. It is the same for every episode.
    fn task(&self) -> &Arc<TaskSpec>;

    /// The knowledge of the task about an episode before it runs. `None` if the task has none.
    fn foresight(&self) -> Option<Arc<dyn Foresight>> {
        None
    }

    /// The hidden draws of the episode of this scenario, after its reset. Empty where nothing is known about them.
    fn draws(&self, scenario: &Scenario) -> Result<Measures, Fault> {
        self.foresight().map_or_else(|| Ok(Measures::default()), |foresight| foresight.draws(scenario))
    }

    /// Sets up a scenario. A second call starts over, independent of earlier episodes.
    fn reset(&mut self, scenario: &Scenario) -> Result<Start, Fault>;

    /// Runs one control period.
    fn step(&mut self, action: &Action) -> Result<Step, Fault>;

    /// The reason why no policy can complete a scenario with these requested parameters, if the task knows one. It must
    /// hold for every policy: a scenario that is only hard is feasible.
    fn infeasibility(&self, _requested: &Assignment) -> Option<Infeasibility> {
        None
    }

    /// The ending that the episode will have if the policy repeats its last action until the time limit. `None` if this
    /// is still uncertain, for example because a body moves. The rollout ends an episode early only with this ending,
    /// and only if the policy gave up: the outcome is that of the whole episode.
    fn foregone_ending(&self) -> Option<Ending> {
        None
    }

    /// Renders the cameras in the current state. Rendering does not change the episode.
    fn render(&mut self) -> Result<Vec<Image>, Fault> {
        Err(Fault::new(FaultKind::Setup, "this environment has no cameras"))
    }

    /// Renders these cameras only, for a film of the episode: the final state may be rendered too. A remote environment
    /// renders nothing else, which may save much time.
    fn render_only(&mut self, cameras: &[&str]) -> Result<Vec<Image>, Fault> {
        let mut images = self.render()?;
        images.retain(|image| cameras.contains(&image.camera.as_str()));
        Ok(images)
    }

    /// Records the motion of all bodies in every later episode: one frame per `period_s` seconds of simulated time, at
    /// the start and at the end. `None` stops recording. Recording does not change the episode.
    fn record_trajectory(&mut self, _period_s: Option<f64>) {}

    /// Takes the trajectory of the last episode. `None` if the environment has no geometry, or did not record it.
    fn take_trajectory(&mut self) -> Option<Trajectory> {
        None
    }
}

/// A policy that drives the robot.
pub trait Policy {
    /// Checks that the policy can drive this task. The error names the missing capability. Called once, before any
    /// episode.
    fn check(&self, task: &TaskSpec) -> Result<(), String>;

    /// Starts an episode and clears all state of the previous one. `seed` is the source of the policy's randomness.
    fn reset(&mut self, task: &TaskSpec, instance: &TaskInstance, seed: Seed) -> Result<(), Fault>;

    /// Whether the next call of [`Policy::act`] uses images. Without images, or in the middle of a chunk of actions,
    /// the environment skips rendering.
    fn wants_images(&self) -> bool {
        false
    }

    /// Returns the next action.
    fn act(&mut self, observation: &Observation) -> Result<Action, Fault>;

    /// Whether the policy has given up: while its observations stay the same, it repeats the action of the last call of
    /// [`Policy::act`] until the time limit. A policy that may still act differently must return `false`.
    fn gave_up(&self) -> bool {
        false
    }

    /// Notes what is observed in a control period, for a policy that sees earlier observations. Called in each control
    /// period of an episode with latency, before [`Policy::predict`]. Without latency, [`Policy::act`] takes its place.
    fn observe(&mut self, _observation: &Observation) -> Result<(), Fault> {
        Ok(())
    }

    /// Whether [`Policy::observe`] needs the images of each control period.
    fn observes_images(&self) -> bool {
        false
    }

    /// Computes the next actions from one observation and executes none of them. A policy without chunks of actions
    /// computes one.
    fn predict(&mut self, observation: &Observation) -> Result<Prediction, Fault> {
        Ok(Prediction { steps: vec![PredictedStep::Action(self.act(observation)?)], execute: 1, periods: 1 })
    }

    /// Returns the command of the next control period for a step of a prediction: for a new one, or for the present one
    /// if `step` is `None` and a step takes several periods.
    fn perform(&mut self, step: Option<&[f64]>, _observation: &Observation) -> Result<Action, Fault> {
        let numbers = step.map_or(0, <[f64]>::len);
        Err(Fault::new(
            FaultKind::BadAction,
            format!("this policy predicts no vectors, but was given {numbers} numbers"),
        ))
    }
}

/// Actions that a policy computes from one observation.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Prediction {
    /// The steps, from the time of the observation on.
    pub steps: Vec<PredictedStep>,
    /// The number of steps that are executed if the robot waits for the policy.
    pub execute: usize,
    /// The number of control periods that a step takes.
    pub periods: u32,
}

/// A step of a prediction.
#[derive(Debug, Clone, PartialEq)]
pub enum PredictedStep {
    /// An action of the task.
    Action(Action),
    /// The numbers of a model. [`Policy::perform`] converts them when they are executed.
    Numbers(Vec<f64>),
}

/// One control period, as an observer sees it.
#[derive(Debug)]
pub struct Tick<'a> {
    /// The observation that the policy received.
    pub observation: &'a Observation,
    /// The action that the policy returned.
    pub action: &'a Action,
    /// The resulting step.
    pub step: &'a Step,
}

/// Runs one episode. It always returns a record: a fault becomes [`Outcome::Invalid`].
pub fn rollout(environment: &mut dyn Environment, policy: &mut dyn Policy, scenario: &Scenario) -> Episode {
    rollout_with(environment, policy, scenario, &mut |_| {})
}

/// Runs an episode like [`rollout`], with an observer that is called after every control period.
pub fn rollout_with(
    environment: &mut dyn Environment,
    policy: &mut dyn Policy,
    scenario: &Scenario,
    observer: &mut dyn FnMut(Tick<'_>),
) -> Episode {
    let mut episode = Episode {
        scenario: scenario.clone(),
        applied: Assignment::default(),
        outcome: Outcome::Failure(FailureMode::TIMEOUT),
        time_s: 0.0,
        phase: None,
        contact: None,
        measures: Measures::default(),
        draws: Measures::default(),
        ticks: 0,
        trajectory_hash: HASH_START,
    };
    if let Err(fault) = drive(environment, policy, &mut episode, observer) {
        episode.outcome = Outcome::Invalid(fault);
    }
    episode
}

fn drive(
    environment: &mut dyn Environment,
    policy: &mut dyn Policy,
    episode: &mut Episode,
    observer: &mut dyn FnMut(Tick<'_>),
) -> Result<(), Fault> {
    let task = Arc::clone(environment.task());
    let Start { instance, mut observation, applied } = environment.reset(&episode.scenario)?;
    episode.applied = applied;
    check_applied(&episode.scenario.requested, &episode.applied)?;
    episode.draws = environment.draws(&episode.scenario)?;
    policy.reset(&task, &instance, episode.scenario.seed)?;
    let limit = task.limit_ticks().map_err(|why| Fault::new(FaultKind::Setup, why.to_string()))?;
    let records_giving_up = task.measure(GAVE_UP.as_str()).is_some();
    let mut gave_up_s = None;
    while episode.ticks < limit {
        if policy.wants_images() {
            observation.images = environment.render()?;
        }
        let action = policy.act(&observation)?;
        task.check_action(&action).map_err(|why| Fault::new(FaultKind::BadAction, why))?;
        let mut step = environment.step(&action)?;
        if gave_up_s.is_none() && policy.gave_up() {
            gave_up_s = Some(observation.time_s);
            step.events.push("policy gave up".to_owned());
        }
        if records_giving_up {
            step.measures.set(GAVE_UP, gave_up_s);
        }
        let foregone = if gave_up_s.is_some() { environment.foregone_ending() } else { None };
        observer(Tick { observation: &observation, action: &action, step: &step });
        episode.ticks += 1;
        episode.time_s = step.observation.time_s;
        episode.phase = action.phase;
        episode.measures = step.measures;
        episode.trajectory_hash = chain(episode.trajectory_hash, step.state_hash);
        if let Some(ending) = step.ending.or(foregone) {
            episode.outcome = ending.failure.map_or(Outcome::Success, Outcome::Failure);
            episode.time_s = ending.time_s;
            episode.contact = ending.contact;
            return Ok(());
        }
        observation = step.observation;
    }
    Ok(())
}

const HASH_START: u64 = 0x9e37_79b9_7f4a_7c15;

/// Combines two hashes in an order-dependent way (the finaliser of SplitMix64 over their sum).
fn chain(hash: u64, next: u64) -> u64 {
    let mut z = hash.rotate_left(23).wrapping_add(next).wrapping_add(HASH_START);
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

/// Largest relative difference between a requested and an applied number. Engines that store a quantity in another form
/// (a density, a single-precision mass) return it rounded.
const APPLIED_TOLERANCE: f64 = 1e-6;

/// Below this magnitude the tolerance is absolute: a small offset is computed from a position in single precision.
const APPLIED_FLOOR: f64 = 0.1;

/// Checks that every requested parameter was applied: numbers to single precision, words exactly.
pub fn check_applied(requested: &Assignment, applied: &Assignment) -> Result<(), Fault> {
    for (name, want) in requested.iter() {
        let same = match (requested.number(name), applied.number(name)) {
            (Some(want), Some(got)) => (want - got).abs() <= APPLIED_TOLERANCE * want.abs().max(APPLIED_FLOOR),
            _ => applied.get(name) == Some(want),
        };
        if !same {
            let got = applied.get(name).map_or_else(|| "nothing".to_owned(), ToString::to_string);
            return Err(Fault::new(
                FaultKind::NotApplied,
                format!("requested {name} = {want}, but the environment applied {got}"),
            ));
        }
    }
    Ok(())
}
