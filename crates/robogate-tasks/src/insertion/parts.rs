//! The geometry of peg and block.
//!
//! The peg is a square shaft with a wider head, by which fingers or a cup hold it. Its frame has the origin in the middle
//! of the tip and z along its axis. The block has a square hole through to the table with a chamfer of 45 degrees. Its
//! frame has the origin in the middle of the mouth and z along the hole's axis, out of the hole.

use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};
use robogate_physics::{Fixture, FixtureKind, MassProperties, Object, Part, Primitive};

/// Length of the shaft below the head, in metres.
pub const SHAFT_M: f64 = 0.06;
/// Width of the head, in metres.
pub const HEAD_M: f64 = 0.05;
/// Height of the head, in metres.
pub const HEAD_HEIGHT_M: f64 = 0.02;
/// Depth of the hole: height of the block above the table, in metres.
pub const DEPTH_M: f64 = 0.045;
/// Thickness of the block's walls, in metres.
const WALL_M: f64 = 0.02;
/// Thickness of the plates that form the chamfer, in metres.
const PLATE_M: f64 = 0.004;

/// A peg of this width (m) and mass (kg). Its centre of mass is `lever_m` metres off its axis along x.
pub fn peg(width_m: f64, mass_kg: f64, lever_m: f64) -> Object {
    let part =
        |half: [f64; 3], z: f64| Part { primitive: Primitive::Box { half }, pose: Isometry3::translation(0.0, 0.0, z) };
    let parts = vec![
        part([0.5 * width_m, 0.5 * width_m, 0.5 * SHAFT_M], 0.5 * SHAFT_M),
        part([0.5 * HEAD_M, 0.5 * HEAD_M, 0.5 * HEAD_HEIGHT_M], SHAFT_M + 0.5 * HEAD_HEIGHT_M),
    ];
    let mut mass = MassProperties::homogeneous(&parts, mass_kg);
    mass.centre.x += lever_m;
    Object { parts, mass, joint: None, friction: None }
}

/// A block with a hole of this width and chamfer (m) at `mouth`: four walls, each of a lower part, an upper part behind
/// the chamfer and a plate for the chamfer. Without a chamfer each wall is one part.
pub fn block(mouth: &Isometry3<f64>, hole_m: f64, chamfer_m: f64) -> Vec<Fixture> {
    let half = 0.5 * hole_m;
    let mut fixtures = Vec::new();
    for side in 0..4 {
        let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), f64::from(side) * std::f64::consts::FRAC_PI_2);
        // The walls along x are longer, so that the four walls close the corners.
        let along = if side % 2 == 0 { half + WALL_M } else { half };
        let mut wall = |name: &str, extent: [f64; 3], at: [f64; 3], tilt: f64| {
            let tilt = UnitQuaternion::from_axis_angle(&Vector3::y_axis(), tilt);
            let pose = mouth * turn * Isometry3::from_parts(Translation3::from(Vector3::from(at)), tilt);
            let primitive = Primitive::Box { half: extent };
            fixtures.push(Fixture {
                name: format!("block_{name}_{side}"),
                kind: FixtureKind::Receptacle,
                part: Part { primitive, pose },
                motion: None,
                friction: None,
                color: None,
            });
        };
        let lower = DEPTH_M - chamfer_m;
        wall("wall", [0.5 * WALL_M, along, 0.5 * lower], [half + 0.5 * WALL_M, 0.0, -chamfer_m - 0.5 * lower], 0.0);
        if chamfer_m > 0.0 {
            let behind = WALL_M - chamfer_m;
            wall(
                "rim",
                [0.5 * behind, along, 0.5 * chamfer_m],
                [half + chamfer_m + 0.5 * behind, 0.0, -0.5 * chamfer_m],
                0.0,
            );
            // The plate's upper face joins the lower wall's inner edge and the rim's.
            let length = chamfer_m * std::f64::consts::SQRT_2;
            let sunk = 0.5 * PLATE_M * std::f64::consts::FRAC_1_SQRT_2;
            wall(
                "chamfer",
                [0.5 * length, along, 0.5 * PLATE_M],
                [half + 0.5 * chamfer_m + sunk, 0.0, -0.5 * chamfer_m - sunk],
                -std::f64::consts::FRAC_PI_4,
            );
        }
    }
    fixtures
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Point3;

    fn inside(fixtures: &[Fixture], point: [f64; 3]) -> bool {
        fixtures.iter().any(|fixture| {
            let local = fixture.part.pose.inverse_transform_point(&Point3::from(point));
            local.coords.iter().zip(fixture.part.primitive.half_extent()).all(|(x, half)| x.abs() < half)
        })
    }

    #[test]
    fn hole_and_chamfer_are_open() {
        let walls = block(&Isometry3::identity(), 0.03, 0.002);
        for (x, z, solid) in [
            (0.0149, -0.03, false),
            (0.0151, -0.03, true),
            (0.0149, -0.0021, false),
            (0.0158, -0.001, false),
            (0.0163, -0.001, true),
            (0.0172, -0.0005, true),
            (0.0168, -0.0001, false),
        ] {
            for side in [[x, 0.0], [-x, 0.0], [0.0, x], [0.0, -x]] {
                assert_eq!(inside(&walls, [side[0], side[1], z]), solid, "{side:?} {z}");
            }
        }
    }

    #[test]
    fn corners_are_closed() {
        let walls = block(&Isometry3::identity(), 0.03, 0.0);
        assert!(inside(&walls, [0.02, 0.02, -0.01]) && inside(&walls, [-0.02, 0.02, -0.01]));
    }
}
