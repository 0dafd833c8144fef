//! Conditions that every policy needs: necessary conditions of geometry and statics, never those of one controller.

use robogate_core::{Assignment, Infeasibility};
use robogate_physics::{GRAVITY, Robot, SuctionLaw};

use super::scene::target;
use super::{Placement, SceneParameters, Shape};
use crate::arm::{Load, cannot_carry, out_of_reach};

/// The reason why no policy can complete the scenario with this robot, whose pads press with `grip_force_n`,
/// in a workspace of this scale.
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
    let parameters = SceneParameters::from_assignment(requested, gripper).ok()?;
    let placement = Placement::from_name(&parameters.placement)?.scaled(scale).moved(parameters.offset_m);
    // The other shapes may rest on the pads.
    let vertical = matches!(parameters.shape, Shape::Box | Shape::Cylinder) && parameters.pad_friction() < 1.0;
    let load = Load {
        width_m: narrowest(parameters.shape, parameters.friction).map(|width| width * parameters.size_m),
        friction: vertical.then(|| parameters.pad_friction()),
        weight_n: parameters.mass_kg * GRAVITY * parameters.gravity_scale,
        force_scale: parameters.around.gripper.force_scale,
    };
    out_of_reach(robot, "target", target(scale), 0.0)
        .or_else(|| out_of_reach(robot, "part", placement.position, parameters.position_jitter_m))
        .or_else(|| cannot_carry(robot, &load, grip_force_n, suction))
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
        assert_eq!(of(0.9, 3.1), Some("the part is heavier than the arm's payload (3 kg)".to_owned()));
        assert_eq!(of(0.2, 1.3), Some("the part is heavier than friction can carry (30 N for each pad)".to_owned()));
    }
}
