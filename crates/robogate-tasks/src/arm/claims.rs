//! Claims about the physics, tested by repeatable experiments.
//!
//! Each experiment creates new simulators and controllers, runs episodes or scenes, and returns its figures and whether the
//! claim holds. The tests of this crate and `robogate check physics` run the same code for every task, robot and engine. A
//! task adds claims of its own to those in this file.

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::sync::Arc;

use robogate_core::{
    Assignment, Command, Design, Environment, Episode, FailureMode, Outcome, ParameterSpace, Policy, Sampler, Scenario,
    Seed, Stream, Value, rollout, rollout_with, samplers,
};
use robogate_physics::{Engine, Gripper, JointTargets, ParallelJaw, Robot, Scene, SuctionCup};

use super::CONTROL_PERIOD_S;

/// An environment and a scripted controller for it.
pub type Bench = (Box<dyn Environment>, Box<dyn Policy>);

/// Settings of a bench.
#[derive(Debug, Clone, PartialEq)]
pub struct Setup {
    /// The robot.
    pub robot: Robot,
    /// The engine's time step in seconds.
    pub time_step_s: f64,
    /// Values of the task's settings; the others have their defaults.
    pub settings: Assignment,
}

/// A factory of benches.
pub trait Workbench {
    /// The default settings of a claim.
    fn setup(&self) -> Setup;

    /// Creates a bench with these settings.
    ///
    /// # Errors
    /// If the task cannot be set up with them.
    fn bench(&self, setup: &Setup) -> Result<Bench, String>;

    /// Creates the engine without the task.
    ///
    /// # Errors
    /// If the engine is in another process.
    fn engine(&self) -> Result<Box<dyn Engine>, String>;
}

/// The result of an experiment.
#[derive(Debug, Clone, PartialEq)]
pub struct ClaimResult {
    /// The claim, in one sentence.
    pub claim: String,
    /// The measured figures, line by line.
    pub figures: Vec<String>,
    /// Whether the claim holds.
    pub holds: bool,
}

impl ClaimResult {
    pub(crate) fn new(claim: impl Into<String>, holds: bool, figures: Vec<String>) -> Self {
        Self { claim: claim.into(), figures, holds }
    }
}

/// A claim about the physics of a task.
#[derive(Debug, Clone, Copy)]
pub struct Claim {
    /// The name on the command line.
    pub name: &'static str,
    /// The number of episodes of the full experiment. An experiment that searches for a threshold ignores it.
    pub episodes: usize,
    experiment: Experiment,
}

/// Runs an experiment with a number of episodes.
type Experiment = fn(&Ground<'_>, usize) -> Result<ClaimResult, String>;

impl Claim {
    pub(crate) const fn new(name: &'static str, episodes: usize, experiment: Experiment) -> Self {
        Self { name, episodes, experiment }
    }

    /// Runs the experiment with this number of episodes. Those that sample a parameter space sample this one.
    ///
    /// # Errors
    /// If the task cannot be set up.
    pub fn check(
        &self,
        workbench: &dyn Workbench,
        space: &Arc<ParameterSpace>,
        episodes: usize,
    ) -> Result<ClaimResult, String> {
        (self.experiment)(&Ground { workbench, space }, episodes)
    }
}

/// What an experiment is made with.
pub(crate) struct Ground<'a> {
    workbench: &'a dyn Workbench,
    space: &'a Arc<ParameterSpace>,
}

impl Ground<'_> {
    pub(crate) fn setup(&self) -> Setup {
        self.workbench.setup()
    }

    /// The gripper.
    pub(crate) fn gripper(&self) -> Gripper {
        self.setup().robot.settings.gripper
    }

    pub(crate) fn engine(&self) -> Result<Box<dyn Engine>, String> {
        self.workbench.engine()
    }

    /// A bench with these settings, which runs one scenario after another.
    pub(crate) fn trials(&self, setup: &Setup) -> Result<Trials, String> {
        self.workbench.bench(setup).map(|bench| Trials { bench, tally: Tally::default() })
    }

    /// Scenarios that are sampled from the parameter space.
    fn design(&self, episodes: usize) -> Result<Design, String> {
        let stream = Seed::campaign(2026).stream("claims/design");
        samplers::Uniform.design(self.space, episodes, stream).map_err(|error| error.to_string())
    }

    /// The tally of an episode for each of these scenarios.
    pub(crate) fn tally(&self, scenarios: impl IntoIterator<Item = Assignment>) -> Result<Tally, String> {
        let mut trials = self.trials(&self.setup())?;
        (0..).zip(scenarios).for_each(|(index, values)| drop(trials.run(index, values)));
        Ok(trials.tally)
    }

    /// The tally of episodes that are sampled from the parameter space, with these settings.
    pub(crate) fn sampled(&self, setup: &Setup, episodes: usize) -> Result<Tally, String> {
        let (design, mut trials) = (self.design(episodes)?, self.trials(setup)?);
        (0..design.len()).for_each(|i| drop(trials.run(i as u64, values(&design, i))));
        Ok(trials.tally)
    }
}

/// A bench with the outcomes of its episodes so far.
pub(crate) struct Trials {
    bench: Bench,
    pub(crate) tally: Tally,
}

impl Trials {
    /// Runs the episode of this index with these parameters.
    pub(crate) fn run(&mut self, index: u64, values: Assignment) -> Episode {
        let (environment, policy) = &mut self.bench;
        let episode = rollout(&mut **environment, &mut **policy, &scenario(index, values));
        self.tally.count(&episode);
        episode
    }
}

fn values(design: &Design, i: usize) -> Assignment {
    design.assignment(i).unwrap_or_default()
}

fn scenario(index: u64, requested: Assignment) -> Scenario {
    Scenario { index, seed: Seed::campaign(2026).episode(index), requested }
}

/// Values of parameters that are numbers.
pub(crate) fn numbers<'a>(pairs: impl IntoIterator<Item = (&'a str, f64)>) -> Assignment {
    pairs.into_iter().map(|(name, value)| (name.into(), Value::Number(value))).collect()
}

/// The random numbers of the episode of this index in the experiment `name`.
pub(crate) fn stream(name: &str, index: u64) -> Stream {
    Seed::campaign(2026).episode(index).stream(name)
}

/// The parallel jaw of a gripper.
pub(crate) fn jaw(gripper: &Gripper) -> Result<&ParallelJaw, String> {
    let other = || format!("this claim applies to fingers, but this gripper is {}", gripper.description());
    gripper.jaw().ok_or_else(other)
}

/// The suction cup of a setup.
pub(crate) fn cup(setup: &mut Setup) -> Result<&mut SuctionCup, String> {
    match &mut setup.robot.settings.gripper {
        Gripper::Suction(cup) => Ok(cup),
        other @ Gripper::ParallelJaw(_) => {
            Err(format!("this claim applies to a suction cup, but this gripper is {}", other.description()))
        }
    }
}

/// The number at which the outcome changes from `holds` at `low` to not at `high`, with these bounds of it after bisection
/// down to `within` of the lower one.
pub(crate) fn threshold(
    mut holds: impl FnMut(f64) -> bool,
    [mut low, mut high]: [f64; 2],
    within: f64,
) -> Result<[f64; 2], String> {
    if !holds(low) || holds(high) {
        return Err(format!("no threshold between {low:.3} and {high:.3}"));
    }
    while high - low > within * low {
        let middle = 0.5 * (low + high);
        *(if holds(middle) { &mut low } else { &mut high }) = middle;
    }
    Ok([low, high])
}

/// Lets a scene run for this time in seconds, with the arm at home and its gripper open.
///
/// # Errors
/// If the engine cannot load the scene, or diverges.
pub(crate) fn let_run(engine: &mut dyn Engine, scene: &Scene, seconds: f64) -> Result<(), String> {
    let settings = &engine.robot().settings;
    let (home, finger) = (settings.arm.home_rad.clone(), settings.gripper.jaw().map_or(0.0, |jaw| 0.5 * jaw.opening_m));
    engine.load(scene, &home).map_err(|fault| fault.to_string())?;
    let targets = JointTargets { velocities: vec![0.0; home.len()], positions: home, finger };
    (0..(seconds / engine.time_step()) as usize).for_each(|_| engine.advance(&targets));
    engine.health().map_err(|fault| fault.to_string())
}

/// The claims of every task for an arm.
pub(crate) const COMMON: [Claim; 2] =
    [Claim::new("time_step", 500, time_step), Claim::new("repeatable", 200, repeatable)];

/// Halving the time step changes at most 2 % of the outcomes over the default space. Modes that published data do not
/// distinguish count as one outcome: the force of a jam, for example, depends on the time step.
fn time_step(ground: &Ground<'_>, episodes: usize) -> Result<ClaimResult, String> {
    let (design, setup) = (ground.design(episodes)?, ground.setup());
    let step = setup.time_step_s;
    let mut coarse = ground.trials(&setup)?;
    let mut fine = ground.trials(&Setup { time_step_s: 0.5 * step, ..setup })?;
    let task = Arc::clone(coarse.bench.0.task());
    let published = |outcome: &Outcome| match outcome {
        Outcome::Failure(mode) => task.published_mode(*mode).as_str().to_owned(),
        other => other.as_str().to_owned(),
    };
    let (mut finer, mut changed, mut verdicts) = (0, 0, 0);
    for i in 0..design.len() {
        let [one, two] = [&mut coarse, &mut fine].map(|trials| trials.run(i as u64, values(&design, i)).outcome);
        finer += usize::from(one.as_str() != two.as_str());
        changed += usize::from(published(&one) != published(&two));
        verdicts += usize::from((one == Outcome::Success) != (two == Outcome::Success));
    }
    let invalid = coarse.tally.invalid + fine.tally.invalid;
    let figure = format!(
        "{} ms compared with {} ms: {changed} of {} outcomes change ({finer} with the finer modes), {verdicts} of them between success and \
         failure, {invalid} invalid",
        1e3 * step,
        500.0 * step,
        design.len()
    );
    let holds = invalid == 0 && changed * 50 <= design.len();
    Ok(ClaimResult::new("halving the time step changes at most 2 % of the outcomes", holds, vec![figure]))
}

/// A scenario gives the same bits after any other scenarios on the same simulator.
fn repeatable(ground: &Ground<'_>, episodes: usize) -> Result<ClaimResult, String> {
    let design = ground.design(episodes)?;
    let mut forward = ground.trials(&ground.setup())?;
    let first: Vec<Episode> = (0..design.len()).map(|i| forward.run(i as u64, values(&design, i))).collect();
    let mut backward = ground.trials(&ground.setup())?;
    let differs = |i: &usize| backward.run(*i as u64, values(&design, *i)) != first[*i];
    let differ = (0..design.len()).rev().filter(differs).count();
    let invalid = forward.tally.invalid;
    let figure =
        format!("{differ} of {} episodes differ when run in reverse order, {invalid} are invalid", design.len());
    let holds = invalid == 0 && differ == 0;
    Ok(ClaimResult::new("an episode has the same bits in any order on any simulator", holds, vec![figure]))
}

/// In the easy region, from which `easy` samples, the controller succeeds in at least 99 of 100 episodes.
pub(crate) fn easy_region(
    ground: &Ground<'_>,
    episodes: usize,
    easy: fn(&Gripper, u64) -> Assignment,
) -> Result<ClaimResult, String> {
    let (gripper, mut trials) = (ground.gripper(), ground.trials(&ground.setup())?);
    let mut figures = Vec::new();
    for index in 0..episodes as u64 {
        let episode = trials.run(index, easy(&gripper, index));
        if episode.outcome != Outcome::Success {
            figures.push(format!("not a success: {}", describe(&episode)));
        }
    }
    let Tally { successes, invalid, .. } = trials.tally;
    figures.insert(0, trials.tally.line());
    let holds = invalid == 0 && successes * 100 >= episodes * 99;
    Ok(ClaimResult::new("in the easy region at least 99 of 100 episodes succeed", holds, figures))
}

/// The arm respects its joints' speed limits, and the controller's commands respect their acceleration limits, in the easy
/// region, from which `easy` samples. (The engine clamps torques to its force range.)
pub(crate) fn joint_limits(
    ground: &Ground<'_>,
    episodes: usize,
    easy: fn(&Gripper, u64) -> Assignment,
) -> Result<ClaimResult, String> {
    let setup = ground.setup();
    let (gripper, arm) = (&setup.robot.settings.gripper, &setup.robot.settings.arm);
    let Trials { bench: (mut simulator, mut policy), mut tally } = ground.trials(&setup)?;
    let (mut speed, mut acceleration) = (vec![0.0_f64; arm.joints.len()], vec![0.0_f64; arm.joints.len()]);
    for index in 0..episodes as u64 {
        let mut commands: Vec<Vec<f64>> = Vec::new();
        let scenario = scenario(index, easy(gripper, index));
        tally.count(&rollout_with(&mut *simulator, &mut *policy, &scenario, &mut |tick| {
            for (most, v) in speed.iter_mut().zip(tick.step.observation.joint_velocities()) {
                *most = most.max(v.abs());
            }
            if let Command::JointPosition(q) = &tick.action.command {
                commands.push(q.clone());
            }
        }));
        for window in commands.windows(3) {
            for (j, most) in acceleration.iter_mut().enumerate() {
                let change = window[2][j] - 2.0 * window[1][j] + window[0][j];
                *most = most.max(change.abs() / (CONTROL_PERIOD_S * CONTROL_PERIOD_S));
            }
        }
    }
    let share =
        |measured: &[f64], limit: &[f64]| measured.iter().zip(limit).map(|(m, l)| m / l).fold(0.0_f64, f64::max);
    let fastest = share(&speed, &arm.velocity_limit_rad_s);
    let strongest = share(&acceleration, &arm.acceleration_limit_rad_s2);
    let figure = format!(
        "largest fraction of a limit over {episodes} episodes: speed {:.0} %, acceleration {:.0} %",
        100.0 * fastest,
        100.0 * strongest
    );
    let holds = tally.invalid == 0 && fastest <= 1.0 && strongest <= 1.0;
    Ok(ClaimResult::new("joint speeds and accelerations stay within the robot's limits", holds, vec![figure]))
}

fn describe(episode: &Episode) -> String {
    let mut text = format!("{} at {:.2} s", episode.outcome.as_str(), episode.time_s);
    for (name, value) in episode.scenario.requested.iter() {
        let _ = write!(text, ", {name} = {value:.4}");
    }
    text
}

/// The outcomes of episodes.
#[derive(Debug, Default)]
pub(crate) struct Tally {
    pub(crate) episodes: usize,
    pub(crate) successes: usize,
    pub(crate) invalid: usize,
    pub(crate) failures: BTreeMap<FailureMode, usize>,
}

impl Tally {
    fn count(&mut self, episode: &Episode) {
        self.episodes += 1;
        match &episode.outcome {
            Outcome::Success => self.successes += 1,
            Outcome::Failure(mode) => *self.failures.entry(*mode).or_default() += 1,
            Outcome::Invalid(_) => self.invalid += 1,
        }
    }

    pub(crate) fn line(&self) -> String {
        let mut line = format!("{} of {} succeed", self.successes, self.episodes);
        for (mode, count) in &self.failures {
            let _ = write!(line, ", {count} {mode}");
        }
        if self.invalid > 0 {
            let _ = write!(line, ", {} invalid", self.invalid);
        }
        line
    }
}
