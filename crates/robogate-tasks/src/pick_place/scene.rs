//! Builds the scene from parameters: table, object, obstacles, panels and disturbance.

use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};
use robogate_core::Stream;
use robogate_physics::{
    Fixture, FixtureKind, GRAVITY, Part, Primitive, Scene, TABLE_CENTRE, TABLE_HALF, WORKSPACE_CENTRE, isometry,
};

use super::cell::TARGET_ROOM_M;
use super::{Placement, SceneParameters, occluder};

/// The target on the table, in metres. It is outside the circle of the obstacles.
pub(crate) const TARGET: [f64; 2] = [0.4, 0.4];

/// Obstacles stand within this distance of the workspace centre, in metres (paper, section 4.2).
const OBSTACLE_RADIUS: f64 = 0.3;

/// Smallest free space between an obstacle and the object, the target area or another obstacle, in metres.
pub(crate) const OBSTACLE_GAP: f64 = 0.01;

/// The share of the reach within which every placement of the scaled workspace lies. It leaves room for a tool that points
/// down from above the obstacles.
const SHARE_OF_REACH: f64 = 0.75;

/// Distance from the base to the farthest placement of the paper's workspace, in metres.
const FARTHEST_M: f64 = 0.62;

/// The scale of the workspace about the robot's base, at most 1, at which every placement and the target are within the
/// reach (m) of an arm.
pub(crate) fn workspace_scale(reach_m: f64) -> f64 {
    (SHARE_OF_REACH * reach_m / FARTHEST_M).min(1.0)
}

/// The target in a workspace of this scale, in metres.
pub(crate) fn target(scale: f64) -> [f64; 2] {
    TARGET.map(|x| x * scale)
}

/// Builds the scene of these parameters with the object at `placement`, and with target and obstacles in a workspace of this
/// scale. `stream` samples the obstacles.
///
/// # Errors
/// If the object is not on the table, or there is no room for the obstacles.
pub fn scene(
    parameters: &SceneParameters,
    placement: &Placement,
    scale: f64,
    stream: &mut Stream,
) -> Result<Scene, String> {
    let target = target(scale);
    let object = parameters.shape.object(parameters.size_m, parameters.mass_kg, parameters.com_offset);
    let half = 0.5 * parameters.size_m;
    let mut fixtures = vec![Fixture::table()];
    let [x, y] = placement.position;
    if (x - TABLE_CENTRE[0]).abs() > TABLE_HALF[0] || (y - TABLE_CENTRE[1]).abs() > TABLE_HALF[1] {
        return Err(format!("the object at ({x:.3}, {y:.3}) m is not on the table"));
    }
    let panels = occluder::panels(parameters.occluders, placement.position);
    // The parameter may require more free space around object and target than obstacles need from each other.
    let room = parameters.obstacle_gap_m - OBSTACLE_GAP;
    // The object may be rotated, so its footprint is bounded by the circle around its square.
    let mut taken = vec![
        (placement.position, half * std::f64::consts::SQRT_2 + room),
        (target, half * std::f64::consts::SQRT_2 + TARGET_ROOM_M + room),
    ];
    taken.extend(occluder::footprints(&panels));
    for i in 1..=parameters.obstacles {
        let (part, place) = obstacle(stream, scale, &taken)
            .ok_or_else(|| format!("there is no room for obstacle {i} of {}", parameters.obstacles))?;
        taken.push(place);
        let (name, kind) = (format!("obstacle_{i}"), FixtureKind::Obstacle);
        fixtures.push(Fixture { name, kind, part, motion: None, friction: None, color: None });
    }
    fixtures.extend(panels);
    fixtures.extend(parameters.disturbance.fixture());
    let pose = placement.pose(parameters.size_m);
    Ok(Scene {
        object_pose: isometry(&pose.position, &pose.orientation),
        others: Vec::new(),
        friction: parameters.friction,
        table_friction: parameters.table_friction,
        arm_stiffness: 1.0,
        gripper: parameters.around.gripper,
        fixtures,
        gravity: GRAVITY * parameters.gravity_scale,
        marker: Some(target),
        visual: parameters.visual(),
        object,
    })
}

/// A box or cylinder, 3 to 6 cm wide and 4 to 14 cm high, sampled uniformly from the circle around the workspace centre
/// (in a workspace of this scale) and clear of the circles in `taken` (centre and radius). Returns the part and its bounding circle.
fn obstacle(stream: &mut Stream, scale: f64, taken: &[([f64; 2], f64)]) -> Option<(Part, ([f64; 2], f64))> {
    let half_width = stream.between(0.015, 0.03);
    let half_height = stream.between(0.02, 0.07);
    let round = stream.below(2) == 1;
    let yaw = stream.between(0.0, std::f64::consts::FRAC_PI_2);
    let (primitive, footprint) = if round {
        (Primitive::Cylinder { radius: half_width, half_height }, half_width)
    } else {
        let half = [half_width, half_width, half_height];
        (Primitive::Box { half }, half_width * std::f64::consts::SQRT_2)
    };
    // A few draws are usually enough. The bound ends the search in an impossible scene.
    (0..10_000).find_map(|_| {
        let distance = scale * OBSTACLE_RADIUS * stream.uniform().sqrt();
        let (sin, cos) = stream.between(0.0, std::f64::consts::TAU).sin_cos();
        let [x, y] = WORKSPACE_CENTRE.map(|x| x * scale);
        let at = [x + distance * cos, y + distance * sin];
        let free = taken
            .iter()
            .all(|(other, radius)| (at[0] - other[0]).hypot(at[1] - other[1]) >= footprint + radius + OBSTACLE_GAP);
        free.then(|| {
            let rotation = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), yaw);
            let pose = Isometry3::from_parts(Translation3::new(at[0], at[1], half_height), rotation);
            (Part { primitive: primitive.clone(), pose }, (at, footprint))
        })
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use robogate_core::Seed;

    #[test]
    fn obstacles_keep_their_distance() {
        for index in 0..200 {
            let parameters = SceneParameters {
                obstacles: 5,
                size_m: 0.12,
                placement: Placement::NAMES[index as usize % 14].to_owned(),
                ..SceneParameters::nominal()
            };
            let placement = Placement::from_name(&parameters.placement).unwrap();
            let mut stream = Seed::campaign(1).episode(index).stream("obstacles");
            let scene = scene(&parameters, &placement, 1.0, &mut stream).unwrap();
            assert_eq!(scene.fixtures.len(), 6);
            for (i, fixture) in scene.fixtures.iter().enumerate().skip(1) {
                let at = fixture.part.pose.translation.vector;
                assert!((at.x - 0.5).hypot(at.y) <= OBSTACLE_RADIUS);
                assert!(
                    fixture.distance_bound_at(
                        &fixture.part.pose,
                        [placement.position[0], placement.position[1], 0.06],
                        0.06
                    ) > 0.0
                );
                for other in &scene.fixtures[i + 1..] {
                    let there = other.part.pose.translation.vector;
                    let radius = fixture.part.primitive.half_extent()[0];
                    assert!(other.distance_bound_at(&other.part.pose, [at.x, at.y, there.z], radius) > 0.0);
                }
            }
        }
    }
}
