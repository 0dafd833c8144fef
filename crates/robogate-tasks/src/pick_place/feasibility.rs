//! Conditions that every policy needs: necessary conditions of geometry and statics, never those of one controller.

use robogate_core::{Assignment, Infeasibility};
use robogate_physics::{GRAVITY, Gripper, ParallelJaw, Robot, SuctionCup, SuctionLaw};

use super::scene::target;
use super::{Placement, SceneParameters, Shape};

/// The reason why no policy can complete the scenario with this robot, whose pads press with `grip_force_n`,
/// in a workspace of this scale.
///
/// - The object and the target must be within the arm's reach.
/// - Two fingers must be able to hold the object: [`narrowest`] and [`friction_carries`].
/// - The vacuum of a cup must carry the weight.
///
/// A scenario that cannot be decoded has no reason here: its reset reports the problem.
pub(crate) fn infeasibility(
    requested: &Assignment,
    robot: &Robot,
    scale: f64,
    grip_force_n: f64,
    suction: SuctionLaw,
) -> Option<Infeasibility> {
    let gripper = &robot.settings.gripper;
    let parameters = SceneParameters::from_assignment(requested, Some(gripper)).ok()?;
    out_of_reach(&parameters, scale, robot.settings.arm.reach_m).or_else(|| match gripper {
        Gripper::ParallelJaw(jaw) => too_wide(&parameters, jaw).or_else(|| slips(&parameters, grip_force_n)),
        Gripper::Suction(cup) => match suction {
            SuctionLaw::Vacuum => too_heavy(&parameters, cup),
            SuctionLaw::Surface => None,
        },
    })
}

fn reason(condition: &str, limit: String) -> Infeasibility {
    Infeasibility { condition: condition.to_owned(), limit }
}

/// The wrist of an arm cannot be farther from the base than its reach. A tool that points down is below the wrist.
fn out_of_reach(parameters: &SceneParameters, scale: f64, reach_m: f64) -> Option<Infeasibility> {
    let far = |[x, y]: [f64; 2]| x.hypot(y) > reach_m;
    let limit = || format!("{reach_m:.2} m");
    if far(target(scale)) {
        return Some(reason("the target is out of the arm's reach", limit()));
    }
    let placement = Placement::from_name(&parameters.placement)?.scaled(scale).moved(parameters.offset_m);
    let nearest = placement.position[0].hypot(placement.position[1]) - parameters.position_jitter_m;
    (nearest > reach_m).then(|| reason("the part is out of the arm's reach", limit()))
}

fn too_wide(parameters: &SceneParameters, jaw: &ParallelJaw) -> Option<Infeasibility> {
    let width = narrowest(parameters.shape, parameters.friction)? * parameters.size_m;
    (width > jaw.opening_m)
        .then(|| reason("the part is wider than the gripper opening", format!("{:.0} mm", 1e3 * jaw.opening_m)))
}

/// The smallest distance between two contacts that can hold the shape, as a fraction of its size. `None` without a useful
/// bound.
///
/// Two contacts with friction hold an object if the line between them is within both friction cones (Nguyen 1988,
/// "Constructing force-closure grasps"). On a ball, the contacts may be off a diameter by the angle of friction. On a cube
/// and a cylinder, other contacts than those on opposite faces need a friction coefficient of at least 1. The L has a stem
/// of half the width, and the lump a ball of 0.44 of the size.
fn narrowest(shape: Shape, friction: f64) -> Option<f64> {
    match shape {
        Shape::Box | Shape::Cylinder => (friction < 1.0).then_some(1.0),
        Shape::Sphere => Some(1.0 / friction.hypot(1.0)),
        Shape::L => Some(0.5),
        Shape::Irregular => Some(0.44),
    }
}

/// Pads that press with F each on vertical faces carry at most 2 mu F (Coulomb). The other shapes may rest on the pads.
fn slips(parameters: &SceneParameters, grip_force_n: f64) -> Option<Infeasibility> {
    let friction = parameters.pad_friction();
    let grip_force_n = grip_force_n * parameters.gripper.force_scale;
    let vertical = matches!(parameters.shape, Shape::Box | Shape::Cylinder) && friction < 1.0;
    let weight = parameters.mass_kg * GRAVITY * parameters.gravity_scale;
    (vertical && weight > 2.0 * friction * grip_force_n)
        .then(|| reason("the part is heavier than friction can carry", format!("{grip_force_n:.0} N for each pad")))
}

/// The vacuum of a cup carries at most its pressure times its area.
fn too_heavy(parameters: &SceneParameters, cup: &SuctionCup) -> Option<Infeasibility> {
    let weight = parameters.mass_kg * GRAVITY * parameters.gravity_scale;
    let force_n = cup.force_n() * parameters.gripper.force_scale;
    (weight > force_n).then(|| reason("the part is heavier than the vacuum can carry", format!("{force_n:.0} N")))
}

#[cfg(test)]
mod tests {
    use robogate_core::Value;
    use robogate_physics::built_in_robot;

    use super::*;

    fn check(robot: &str, pairs: &[(&str, Value)]) -> Option<String> {
        let robot = built_in_robot(robot).unwrap();
        let values = pairs.iter().map(|(name, value)| ((*name).into(), value.clone())).collect();
        let force = robot.settings.gripper.jaw().map_or(0.0, |jaw| jaw.force_n);
        infeasibility(&values, &robot, 1.0, force, SuctionLaw::Vacuum)
            .map(|found| format!("{} ({})", found.condition, found.limit))
    }

    #[test]
    fn wide_parts_are_infeasible() {
        let of = |shape: &str, size| {
            let shape = Value::Category(shape.into());
            check("franka", &[("size_m", Value::Number(size)), ("shape", shape), ("friction", Value::Number(0.6))])
        };
        let why = Some("the part is wider than the gripper opening (80 mm)".to_owned());
        assert_eq!((of("box", 0.079), of("box", 0.081)), (None, why.clone()));
        // A ball is held above its equator as far as friction allows: 80 mm / cos(atan 0.6) = 93.3 mm.
        assert_eq!((of("sphere", 0.093), of("sphere", 0.094)), (None, why));
        assert_eq!((of("L_shape", 0.12), of("irregular", 0.12)), (None, None));
    }

    #[test]
    fn paper_target_is_out_of_a_short_reach() {
        let why = Some("the target is out of the arm's reach (0.50 m)".to_owned());
        assert_eq!((check("ur3e", &[]), check("ur5e", &[])), (why, None));
    }

    #[test]
    fn heavy_parts_are_infeasible() {
        let of = |friction, mass| {
            check("franka", &[("friction", Value::Number(friction)), ("mass_kg", Value::Number(mass))])
        };
        assert_eq!(of(0.2, 1.2), None);
        assert_eq!(of(0.2, 1.3), Some("the part is heavier than friction can carry (30 N for each pad)".to_owned()));
    }
}
