//! Claims about the physics of stacks: the limits of overhang of [`super::statics`].

use nalgebra::Isometry3;
use robogate_core::{Assignment, FailureMode, Outcome};
use robogate_physics::{Engine, GRAVITY, Gripper, Object, Scene};

use super::numbers::{Layout, Numbers};
use super::shipped;
use super::statics::{self, Level};
use crate::arm::claims::{self, Claim, ClaimResult, Ground, let_run, numbers, stream, threshold};

pub(super) const CLAIMS: [Claim; 4] = [
    Claim::new("statics", 0, standing),
    Claim::new("overhang", 0, overhang),
    Claim::new("easy_region", 100, |ground, episodes| claims::easy_region(ground, episodes, easy)),
    Claim::new("joint_limits", 30, |ground, episodes| claims::joint_limits(ground, episodes, easy)),
];

/// Edge of the parts, in metres.
const SIZE_M: f64 = 0.05;

/// The scene of a stack of parts at these offsets (fractions of their size) with these masses (kg).
fn stack(offsets: &[f64], masses: &[f64]) -> Result<Scene, String> {
    let task = shipped().next().ok_or("the program has no task from a file")?;
    let mut numbers = Numbers { friction: 0.6, gravity: GRAVITY, ..task.model.nominal.clone() };
    numbers.parts.iter_mut().zip(masses).for_each(|(part, mass)| part.mass_kg = *mass);
    let pose =
        |(level, x): (usize, &f64)| Isometry3::translation(0.55 + x * SIZE_M, 0.2, (level as f64 + 0.5) * SIZE_M);
    let mut parts: Vec<_> = offsets.iter().enumerate().map(pose).collect();
    parts.resize(numbers.parts.len(), Isometry3::identity());
    let mut scene = task.scene(&numbers, &Layout { parts, ..Layout::default() });
    scene.others.truncate(offsets.len() - 1);
    Ok(scene)
}

/// Whether a stack stands after 3 s.
fn stands(engine: &mut dyn Engine, scene: &Scene) -> Result<bool, String> {
    let_run(engine, scene, 3.0)?;
    let at_rest = |(body, (_, start)): (usize, (&Object, &Isometry3<f64>))| {
        (engine.free_body(body).translation.vector - start.translation.vector).norm() < 0.2 * SIZE_M
    };
    Ok(scene.free_bodies().enumerate().all(at_rest))
}

/// Stacks stand exactly where statics says so, up to 2 % of the size around the limit.
fn standing(ground: &Ground<'_>, _: usize) -> Result<ClaimResult, String> {
    let mut engine = ground.engine()?;
    let pairs = [0.0, 0.3, 0.45, 0.47, 0.53, 0.6].map(|x| (vec![0.0, x], vec![0.2; 2]));
    let triples = [0.1, 0.25, 0.31, 0.36, 0.45].map(|x| (vec![0.0, x, 2.0 * x], vec![0.2; 3]));
    // From the top, offsets of 1/2 and 1/4 are the limit of equal parts. A counterweight extends the overhang.
    let others = [
        (vec![0.0, 0.23, 0.69], vec![0.2; 3]),
        (vec![0.0, 0.29, 0.77], vec![0.2; 3]),
        (vec![0.0, 0.6, 0.2], vec![0.2; 3]),
        (vec![0.0, 0.6, 0.2], vec![0.2, 0.2, 0.04]),
    ];
    let (mut figures, mut agree, mut count) = (Vec::new(), 0, 0);
    for (offsets, masses) in pairs.into_iter().chain(triples).chain(others) {
        let level = |(x, mass): (&f64, &f64)| Level { at: [x * SIZE_M, 0.0], mass_kg: *mass };
        let levels: Vec<Level> = offsets.iter().zip(&masses).map(level).collect();
        let (due, found) = (statics::margin(&levels, SIZE_M) > 0.0, stands(&mut *engine, &stack(&offsets, &masses)?)?);
        count += 1;
        if due == found {
            agree += 1;
        } else {
            figures.push(format!("offsets {offsets:?}, masses {masses:?} kg: stands: {found}. Expected: {due}"));
        }
    }
    figures.insert(0, format!("{agree} of {count} stacks agree"));
    let claim = "a stack of cubes stands if, and only if, the line of gravity above each face passes through it";
    Ok(ClaimResult::new(claim, agree == count, figures))
}

/// Three parts with equal offsets stand up to an offset of a third of their size each.
fn overhang(ground: &Ground<'_>, _: usize) -> Result<ClaimResult, String> {
    let mut trials = ground.trials(&ground.setup())?;
    let stands = |overhang: f64| {
        trials.run(0, numbers([("overhang", overhang)])).outcome != Outcome::Failure(FailureMode::constant("toppled"))
    };
    let [low, high] = threshold(stands, [0.25, 0.42], 0.02)?;
    let tally = trials.tally;
    let holds = tally.invalid == 0 && low < 1.0 / 3.0 + 0.05 && high > 1.0 / 3.0 - 0.05;
    let figures = vec![format!("stands up to {low:.3}, falls from {high:.3} of the size on"), tally.line()];
    let claim = "a stack of three that the arm builds stands up to offsets of a third of the size, within 5 % of it";
    Ok(ClaimResult::new(claim, holds, figures))
}

fn easy(_: &Gripper, index: u64) -> Assignment {
    let mut stream = stream("claims/easy", index);
    let ranges =
        [("friction", [0.6, 1.0]), ("mass_kg", [0.1, 0.4]), ("size_m", [0.045, 0.055]), ("overhang", [0.0, 0.15])];
    numbers(ranges.map(|(name, [low, high])| (name, stream.between(low, high))))
}
