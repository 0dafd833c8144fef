//! What runs an episode: the two traits and the loop between them.

use std::sync::Arc;

use crate::{
    Action, Assignment, Contact, Episode, FailureMode, Fault, FaultKind, Image, Measures, Observation, Outcome,
    Scenario, Seed, TaskInstance, TaskSpec,
};

/// What an environment answers to a reset.
#[derive(Debug, Clone, PartialEq)]
pub struct Start {
    /// What is special about this episode, as the policy may know it.
    pub instance: TaskInstance,
    /// The first observation.
    pub observation: Observation,
    /// The parameters read back after they were applied.
    pub applied: Assignment,
}

/// What an environment answers to an action.
#[derive(Debug, Clone, PartialEq)]
pub struct Step {
    /// What the policy sees next.
    pub observation: Observation,
    /// Measurements so far.
    pub measures: Measures,
    /// The decisive event, once there was one.
    pub ending: Option<Ending>,
    /// What happened in this step, for the timeline of a replay.
    pub events: Vec<String>,
    /// Hash of the environment's full state.
    pub state_hash: u64,
}

/// The decisive event of an episode.
#[derive(Debug, Clone, PartialEq)]
pub struct Ending {
    /// `None` is success.
    pub failure: Option<FailureMode>,
    /// When it happened, in simulated seconds.
    pub time_s: f64,
    /// The contact that decided it, where one did.
    pub contact: Option<Contact>,
}

/// A world with a task in it.
pub trait Environment {
    /// The task: the same for every episode.
    fn task(&self) -> &Arc<TaskSpec>;

    /// Sets the scenario up. Calling it again starts over, whatever happened before.
    fn reset(&mut self, scenario: &Scenario) -> Result<Start, Fault>;

    /// Runs one control period.
    fn step(&mut self, action: &Action) -> Result<Step, Fault>;

    /// Renders the cameras as the world is now. It changes nothing: an episode is the same with and without it.
    fn render(&mut self) -> Result<Vec<Image>, Fault> {
        Err(Fault::new(FaultKind::Setup, "this environment has no cameras"))
    }
}

/// What drives the robot.
pub trait Policy {
    /// Whether the policy can drive this task; the error says what it lacks. Asked once, before any episode.
    fn check(&self, task: &TaskSpec) -> Result<(), String>;

    /// Starts the next episode and forgets the last. `seed` feeds all randomness of the policy.
    fn reset(&mut self, task: &TaskSpec, instance: &TaskInstance, seed: Seed) -> Result<(), Fault>;

    /// Whether the next [`Policy::act`] uses images. A policy without cameras, or in the middle of a chunk of
    /// actions, saves the environment the rendering.
    fn wants_images(&self) -> bool {
        false
    }

    /// The next action.
    fn act(&mut self, observation: &Observation) -> Result<Action, Fault>;
}

/// One control tick, as an observer sees it.
#[derive(Debug)]
pub struct Tick<'a> {
    /// What the policy saw.
    pub observation: &'a Observation,
    /// What the policy answered.
    pub action: &'a Action,
    /// What followed.
    pub step: &'a Step,
}

/// Runs one episode. It always returns one: what breaks becomes [`Outcome::Invalid`].
pub fn rollout(environment: &mut dyn Environment, policy: &mut dyn Policy, scenario: &Scenario) -> Episode {
    rollout_with(environment, policy, scenario, &mut |_| {})
}

/// [`rollout`] with an observer, which sees every control tick and changes nothing.
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
    policy.reset(&task, &instance, episode.scenario.seed)?;
    let limit = task.limit_ticks().map_err(|why| Fault::new(FaultKind::Setup, why.to_string()))?;
    while episode.ticks < limit {
        if policy.wants_images() {
            observation.images = environment.render()?;
        }
        let action = policy.act(&observation)?;
        task.check_action(&action).map_err(|why| Fault::new(FaultKind::BadAction, why))?;
        let step = environment.step(&action)?;
        observer(Tick { observation: &observation, action: &action, step: &step });
        episode.ticks += 1;
        episode.time_s = step.observation.time_s;
        episode.phase = action.phase;
        episode.measures = step.measures;
        episode.trajectory_hash = chain(episode.trajectory_hash, step.state_hash);
        if let Some(ending) = step.ending {
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

/// Order-dependent combination of two hashes (the finaliser of SplitMix64 over their sum).
fn chain(hash: u64, next: u64) -> u64 {
    let mut z = hash.rotate_left(23).wrapping_add(next).wrapping_add(HASH_START);
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

/// Relative difference up to which a number read back counts as the requested one. Engines that
/// keep a quantity in another form (a density, a single-precision mass) return it rounded.
const APPLIED_TOLERANCE: f64 = 1e-6;

/// Below this size the difference itself counts: a small offset is read out of a position in single precision.
const APPLIED_FLOOR: f64 = 0.1;

/// Whether every requested parameter was applied: numbers within the rounding of single precision, words exactly.
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
                format!("requested {name} = {want}, the environment has {got}"),
            ));
        }
    }
    Ok(())
}
