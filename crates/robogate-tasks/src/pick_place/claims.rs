//! Claims about the physics of pick and place: limits of fingers and cups.

use robogate_core::{Assignment, Outcome, Value};
use robogate_physics::{GRAVITY, Gripper, SuctionCup, SuctionLaw};

use super::spec::{GRIP_LOSS, SLIP, phases};
use super::{Placement, Shape};
use crate::arm::claims::{self, Claim, ClaimResult, Ground, Setup, cup, jaw, numbers, stream, threshold};

/// Claims for fingers.
const FINGERS: [Claim; 3] =
    [Claim::new("coulomb", 108, coulomb), Claim::new("opening", 140, opening), Claim::new("no_creep", 140, no_creep)];

/// Claims for a suction cup.
const CUP: [Claim; 4] = [
    Claim::new("vacuum_limit", 0, vacuum_limit),
    Claim::new("cup_area", 0, cup_area),
    Claim::new("gravity", 0, gravity),
    Claim::new("surface_keeps", 300, surface_keeps),
];

/// Claims for every gripper.
const ANY: [Claim; 3] = [
    Claim::new("position_jitter", 140, position_jitter),
    Claim::new("easy_region", 700, |ground, episodes| claims::easy_region(ground, episodes, easy)),
    Claim::new("joint_limits", 70, |ground, episodes| claims::joint_limits(ground, episodes, easy)),
];

/// The claims for a robot with this gripper.
pub(super) fn claims(gripper: &Gripper) -> Vec<Claim> {
    let own = if gripper.cup().is_some() { &CUP[..] } else { &FINGERS[..] };
    own.iter().chain(&ANY).copied().collect()
}

fn with(mut values: Assignment, shape: Shape, placement: &str) -> Assignment {
    values.set("shape", Value::Category(shape.as_str().into()));
    values.set("placement", Value::Category(placement.into()));
    values
}

fn placement(index: usize) -> &'static str {
    Placement::NAMES[index % Placement::NAMES.len()]
}

/// The lowest friction coefficient that holds a box follows Coulomb's law.
///
/// Two pads press with F each, so friction carries at most 2 mu F. A box at rest needs m g, so no coefficient below m g
/// / (2 F) holds it. A box lifted with acceleration a needs m (g + a); the limit of 1.25 includes this. The threshold
/// is found by bisection over whole episodes, to 1 %, for one grip force for each 36 episodes.
fn coulomb(ground: &Ground<'_>, episodes: usize) -> Result<ClaimResult, String> {
    let (mut figures, mut holds) = (Vec::new(), true);
    let limit = jaw(&ground.gripper())?.force_limit_n;
    for force in [2.0, 4.0, 7.0].into_iter().take((episodes / 36).max(1)).map(|sevenths| sevenths / 7.0 * limit) {
        let mut setup = ground.setup();
        setup.settings.set("grip_force_n", Value::Number(force));
        let mut trials = ground.trials(&setup)?;
        for mass in [0.1, 0.5, 1.0, 2.0] {
            let law = mass * GRAVITY / (2.0 * force);
            let mut slips = |ratio: f64| {
                let values = numbers([("friction", ratio * law), ("mass_kg", mass), ("size_m", 0.05)]);
                trials.run(0, with(values, Shape::Box, "center_0")).outcome != Outcome::Success
            };
            match threshold(&mut slips, [0.8, 1.6], 0.01) {
                Ok([low, high]) => {
                    holds &= low >= 0.99 && high <= 1.25;
                    figures.push(format!(
                        "F = {force} N, m = {mass} kg: holds from mu = {:.4}, {high:.3} x m g / (2 F)",
                        high * law
                    ));
                }
                Err(why) => {
                    holds = false;
                    figures.push(format!("F = {force} N, m = {mass} kg: {why} x m g / (2 F)"));
                }
            }
        }
    }
    let claim = "the lowest friction coefficient that holds a box is between m g / (2 F) and 1.25 m g / (2 F)";
    Ok(ClaimResult::new(claim, holds, figures))
}

/// An object wider than the hand's opening is never picked. (This applies without encoder bias: fingers that are off the
/// equator may pinch the cap of a slightly wider ball.)
fn opening(ground: &Ground<'_>, episodes: usize) -> Result<ClaimResult, String> {
    let widest = jaw(&ground.gripper())?.opening_m;
    let tally = ground.tally((0..episodes).map(|i| {
        let mut stream = stream("claims/opening", i as u64);
        // Shapes whose width across the fingers equals their size. The lump is narrower.
        let shape = [Shape::Box, Shape::Cylinder, Shape::Sphere, Shape::L][i % 4];
        let ranges = [("friction", [0.3, 1.2]), ("mass_kg", [0.05, 0.5]), ("size_m", [1.0001 * widest, 1.5 * widest])];
        with(numbers(ranges.map(|(name, [low, high])| (name, stream.between(low, high)))), shape, placement(i))
    }))?;
    let claim = format!("an object wider than the opening of {:.0} mm is never picked", 1e3 * widest);
    Ok(ClaimResult::new(claim, tally.successes == 0 && tally.invalid == 0, vec![tally.line()]))
}

/// An easy scenario: every shape at every placement. A cup needs a flat top that is at least as wide as its lip.
fn easy(gripper: &Gripper, index: u64) -> Assignment {
    let (shapes, sizes) = match gripper {
        Gripper::ParallelJaw(jaw) => (&Shape::ALL[..], [0.375 * jaw.opening_m, 0.75 * jaw.opening_m]),
        Gripper::Suction(cup) => (&Shape::ALL[..2], [1.25 * cup.cup_diameter_m, 2.0 * cup.cup_diameter_m]),
    };
    let mut stream = stream("claims/easy", index);
    let ranges = [("friction", [0.6, 1.2]), ("mass_kg", [0.05, 0.5]), ("com_offset", [0.0, 0.1]), ("size_m", sizes)];
    let values = numbers(ranges.map(|(name, [low, high])| (name, stream.between(low, high))));
    let index = index as usize;
    with(values, shapes[index % shapes.len()], placement(index / shapes.len()))
}

/// A round object neither rotates nor creeps out of the pads. Its centre stays within 4 mm of its first position in the
/// hand, on the whole path to the target.
fn no_creep(ground: &Ground<'_>, episodes: usize) -> Result<ClaimResult, String> {
    jaw(&ground.gripper())?;
    let (mut trials, mut most) = (ground.trials(&ground.setup())?, 0.0_f64);
    for i in 0..episodes {
        let mut stream = stream("claims/creep", i as u64);
        let ranges = [("friction", [0.6, 1.2]), ("mass_kg", [0.1, 0.6]), ("size_m", [0.04, 0.06])];
        let mut values = numbers(ranges.map(|(name, [low, high])| (name, stream.between(low, high))));
        values.set("position_jitter_m", Value::Number(0.003));
        let episode = trials.run(i as u64, with(values, [Shape::Cylinder, Shape::Sphere][i % 2], placement(i / 2)));
        most = most.max(episode.measures.get(SLIP.as_str()).unwrap_or(f64::INFINITY));
    }
    let tally = trials.tally;
    let holds = tally.successes == tally.episodes && most < 4e-3;
    let figures = vec![tally.line(), format!("largest slip {:.2} mm", 1e3 * most)];
    Ok(ClaimResult::new("cylinders and balls slip in the hand by less than 4 mm", holds, figures))
}

/// Peak acceleration of the controller's lift, in m/s^2: a straight path of 0.2 m within 1.2 m/s^2, in an integer number of
/// control periods.
const LIFT_M_S2: f64 = 1.155;

/// The largest mass (kg) that the cup of this setup lifts from the table to the transit height, with scaled gravity.
fn heaviest(ground: &Ground<'_>, setup: &Setup, gravity_scale: f64) -> Result<f64, String> {
    let force = setup.robot.settings.gripper.cup().map_or(0.0, SuctionCup::force_n);
    let mut trials = ground.trials(setup)?;
    let law = force / (gravity_scale * GRAVITY + LIFT_M_S2);
    let lifts = |mass: f64| {
        // High friction ensures that an object lost during the lift is lost by its weight.
        let values =
            numbers([("mass_kg", mass), ("friction", 2.0), ("gravity_scale", gravity_scale), ("size_m", 0.06)]);
        let phase = trials.run(0, with(values, Shape::Box, "center_0")).phase;
        phase == Some(phases::MOVE_TO_TARGET) || phase == Some(phases::RELEASE)
    };
    threshold(lifts, [0.4 * law, 1.1 * law], 0.005).map(|[low, high]| 0.5 * (low + high))
}

/// The setup with a vacuum cup of this suction force in newtons, obtained by its pressure.
fn with_force(ground: &Ground<'_>, force: f64) -> Result<Setup, String> {
    let mut setup = ground.setup();
    setup.settings.set("suction", word(SuctionLaw::Vacuum));
    let cup = cup(&mut setup)?;
    cup.vacuum_pa = force / cup.area_m2();
    Ok(setup)
}

/// A vacuum cup lifts masses up to m (g + a) = p A.
fn vacuum_limit(ground: &Ground<'_>, _: usize) -> Result<ClaimResult, String> {
    let (mut figures, mut holds) = (Vec::new(), true);
    for force in [5.0, 15.0] {
        let mass = heaviest(ground, &with_force(ground, force)?, 1.0)?;
        let law = force / (GRAVITY + LIFT_M_S2);
        holds &= (mass / law - 1.0).abs() <= 0.03;
        figures.push(format!("p A = {force} N: up to {mass:.3} kg, {:.3} x p A / (g + a)", mass / law));
    }
    let claim = "lifted with acceleration a, a vacuum cup holds a mass m up to m (g + a) = p A, within 3 %";
    Ok(ClaimResult::new(claim, holds, figures))
}

/// Doubling the cup's area doubles the mass that it holds.
fn cup_area(ground: &Ground<'_>, _: usize) -> Result<ClaimResult, String> {
    let small = with_force(ground, 6.0)?;
    let mut large = small.clone();
    cup(&mut large)?.cup_diameter_m *= std::f64::consts::SQRT_2;
    let (one, two) = (heaviest(ground, &small, 1.0)?, heaviest(ground, &large, 1.0)?);
    let claim = "doubling a vacuum cup's area doubles the mass that it lifts, within 4 %";
    let figure = format!("{one:.3} kg, then {two:.3} kg: {:.3} x", two / one);
    Ok(ClaimResult::new(claim, (0.5 * two / one - 1.0).abs() <= 0.04, vec![figure]))
}

/// Doubling gravity changes the mass that a vacuum cup lifts to (g + a) / (2 g + a).
fn gravity(ground: &Ground<'_>, _: usize) -> Result<ClaimResult, String> {
    let setup = with_force(ground, 10.0)?;
    let (one, two) = (heaviest(ground, &setup, 1.0)?, heaviest(ground, &setup, 2.0)?);
    let law = (GRAVITY + LIFT_M_S2) / (2.0 * GRAVITY + LIFT_M_S2);
    let claim = "doubling gravity reduces the mass that a vacuum cup lifts to (g + a) / (2 g + a), within 4 %";
    let figure = format!("{one:.3} kg, then {two:.3} kg: {:.3} x. Expected {law:.3} x", two / one);
    Ok(ClaimResult::new(claim, (two / one / law - 1.0).abs() <= 0.04, vec![figure]))
}

/// A surface gripper never loses an object of any mass.
fn surface_keeps(ground: &Ground<'_>, episodes: usize) -> Result<ClaimResult, String> {
    let mut setup = ground.setup();
    setup.settings.set("suction", word(SuctionLaw::Surface));
    let tally = ground.sampled(&setup, episodes)?;
    let holds = tally.invalid == 0 && tally.successes > 0 && !tally.failures.contains_key(&GRIP_LOSS);
    Ok(ClaimResult::new("a surface gripper never reports grip_loss", holds, vec![tally.line()]))
}

/// An object off its placement is picked less often.
fn position_jitter(ground: &Ground<'_>, episodes: usize) -> Result<ClaimResult, String> {
    let run = |jitter: f64| {
        ground.tally((0..episodes).map(|i| {
            let mut values = numbers([("position_jitter_m", jitter)]);
            values.set("placement", Value::Category(placement(i).into()));
            values
        }))
    };
    let (none, much) = (run(0.0)?, run(0.05)?);
    let holds = none.invalid + much.invalid == 0 && much.successes < none.successes;
    let figures = vec![format!("on the placement: {}", none.line()), format!("off the placement: {}", much.line())];
    let claim = "objects up to 50 mm off their placement are picked less often than those on it";
    Ok(ClaimResult::new(claim, holds, figures))
}

fn word(law: SuctionLaw) -> Value {
    Value::Category(law.as_str().into())
}
