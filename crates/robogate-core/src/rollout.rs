//! What runs an episode: the two traits and the loop between them.

use serde::{Deserialize, Serialize};

use crate::{Assignment, Contact, Episode, FailureMode, Fault, FaultKind, Measures, Outcome, Pose, Scenario, Seed};

/// What the policy is told about the task. Nominal: what a cell's engineer would know beforehand,
/// not what the episode's noise made of it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct TaskSpec {
    /// The task in words, for language-conditioned policies.
    pub instruction: String,
    /// Time between two actions, in seconds.
    pub control_period_s: f64,
    /// The episode is a timeout from here on, in simulated seconds.
    pub time_limit_s: f64,
    /// The object's shape.
    pub shape: String,
    /// The object's bounding box in its own frame (x, y, z), in metres.
    pub object_extent_m: [f64; 3],
    /// The nominal pose of the centre of the object's bounding box.
    pub object_pose: Pose,
    /// Where the bounding box's centre shall come to rest.
    pub target_pose: Pose,
    /// Success means at rest within this horizontal distance of the target, in metres.
    pub tolerance_m: f64,
    /// How fast the tool may come down to the object, in m/s; `None` leaves it to the policy.
    pub approach_speed_m_s: Option<f64>,
}

/// What the policy sees. Joint positions are measured ones: an encoder bias is in them.
#[derive(Debug, Clone, PartialEq)]
pub struct Observation {
    /// Simulated time since the start, in seconds.
    pub time_s: f64,
    /// Measured joint positions, in radians (metres for a sliding joint).
    pub joint_positions: Vec<f64>,
    /// Measured joint velocities, per second.
    pub joint_velocities: Vec<f64>,
    /// Opening between the fingers, in metres; `None` for a gripper without fingers (a suction
    /// cup tells nothing: whether it holds shows when the arm lifts).
    pub gripper_opening_m: Option<f64>,
    /// Pose of the tool centre point at the measured joint positions.
    pub tool_pose: Pose,
    /// What the cameras show; empty unless the policy [looks](Policy::looks).
    pub images: Vec<Image>,
}

/// A camera's picture.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Image {
    /// The camera's name.
    pub camera: String,
    /// Pixels in a row.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Red, green and blue (sRGB, 8 bits each) of each pixel, row by row from the top left:
    /// `3 x width x height` bytes.
    pub rgb: Vec<u8>,
}

/// What the arm shall do until the next action.
#[derive(Debug, Clone, PartialEq)]
pub enum ArmCommand {
    /// Be at these measured joint positions at the end of the control period.
    JointPositions(Vec<f64>),
    /// Move the tool centre point by so much from where it was last sent to.
    ToolDelta {
        /// Way along the axes of the base frame, in metres.
        translation_m: [f64; 3],
        /// Turn about the axes of the base frame, as a rotation vector (axis times angle) in radians.
        rotation_rad: [f64; 3],
    },
}

/// What the gripper shall do.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum GripperCommand {
    /// Open fully, or let go.
    Open,
    /// Close with the set force, or take hold.
    Close,
}

/// The phases of the scripted pick-and-place controller (paper, section 4.1).
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "SCREAMING_SNAKE_CASE")]
pub enum Phase {
    /// Moving to the point above the object.
    ApproachAbove,
    /// Going straight down to the grasp.
    Descend,
    /// Closing the gripper.
    Grasp,
    /// Going straight up.
    Lift,
    /// Carrying to the target and down to the table.
    MoveToTarget,
    /// Opening and backing off.
    Release,
}

impl Phase {
    /// Every phase, in order.
    pub const ALL: [Self; 6] =
        [Self::ApproachAbove, Self::Descend, Self::Grasp, Self::Lift, Self::MoveToTarget, Self::Release];

    /// The phase's word in data and reports.
    pub fn word(self) -> &'static str {
        match self {
            Self::ApproachAbove => "APPROACH_ABOVE",
            Self::Descend => "DESCEND",
            Self::Grasp => "GRASP",
            Self::Lift => "LIFT",
            Self::MoveToTarget => "MOVE_TO_TARGET",
            Self::Release => "RELEASE",
        }
    }
}

/// What a policy answers to an observation.
#[derive(Debug, Clone, PartialEq)]
pub struct Action {
    /// For the arm.
    pub arm: ArmCommand,
    /// For the gripper.
    pub gripper: GripperCommand,
    /// What the policy says it is doing: recorded, never judged.
    pub phase: Option<Phase>,
}

/// What a simulator answers to a reset.
#[derive(Debug, Clone, PartialEq)]
pub struct Start {
    /// The task as the policy may know it.
    pub task: TaskSpec,
    /// The first observation.
    pub observation: Observation,
    /// The parameters read back after they were applied.
    pub applied: Assignment,
}

/// What a simulator answers to an action.
#[derive(Debug, Clone, PartialEq)]
pub struct Step {
    /// What the policy sees next.
    pub observation: Observation,
    /// Measurements so far.
    pub measures: Measures,
    /// The decisive event, once there was one.
    pub ending: Option<Ending>,
    /// What happened in this step, in words for the story of a replay.
    pub events: Vec<String>,
    /// Hash of the simulator's full state.
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

/// A world in which an episode runs.
pub trait Simulator {
    /// Sets the scenario up. Calling it again starts over, whatever happened before.
    fn reset(&mut self, scenario: &Scenario) -> Result<Start, Fault>;

    /// Runs one control period.
    fn step(&mut self, action: &Action) -> Result<Step, Fault>;

    /// What the cameras show now. It changes nothing: an episode is the same whether it is looked at or not.
    fn render(&mut self) -> Result<Vec<Image>, Fault> {
        Err(Fault::new(FaultKind::Setup, "this simulator has no cameras"))
    }
}

/// What drives the robot.
pub trait Policy {
    /// Forgets the last episode and learns of the next. `seed` feeds whatever the policy draws.
    fn reset(&mut self, task: &TaskSpec, seed: Seed) -> Result<(), Fault>;

    /// Whether the next [`Policy::act`] looks at images. A policy that is blind, or is in the middle of
    /// a chunk of actions, spares the simulator the work.
    fn looks(&self) -> bool {
        false
    }

    /// The next action.
    fn act(&mut self, observation: &Observation) -> Result<Action, Fault>;
}

/// One control tick, as an onlooker sees it.
#[derive(Debug)]
pub struct Tick<'a> {
    /// What the policy saw.
    pub observation: &'a Observation,
    /// What the policy asked for.
    pub action: &'a Action,
    /// What came of it.
    pub step: &'a Step,
}

/// Runs one episode. Total: whatever breaks becomes [`Outcome::Invalid`].
pub fn rollout(simulator: &mut dyn Simulator, policy: &mut dyn Policy, scenario: &Scenario) -> Episode {
    rollout_with(simulator, policy, scenario, &mut |_| {})
}

/// [`rollout`] with an onlooker, who sees every control tick and changes nothing.
pub fn rollout_with(
    simulator: &mut dyn Simulator,
    policy: &mut dyn Policy,
    scenario: &Scenario,
    onlooker: &mut dyn FnMut(Tick<'_>),
) -> Episode {
    let mut episode = Episode {
        scenario: scenario.clone(),
        applied: Assignment::default(),
        outcome: Outcome::Failure(FailureMode::Timeout),
        time_s: 0.0,
        phase: None,
        contact: None,
        measures: Measures::default(),
        ticks: 0,
        trajectory_hash: HASH_START,
    };
    if let Err(fault) = drive(simulator, policy, &mut episode, onlooker) {
        episode.outcome = Outcome::Invalid(fault);
    }
    episode
}

fn drive(
    simulator: &mut dyn Simulator,
    policy: &mut dyn Policy,
    episode: &mut Episode,
    onlooker: &mut dyn FnMut(Tick<'_>),
) -> Result<(), Fault> {
    let Start { task, mut observation, applied } = simulator.reset(&episode.scenario)?;
    episode.applied = applied;
    check_applied(&episode.scenario.requested, &episode.applied)?;
    policy.reset(&task, episode.scenario.seed)?;
    // Counted, not summed: sums of a period drift, and the limit would depend on rounding.
    let limit = (task.time_limit_s / task.control_period_s).round();
    if !(1.0..=f64::from(u32::MAX)).contains(&limit) {
        let detail = format!("{} s in periods of {} s is no number of ticks", task.time_limit_s, task.control_period_s);
        return Err(Fault::new(FaultKind::Setup, detail));
    }
    let limit = limit as u32;
    while episode.ticks < limit {
        if policy.looks() {
            observation.images = simulator.render()?;
        }
        let action = policy.act(&observation)?;
        let step = simulator.step(&action)?;
        onlooker(Tick { observation: &observation, action: &action, step: &step });
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

/// Relative difference up to which a number read back counts as the one asked for. Engines that
/// keep a quantity in another form (a density, a single-precision mass) return it rounded.
const APPLIED_TOLERANCE: f64 = 1e-6;

/// Below this size the difference itself counts: a small offset is read out of a position in single precision.
const APPLIED_FLOOR: f64 = 0.1;

/// Whether every parameter that was asked for came back: numbers within a rounding of their kind, words as they were.
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
                format!("asked for {name} = {want}, the simulator has {got}"),
            ));
        }
    }
    Ok(())
}
