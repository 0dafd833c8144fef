//! Claims about the physics, as experiments that anyone can run again.
//!
//! Each takes a bench (a way to make a fresh simulator and controller), runs episodes on it and returns
//! its figures together with whether the claim holds. The tests of this crate and `robogate check physics`
//! run the same code, so that every engine is held to the same claims.

use std::fmt::Write as _;
use std::sync::Arc;

use robogate_core::{
    Assignment, Design, Episode, FailureMode, ParameterSpace, Policy, Sampler, Scenario, Seed, Simulator, Value,
    rollout, rollout_with, samplers,
};

use crate::{Placement, Shape};

/// A simulator and the scripted controller for it.
pub type Bench = (Box<dyn Simulator>, Box<dyn Policy>);

/// Makes benches: the time step in seconds and the grip force in newtons may be set.
pub trait Workbench {
    /// A fresh bench; `None` is the default.
    fn bench(&self, time_step_s: Option<f64>, grip_force_n: Option<f64>) -> Result<Bench, String>;
    /// The default time step in seconds.
    fn time_step_s(&self) -> f64;
    /// The widest opening of the gripper, in metres.
    fn opening_m(&self) -> f64;
    /// The largest grip force, in newtons.
    fn force_limit_n(&self) -> f64;
    /// Speed and acceleration limits of the joints, in rad/s and rad/s^2.
    fn joint_limits(&self) -> (Vec<f64>, Vec<f64>);
}

/// What an experiment found.
#[derive(Debug, Clone, PartialEq)]
pub struct Finding {
    /// The claim, in one sentence.
    pub claim: String,
    /// The figures behind it, line by line.
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

/// A box held in the air falls below the friction that Coulomb's law asks for, and not much above it.
///
/// Two pads press with F each; friction carries at most 2 mu F. Held still the box needs m g, so the lowest
/// friction that holds cannot be below m g / (2 F); lifted with acceleration a it needs m (g + a), which
/// the limit of 1.25 leaves room for. Found by bisection over whole episodes, to 1 %.
pub fn coulomb(workbench: &dyn Workbench) -> Result<Finding, String> {
    let mut finding = Finding {
        claim: "the lowest friction that holds a box lies between m g / (2 F) and 1.25 m g / (2 F)".to_owned(),
        figures: Vec::new(),
        holds: true,
    };
    let masses = [0.1, 0.5, 1.0, 2.0];
    for force in [2.0, 4.0, 7.0].map(|sevenths| sevenths / 7.0 * workbench.force_limit_n()) {
        let (mut simulator, mut policy) = workbench.bench(None, Some(force))?;
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
                finding
                    .figures
                    .push(format!("F = {force} N, m = {mass} kg: no threshold between 0.8 and 1.6 x the law"));
                finding.holds = false;
                continue;
            }
            while high - low > 0.01 {
                let middle = 0.5 * (low + high);
                *(if holds(middle) { &mut high } else { &mut low }) = middle;
            }
            finding.holds &= low >= 0.99 && high <= 1.25;
            finding.figures.push(format!(
                "F = {force} N, m = {mass} kg: holds from mu = {:.4}, {high:.3} x m g / (2 F)",
                high * law
            ));
        }
    }
    Ok(finding)
}

/// An object wider than the hand's opening is never picked. (Without encoder bias: pushed off the equator, the
/// fingers may pinch the cap of a ball a little wider than they open, and that is no mistake.)
pub fn opening(workbench: &dyn Workbench, episodes: usize) -> Result<Finding, String> {
    let (mut simulator, mut policy) = workbench.bench(None, None)?;
    let mut tally = Tally::default();
    let widest = workbench.opening_m();
    for i in 0..episodes {
        let mut stream = Seed::campaign(2026).episode(i as u64).stream("claims/opening");
        // Shapes whose width across the fingers is their size; the lump is narrower.
        let shape = [Shape::Box, Shape::Cylinder, Shape::Sphere, Shape::L][i % 4];
        let values = assign(&[
            ("friction", Value::Number(stream.between(0.3, 1.2))),
            ("mass_kg", Value::Number(stream.between(0.05, 0.5))),
            ("size_m", Value::Number(stream.between(1.0001 * widest, 1.5 * widest))),
            ("shape", Value::Category(shape.word().into())),
            ("placement", Value::Category(Placement::NAMES[i % 14].into())),
        ]);
        tally.count(&rollout(&mut *simulator, &mut *policy, &scenario(i as u64, values)));
    }
    Ok(Finding {
        claim: format!("an object wider than the opening of {:.0} mm is never picked", 1e3 * widest),
        holds: tally.successes == 0 && tally.invalid == 0,
        figures: vec![tally.line()],
    })
}

/// In the easy region the controller succeeds in at least 99 of 100 episodes.
pub fn easy_region(workbench: &dyn Workbench, episodes: usize) -> Result<Finding, String> {
    let (mut simulator, mut policy) = workbench.bench(None, None)?;
    let mut tally = Tally::default();
    let mut figures = Vec::new();
    for i in 0..episodes {
        let mut stream = Seed::campaign(2026).episode(i as u64).stream("claims/easy");
        // Every shape at every placement in turn.
        let values = assign(&[
            ("friction", Value::Number(stream.between(0.6, 1.2))),
            ("mass_kg", Value::Number(stream.between(0.05, 0.5))),
            ("com_offset", Value::Number(stream.between(0.0, 0.1))),
            ("size_m", Value::Number(stream.between(0.03, 0.06))),
            ("ik_noise_rad", Value::Number(0.0)),
            ("obstacles", Value::Integer(0)),
            ("shape", Value::Category(Shape::ALL[i % 5].word().into())),
            ("placement", Value::Category(Placement::NAMES[(i / 5) % 14].into())),
        ]);
        let episode = rollout(&mut *simulator, &mut *policy, &scenario(i as u64, values));
        if tally.count(&episode) != Some(true) {
            figures.push(format!("not a success: {}", describe(&episode)));
        }
    }
    figures.insert(0, tally.line());
    Ok(Finding {
        claim: "in the easy region at least 99 of 100 episodes succeed".to_owned(),
        holds: tally.invalid == 0 && tally.successes * 100 >= tally.episodes * 99,
        figures,
    })
}

/// Halving the time step changes at most 2 % of the outcomes over the default space.
pub fn time_step(workbench: &dyn Workbench, space: &Arc<ParameterSpace>, episodes: usize) -> Result<Finding, String> {
    let design = design(space, episodes)?;
    let step = workbench.time_step_s();
    let mut coarse = workbench.bench(Some(step), None)?;
    let mut fine = workbench.bench(Some(0.5 * step), None)?;
    let (mut changed, mut verdicts, mut invalid) = (0, 0, 0);
    for i in 0..design.len() {
        let one = run(&mut coarse, &design, i);
        let two = run(&mut fine, &design, i);
        invalid += usize::from(is_invalid(&one) || is_invalid(&two));
        changed += usize::from(one.outcome.word() != two.outcome.word());
        verdicts += usize::from((one.outcome.word() == "success") != (two.outcome.word() == "success"));
    }
    Ok(Finding {
        claim: "halving the time step changes at most 2 % of the outcomes".to_owned(),
        holds: invalid == 0 && changed * 50 <= design.len(),
        figures: vec![format!(
            "{} ms against {} ms: {changed} of {} outcomes change, {verdicts} between success and failure, {invalid} invalid",
            1e3 * step,
            500.0 * step,
            design.len()
        )],
    })
}

/// The same scenario gives the same bits, whatever ran before on the same simulator.
pub fn repeatable(workbench: &dyn Workbench, space: &Arc<ParameterSpace>, episodes: usize) -> Result<Finding, String> {
    let design = design(space, episodes)?;
    let mut forward = workbench.bench(None, None)?;
    let first: Vec<Episode> = (0..design.len()).map(|i| run(&mut forward, &design, i)).collect();
    let mut backward = workbench.bench(None, None)?;
    let invalid = first.iter().filter(|episode| is_invalid(episode)).count();
    let differ = (0..design.len()).rev().filter(|i| run(&mut backward, &design, *i) != first[*i]).count();
    Ok(Finding {
        claim: "an episode has the same bits in any order on any simulator".to_owned(),
        holds: invalid == 0 && differ == 0,
        figures: vec![format!(
            "{differ} of {} episodes differ when run in reverse order, {invalid} are invalid",
            design.len()
        )],
    })
}

/// The arm keeps its joints' speed limits as measured, and the controller's commands their acceleration
/// limits. (Torques are cut by the engine's own force range.)
pub fn joint_limits(workbench: &dyn Workbench, episodes: usize) -> Result<Finding, String> {
    let (mut simulator, mut policy) = workbench.bench(None, None)?;
    let (speed_limit, acceleration_limit) = workbench.joint_limits();
    let mut invalid = 0;
    let (mut speed, mut acceleration) = (vec![0.0_f64; speed_limit.len()], vec![0.0_f64; speed_limit.len()]);
    for i in 0..episodes {
        let values = assign(&[
            ("friction", Value::Number(0.8)),
            ("mass_kg", Value::Number(0.2)),
            ("size_m", Value::Number(0.05)),
            ("shape", Value::Category(Shape::ALL[i % 5].word().into())),
            ("placement", Value::Category(Placement::NAMES[i % 14].into())),
        ]);
        let mut commands: Vec<Vec<f64>> = Vec::new();
        let period = 0.05;
        let episode = rollout_with(&mut *simulator, &mut *policy, &scenario(i as u64, values), &mut |tick| {
            for (most, v) in speed.iter_mut().zip(&tick.step.observation.joint_velocities) {
                *most = most.max(v.abs());
            }
            let robogate_core::ArmCommand::JointPositions(q) = &tick.action.arm;
            commands.push(q.clone());
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
    Ok(Finding {
        claim: "joint speeds and accelerations stay within the robot's limits".to_owned(),
        holds: invalid == 0 && fastest <= 1.0 && strongest <= 1.0,
        figures: vec![format!(
            "largest share of a limit over {episodes} episodes: speed {:.0} %, acceleration {:.0} %",
            100.0 * fastest,
            100.0 * strongest
        )],
    })
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
    let mut text = format!("{} at {:.2} s", episode.outcome.word(), episode.time_s);
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
    failures: [usize; 4],
}

impl Tally {
    /// Counts an episode and says whether it succeeded; `None` where it is no evidence.
    fn count(&mut self, episode: &Episode) -> Option<bool> {
        use robogate_core::Outcome;
        self.episodes += 1;
        match &episode.outcome {
            Outcome::Success => self.successes += 1,
            Outcome::Failure(mode) => {
                self.failures[FailureMode::ALL.iter().position(|m| m == mode).unwrap_or_default()] += 1;
            }
            Outcome::Invalid(_) => {
                self.invalid += 1;
                return None;
            }
        }
        Some(episode.outcome == Outcome::Success)
    }

    fn line(&self) -> String {
        let mut line = format!("{} of {} succeed", self.successes, self.episodes);
        for (mode, count) in FailureMode::ALL.iter().zip(self.failures).filter(|(_, count)| *count > 0) {
            let _ = write!(line, ", {count} {}", mode.word());
        }
        if self.invalid > 0 {
            let _ = write!(line, ", {} invalid", self.invalid);
        }
        line
    }
}
