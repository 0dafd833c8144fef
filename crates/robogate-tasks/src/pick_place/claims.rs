//! Claims about the physics, tested by repeatable experiments.
//!
//! Each experiment creates new simulators and controllers, runs episodes, and returns its figures and whether the claim
//! holds. The tests of this crate and `robogate check physics` run the same code for every engine.

use std::fmt::Write as _;
use std::sync::Arc;

use robogate_core::{
    Assignment, Design, Environment, Episode, FailureMode, Outcome, ParameterSpace, Policy, Sampler, Scenario, Seed,
    Value, rollout, rollout_with, samplers,
};
use robogate_physics::{GRAVITY, Gripper, ParallelJaw, Robot, SuctionCup, SuctionLaw};
use std::collections::BTreeMap;

use super::spec::{GRIP_LOSS, SLIP, phases};
use super::{Placement, Shape};

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
    fn bench(&self, setup: &Setup) -> Result<Bench, String>;
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

fn scenario(index: u64, values: Assignment) -> Scenario {
    Scenario { index, seed: Seed::campaign(2026).episode(index), requested: values }
}

fn assign(pairs: &[(&str, Value)]) -> Assignment {
    pairs.iter().map(|(name, value)| (Arc::from(*name), value.clone())).collect()
}

/// Claim: the lowest friction coefficient that holds a box follows Coulomb's law.
///
/// Two pads press with F each, so friction carries at most 2 mu F. A box at rest needs m g, so no coefficient below m g
/// / (2 F) holds it. A box lifted with acceleration a needs m (g + a); the limit of 1.25 includes this. The threshold
/// is found by bisection over whole episodes, to 1 %, for each grip force in `sevenths` of the gripper's limit.
pub fn coulomb(workbench: &dyn Workbench, sevenths: &[f64]) -> Result<ClaimResult, String> {
    let mut result = ClaimResult {
        claim: "the lowest friction coefficient that holds a box is between m g / (2 F) and 1.25 m g / (2 F)"
            .to_owned(),
        figures: Vec::new(),
        holds: true,
    };
    let masses = [0.1, 0.5, 1.0, 2.0];
    let limit = jaw(&mut workbench.setup())?.force_limit_n;
    for force in sevenths.iter().map(|sevenths| sevenths / 7.0 * limit) {
        let mut setup = workbench.setup();
        setup.settings.set("grip_force_n", Value::Number(force));
        let (mut simulator, mut policy) = workbench.bench(&setup)?;
        for mass in masses {
            let law = mass * 9.81 / (2.0 * force);
            let mut holds = |ratio: f64| {
                let values = assign(&[
                    ("friction", Value::Number(ratio * law)),
                    ("mass_kg", Value::Number(mass)),
                    ("size_m", Value::Number(0.05)),
                    ("shape", Value::Category("box".into())),
                    ("placement", Value::Category("center_0".into())),
                ]);
                let episode = rollout(&mut *simulator, &mut *policy, &scenario(0, values));
                episode.outcome == robogate_core::Outcome::Success
            };
            let (mut low, mut high) = (0.8, 1.6);
            if holds(low) || !holds(high) {
                result
                    .figures
                    .push(format!("F = {force} N, m = {mass} kg: no threshold between 0.8 and 1.6 x m g / (2 F)"));
                result.holds = false;
                continue;
            }
            while high - low > 0.01 {
                let middle = 0.5 * (low + high);
                *(if holds(middle) { &mut high } else { &mut low }) = middle;
            }
            result.holds &= low >= 0.99 && high <= 1.25;
            result.figures.push(format!(
                "F = {force} N, m = {mass} kg: holds from mu = {:.4}, {high:.3} x m g / (2 F)",
                high * law
            ));
        }
    }
    Ok(result)
}

/// Claim: an object wider than the hand's opening is never picked. (This applies without encoder bias: fingers that are
/// off the equator may pinch the cap of a slightly wider ball.)
pub fn opening(workbench: &dyn Workbench, episodes: usize) -> Result<ClaimResult, String> {
    let (mut simulator, mut policy) = workbench.bench(&workbench.setup())?;
    let mut tally = Tally::default();
    let widest = jaw(&mut workbench.setup())?.opening_m;
    for i in 0..episodes {
        let mut stream = Seed::campaign(2026).episode(i as u64).stream("claims/opening");
        // Shapes whose width across the fingers equals their size. The lump is narrower.
        let shape = [Shape::Box, Shape::Cylinder, Shape::Sphere, Shape::L][i % 4];
        let values = assign(&[
            ("friction", Value::Number(stream.between(0.3, 1.2))),
            ("mass_kg", Value::Number(stream.between(0.05, 0.5))),
            ("size_m", Value::Number(stream.between(1.0001 * widest, 1.5 * widest))),
            ("shape", Value::Category(shape.as_str().into())),
            ("placement", Value::Category(Placement::NAMES[i % 14].into())),
        ]);
        tally.count(&rollout(&mut *simulator, &mut *policy, &scenario(i as u64, values)));
    }
    Ok(ClaimResult {
        claim: format!("an object wider than the opening of {:.0} mm is never picked", 1e3 * widest),
        holds: tally.successes == 0 && tally.invalid == 0,
        figures: vec![tally.line()],
    })
}

/// Claim: in the easy region the controller succeeds in at least 99 of 100 episodes. For a cup this is the region of
/// objects with a flat top that is at least as wide as its lip.
pub fn easy_region(workbench: &dyn Workbench, episodes: usize) -> Result<ClaimResult, String> {
    let (mut simulator, mut policy) = workbench.bench(&workbench.setup())?;
    let cup = workbench.setup().robot.settings.gripper.cup().is_some();
    let mut tally = Tally::default();
    let mut figures = Vec::new();
    for i in 0..episodes {
        let mut stream = Seed::campaign(2026).episode(i as u64).stream("claims/easy");
        // Every shape at every placement; for a cup only shapes with a flat top.
        let (shapes, sizes) = if cup { (&Shape::ALL[..2], [0.05, 0.08]) } else { (&Shape::ALL[..], [0.03, 0.06]) };
        let values = assign(&[
            ("friction", Value::Number(stream.between(0.6, 1.2))),
            ("mass_kg", Value::Number(stream.between(0.05, 0.5))),
            ("com_offset", Value::Number(stream.between(0.0, 0.1))),
            ("size_m", Value::Number(stream.between(sizes[0], sizes[1]))),
            ("ik_noise_rad", Value::Number(0.0)),
            ("obstacles", Value::Integer(0)),
            ("shape", Value::Category(shapes[i % shapes.len()].as_str().into())),
            ("placement", Value::Category(Placement::NAMES[(i / shapes.len()) % 14].into())),
        ]);
        let episode = rollout(&mut *simulator, &mut *policy, &scenario(i as u64, values));
        if tally.count(&episode) != Some(true) {
            figures.push(format!("not a success: {}", describe(&episode)));
        }
    }
    figures.insert(0, tally.line());
    Ok(ClaimResult {
        claim: "in the easy region at least 99 of 100 episodes succeed".to_owned(),
        holds: tally.invalid == 0 && tally.successes * 100 >= tally.episodes * 99,
        figures,
    })
}

/// Claim: a round object neither rotates nor creeps out of the pads. Its centre stays within 4 mm of its first position
/// in the hand, on the whole path to the target.
pub fn no_creep(workbench: &dyn Workbench, episodes: usize) -> Result<ClaimResult, String> {
    let (mut simulator, mut policy) = workbench.bench(&workbench.setup())?;
    jaw(&mut workbench.setup())?;
    let (mut tally, mut most) = (Tally::default(), 0.0_f64);
    for i in 0..episodes {
        let mut stream = Seed::campaign(2026).episode(i as u64).stream("claims/creep");
        let shape = [Shape::Cylinder, Shape::Sphere][i % 2];
        let values = assign(&[
            ("friction", Value::Number(stream.between(0.6, 1.2))),
            ("mass_kg", Value::Number(stream.between(0.1, 0.6))),
            ("size_m", Value::Number(stream.between(0.04, 0.06))),
            ("position_jitter_m", Value::Number(0.003)),
            ("shape", Value::Category(shape.as_str().into())),
            ("placement", Value::Category(Placement::NAMES[(i / 2) % 14].into())),
        ]);
        let episode = rollout(&mut *simulator, &mut *policy, &scenario(i as u64, values));
        tally.count(&episode);
        most = most.max(episode.measures.get(SLIP.as_str()).unwrap_or(f64::INFINITY));
    }
    Ok(ClaimResult {
        claim: "cylinders and balls slip in the hand by less than 4 mm".to_owned(),
        holds: tally.successes == tally.episodes && most < 4e-3,
        figures: vec![tally.line(), format!("largest slip {:.2} mm", 1e3 * most)],
    })
}

/// Claim: halving the time step changes at most 2 % of the outcomes over the default space. Modes that published data do not
/// distinguish count as one outcome: the force of a jam, for example, depends on the time step.
pub fn time_step(
    workbench: &dyn Workbench,
    space: &Arc<ParameterSpace>,
    episodes: usize,
) -> Result<ClaimResult, String> {
    let design = design(space, episodes)?;
    let setup = workbench.setup();
    let step = setup.time_step_s;
    let mut coarse = workbench.bench(&setup)?;
    let mut fine = workbench.bench(&Setup { time_step_s: 0.5 * step, ..setup })?;
    let task = Arc::clone(coarse.0.task());
    let published = |outcome: &Outcome| match outcome {
        Outcome::Failure(mode) => task.published_mode(*mode).as_str().to_owned(),
        other => other.as_str().to_owned(),
    };
    let (mut finer, mut changed, mut verdicts, mut invalid) = (0, 0, 0, 0);
    for i in 0..design.len() {
        let one = run(&mut coarse, &design, i);
        let two = run(&mut fine, &design, i);
        invalid += usize::from(is_invalid(&one) || is_invalid(&two));
        finer += usize::from(one.outcome.as_str() != two.outcome.as_str());
        changed += usize::from(published(&one.outcome) != published(&two.outcome));
        verdicts += usize::from((one.outcome.as_str() == "success") != (two.outcome.as_str() == "success"));
    }
    Ok(ClaimResult {
        claim: "halving the time step changes at most 2 % of the outcomes".to_owned(),
        holds: invalid == 0 && changed * 50 <= design.len(),
        figures: vec![format!(
            "{} ms compared with {} ms: {changed} of {} outcomes change ({finer} with the finer modes), {verdicts} of them between success and \
             failure, {invalid} invalid",
            1e3 * step,
            500.0 * step,
            design.len()
        )],
    })
}

/// Claim: a scenario gives the same bits after any other scenarios on the same simulator.
pub fn repeatable(
    workbench: &dyn Workbench,
    space: &Arc<ParameterSpace>,
    episodes: usize,
) -> Result<ClaimResult, String> {
    let design = design(space, episodes)?;
    let mut forward = workbench.bench(&workbench.setup())?;
    let first: Vec<Episode> = (0..design.len()).map(|i| run(&mut forward, &design, i)).collect();
    let mut backward = workbench.bench(&workbench.setup())?;
    let invalid = first.iter().filter(|episode| is_invalid(episode)).count();
    let differ = (0..design.len()).rev().filter(|i| run(&mut backward, &design, *i) != first[*i]).count();
    Ok(ClaimResult {
        claim: "an episode has the same bits in any order on any simulator".to_owned(),
        holds: invalid == 0 && differ == 0,
        figures: vec![format!(
            "{differ} of {} episodes differ when run in reverse order, {invalid} are invalid",
            design.len()
        )],
    })
}

/// Claim: the arm respects its joints' speed limits, and the controller's commands respect their acceleration limits.
/// (The engine clamps torques to its force range.)
pub fn joint_limits(workbench: &dyn Workbench, episodes: usize) -> Result<ClaimResult, String> {
    let (mut simulator, mut policy) = workbench.bench(&workbench.setup())?;
    let arm = workbench.setup().robot.settings.arm;
    let (speed_limit, acceleration_limit) = (arm.velocity_limit_rad_s, arm.acceleration_limit_rad_s2);
    let mut invalid = 0;
    let (mut speed, mut acceleration) = (vec![0.0_f64; speed_limit.len()], vec![0.0_f64; speed_limit.len()]);
    for i in 0..episodes {
        let values = assign(&[
            ("friction", Value::Number(0.8)),
            ("mass_kg", Value::Number(0.2)),
            ("size_m", Value::Number(0.05)),
            ("shape", Value::Category(Shape::ALL[i % 5].as_str().into())),
            ("placement", Value::Category(Placement::NAMES[i % 14].into())),
        ]);
        let mut commands: Vec<Vec<f64>> = Vec::new();
        let period = 0.05;
        let episode = rollout_with(&mut *simulator, &mut *policy, &scenario(i as u64, values), &mut |tick| {
            for (most, v) in speed.iter_mut().zip(tick.step.observation.joint_velocities()) {
                *most = most.max(v.abs());
            }
            if let robogate_core::Command::JointPosition(q) = &tick.action.command {
                commands.push(q.clone());
            }
        });
        invalid += usize::from(is_invalid(&episode));
        for window in commands.windows(3) {
            for (j, most) in acceleration.iter_mut().enumerate() {
                *most = most.max((window[2][j] - 2.0 * window[1][j] + window[0][j]).abs() / (period * period));
            }
        }
    }
    let share =
        |measured: &[f64], limit: &[f64]| measured.iter().zip(limit).map(|(m, l)| m / l).fold(0.0_f64, f64::max);
    let (fastest, strongest) = (share(&speed, &speed_limit), share(&acceleration, &acceleration_limit));
    Ok(ClaimResult {
        claim: "joint speeds and accelerations stay within the robot's limits".to_owned(),
        holds: invalid == 0 && fastest <= 1.0 && strongest <= 1.0,
        figures: vec![format!(
            "largest fraction of a limit over {episodes} episodes: speed {:.0} %, acceleration {:.0} %",
            100.0 * fastest,
            100.0 * strongest
        )],
    })
}

/// The mass (kg) at which the outcome of an episode changes, to 0.5 %. The object must hold at `low` and not at `high`.
fn threshold(mut holds: impl FnMut(f64) -> bool, mut low: f64, mut high: f64) -> Result<f64, String> {
    if !holds(low) || holds(high) {
        return Err(format!("no threshold between {low:.3} and {high:.3} kg"));
    }
    while high - low > 0.005 * low {
        let middle = 0.5 * (low + high);
        *(if holds(middle) { &mut low } else { &mut high }) = middle;
    }
    Ok(0.5 * (low + high))
}

/// Peak acceleration of the controller's lift, in m/s^2: a straight path of 0.2 m within 1.2 m/s^2, in an integer number of
/// control periods.
const LIFT_M_S2: f64 = 1.155;

/// The largest mass (kg) that the cup of this setup lifts from the table to the transit height, with scaled gravity.
fn heaviest(workbench: &dyn Workbench, setup: &Setup, gravity_scale: f64) -> Result<f64, String> {
    let Some(force) = setup.robot.settings.gripper.cup().map(SuctionCup::force_n) else {
        return Err("the robot has no suction cup".to_owned());
    };
    let (mut simulator, mut policy) = workbench.bench(setup)?;
    let law = force / (gravity_scale * GRAVITY + LIFT_M_S2);
    let lifts = |mass: f64| {
        let values = assign(&[
            ("mass_kg", Value::Number(mass)),
            // High friction ensures that an object lost during the lift is lost by its weight.
            ("friction", Value::Number(2.0)),
            ("gravity_scale", Value::Number(gravity_scale)),
            ("size_m", Value::Number(0.06)),
            ("shape", Value::Category("box".into())),
            ("placement", Value::Category("center_0".into())),
        ]);
        let episode = rollout(&mut *simulator, &mut *policy, &scenario(0, values));
        episode.phase == Some(phases::MOVE_TO_TARGET) || episode.phase == Some(phases::RELEASE)
    };
    threshold(lifts, 0.4 * law, 1.1 * law)
}

/// The setup with a vacuum cup of this suction force in newtons, obtained by its pressure.
fn with_force(workbench: &dyn Workbench, force: f64) -> Result<Setup, String> {
    let mut setup = workbench.setup();
    setup.settings.set("suction", word(SuctionLaw::Vacuum));
    let cup = cup(&mut setup)?;
    cup.vacuum_pa = force / cup.area_m2();
    Ok(setup)
}

/// Claim: a vacuum cup lifts masses up to m (g + a) = p A.
pub fn vacuum_limit(workbench: &dyn Workbench) -> Result<ClaimResult, String> {
    let mut result = ClaimResult {
        claim: "lifted with acceleration a, a vacuum cup holds a mass m up to m (g + a) = p A, within 3 %".to_owned(),
        figures: Vec::new(),
        holds: true,
    };
    for force in [5.0, 15.0] {
        let mass = heaviest(workbench, &with_force(workbench, force)?, 1.0)?;
        let law = force / (GRAVITY + LIFT_M_S2);
        result.holds &= (mass / law - 1.0).abs() <= 0.03;
        result.figures.push(format!("p A = {force} N: up to {mass:.3} kg, {:.3} x p A / (g + a)", mass / law));
    }
    Ok(result)
}

/// Claim: doubling the cup's area doubles the mass that it holds.
pub fn cup_area(workbench: &dyn Workbench) -> Result<ClaimResult, String> {
    let small = with_force(workbench, 6.0)?;
    let mut large = small.clone();
    cup(&mut large)?.cup_diameter_m *= std::f64::consts::SQRT_2;
    let (one, two) = (heaviest(workbench, &small, 1.0)?, heaviest(workbench, &large, 1.0)?);
    Ok(ClaimResult {
        claim: "doubling a vacuum cup's area doubles the mass that it lifts, within 4 %".to_owned(),
        holds: (0.5 * two / one - 1.0).abs() <= 0.04,
        figures: vec![format!("{one:.3} kg, then {two:.3} kg: {:.3} x", two / one)],
    })
}

/// Claim: doubling gravity changes the mass that a vacuum cup lifts to (g + a) / (2 g + a).
pub fn gravity(workbench: &dyn Workbench) -> Result<ClaimResult, String> {
    let setup = with_force(workbench, 10.0)?;
    let (one, two) = (heaviest(workbench, &setup, 1.0)?, heaviest(workbench, &setup, 2.0)?);
    let law = (GRAVITY + LIFT_M_S2) / (2.0 * GRAVITY + LIFT_M_S2);
    Ok(ClaimResult {
        claim: "doubling gravity reduces the mass that a vacuum cup lifts to (g + a) / (2 g + a), within 4 %"
            .to_owned(),
        holds: (two / one / law - 1.0).abs() <= 0.04,
        figures: vec![format!("{one:.3} kg, then {two:.3} kg: {:.3} x. Expected {law:.3} x", two / one)],
    })
}

/// Claim: a surface gripper never loses an object of any mass.
pub fn surface_keeps(
    workbench: &dyn Workbench,
    space: &Arc<ParameterSpace>,
    episodes: usize,
) -> Result<ClaimResult, String> {
    let design = design(space, episodes)?;
    let mut setup = workbench.setup();
    setup.settings.set("suction", word(SuctionLaw::Surface));
    let mut bench = workbench.bench(&setup)?;
    let mut tally = Tally::default();
    for i in 0..design.len() {
        tally.count(&run(&mut bench, &design, i));
    }
    Ok(ClaimResult {
        claim: "a surface gripper never reports grip_loss".to_owned(),
        holds: tally.invalid == 0 && tally.successes > 0 && tally.of(GRIP_LOSS) == 0,
        figures: vec![tally.line()],
    })
}

/// Claim: an object off its placement is picked less often.
pub fn position_jitter(workbench: &dyn Workbench, episodes: usize) -> Result<ClaimResult, String> {
    let (mut simulator, mut policy) = workbench.bench(&workbench.setup())?;
    let mut run = |jitter: f64| {
        let mut tally = Tally::default();
        for i in 0..episodes {
            let values = assign(&[
                ("position_jitter_m", Value::Number(jitter)),
                ("placement", Value::Category(Placement::NAMES[i % 14].into())),
            ]);
            tally.count(&rollout(&mut *simulator, &mut *policy, &scenario(i as u64, values)));
        }
        tally
    };
    let (none, much) = (run(0.0), run(0.05));
    Ok(ClaimResult {
        claim: "objects up to 50 mm off their placement are picked less often than those on it".to_owned(),
        holds: none.invalid + much.invalid == 0 && much.successes < none.successes,
        figures: vec![format!("on the placement: {}", none.line()), format!("off the placement: {}", much.line())],
    })
}

fn word(law: SuctionLaw) -> Value {
    Value::Category(law.as_str().into())
}

fn jaw(setup: &mut Setup) -> Result<&mut ParallelJaw, String> {
    match &mut setup.robot.settings.gripper {
        Gripper::ParallelJaw(jaw) => Ok(jaw),
        other @ Gripper::Suction(_) => {
            Err(format!("this claim applies to fingers, but this gripper is {}", other.description()))
        }
    }
}

fn cup(setup: &mut Setup) -> Result<&mut SuctionCup, String> {
    match &mut setup.robot.settings.gripper {
        Gripper::Suction(cup) => Ok(cup),
        other @ Gripper::ParallelJaw(_) => {
            Err(format!("this claim applies to a suction cup, but this gripper is {}", other.description()))
        }
    }
}

fn design(space: &Arc<ParameterSpace>, episodes: usize) -> Result<Design, String> {
    let stream = Seed::campaign(2026).stream("claims/design");
    samplers::Uniform.design(space, episodes, stream).map_err(|e| e.to_string())
}

fn run((simulator, policy): &mut Bench, design: &Design, i: usize) -> Episode {
    let values = design.assignment(i).unwrap_or_default();
    rollout(&mut **simulator, &mut **policy, &scenario(i as u64, values))
}

fn is_invalid(episode: &Episode) -> bool {
    matches!(episode.outcome, robogate_core::Outcome::Invalid(_))
}

fn describe(episode: &Episode) -> String {
    let mut text = format!("{} at {:.2} s", episode.outcome.as_str(), episode.time_s);
    for (name, value) in episode.scenario.requested.iter() {
        let _ = write!(text, ", {name} = {value:.4}");
    }
    text
}

#[derive(Default)]
struct Tally {
    episodes: usize,
    successes: usize,
    invalid: usize,
    failures: BTreeMap<FailureMode, usize>,
}

impl Tally {
    /// Counts an episode. Returns whether it succeeded, or `None` if it is invalid.
    fn count(&mut self, episode: &Episode) -> Option<bool> {
        use robogate_core::Outcome;
        self.episodes += 1;
        match &episode.outcome {
            Outcome::Success => self.successes += 1,
            Outcome::Failure(mode) => *self.failures.entry(*mode).or_default() += 1,
            Outcome::Invalid(_) => {
                self.invalid += 1;
                return None;
            }
        }
        Some(episode.outcome == Outcome::Success)
    }

    fn of(&self, mode: FailureMode) -> usize {
        self.failures.get(&mode).copied().unwrap_or_default()
    }

    fn line(&self) -> String {
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
