//! What stands in the cell, in terms that any engine understands.

use nalgebra::{Isometry3, Point3, Translation3, UnitQuaternion, Vector3};
use robogate_core::{Pose, Stream};
use serde::{Deserialize, Serialize};

use crate::{Motion, ObjectModel, Part, Placement, Primitive, SceneParameters, Visual, occluder};

/// The middle of the workspace on the table, in metres in front of the base.
pub const WORKSPACE_CENTRE: [f64; 2] = [0.5, 0.0];

/// Where the object shall go, in metres: beyond the circle in which obstacles stand.
pub(crate) const TARGET: [f64; 2] = [0.4, 0.4];

/// Gravity on Earth, in m/s^2.
pub(crate) const GRAVITY: f64 = 9.81;

/// The table's middle and half its extent, in metres.
const TABLE_CENTRE: [f64; 2] = [0.55, 0.0];
pub(crate) const TABLE_HALF: [f64; 2] = [0.4, 0.7];

/// Obstacles stand within this distance of the workspace centre, in metres (paper, section 4.2).
const OBSTACLE_RADIUS: f64 = 0.3;

/// Free space between an obstacle and the object, the target's place, or another obstacle, in metres.
pub(crate) const OBSTACLE_GAP: f64 = 0.01;

/// A body that nothing moves from its place or its way: for the robot, touching it is a collision.
#[derive(Debug, Clone, PartialEq)]
pub struct Fixture {
    /// Its name in contact reports.
    pub name: String,
    /// What it is there for.
    pub kind: FixtureKind,
    /// Its shape, and its pose in the base frame at the start.
    pub part: Part,
    /// How it moves, if it does. An engine drives it along, and it pushes the object.
    pub motion: Option<Motion>,
}

/// What a fixture is there for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum FixtureKind {
    /// What everything stands on.
    Table,
    /// Something to keep clear of.
    Obstacle,
    /// A panel in the front camera's view.
    Occluder,
    /// A body that crosses the workspace.
    Disturbance,
}

impl Fixture {
    /// A lower bound of the distance from a ball to the fixture where it stands at `pose`, in metres (negative inside).
    pub(crate) fn distance_bound_at(&self, pose: &Isometry3<f64>, centre: [f64; 3], radius: f64) -> f64 {
        let local = pose.inverse_transform_point(&Point3::from(centre));
        let beyond = local.coords.abs() - Vector3::from(self.part.primitive.half_extent());
        beyond.sup(&Vector3::zeros()).norm() - radius
    }
}

/// A scenario's world, before an engine gives it physics.
#[derive(Debug, Clone, PartialEq)]
pub struct Scene {
    /// The object.
    pub object: ObjectModel,
    /// The object's pose at the start.
    pub object_pose: Isometry3<f64>,
    /// Coulomb friction of the object against everything.
    pub friction: f64,
    /// Coulomb friction of the object against the table, where it differs.
    pub table_friction: Option<f64>,
    /// The table, then whatever else stands or moves there.
    pub fixtures: Vec<Fixture>,
    /// Where the object's centre shall come to rest, in metres.
    pub target: [f64; 3],
    /// Gravity, in m/s^2.
    pub gravity: f64,
    /// How it all looks.
    pub visual: Visual,
}

impl Scene {
    /// The scene of these parameters; `stream` places the obstacles.
    ///
    /// Fails where the object does not stand on the table or the obstacles find no room.
    pub fn new(parameters: &SceneParameters, placement: &Placement, stream: &mut Stream) -> Result<Self, String> {
        let object = parameters.object();
        let half = 0.5 * object.size_m;
        let mut fixtures = vec![table()];
        let [x, y] = placement.position;
        if (x - TABLE_CENTRE[0]).abs() > TABLE_HALF[0] || (y - TABLE_CENTRE[1]).abs() > TABLE_HALF[1] {
            return Err(format!("the object would stand beside the table, at ({x:.3}, {y:.3}) m"));
        }
        let panels = occluder::panels(parameters.occluders, placement.position);
        // Obstacles keep more room than they must from the object and the target's place, where that is asked for.
        let room = parameters.obstacle_gap_m - OBSTACLE_GAP;
        // The object may stand turned: its footprint is within the circle about its square.
        let mut taken = vec![
            (placement.position, half * std::f64::consts::SQRT_2 + room),
            (TARGET, half * std::f64::consts::SQRT_2 + 0.03 + room),
        ];
        taken.extend(occluder::footprints(&panels));
        for i in 1..=parameters.obstacles {
            let (part, place) = obstacle(stream, &taken)
                .ok_or_else(|| format!("no room for obstacle {i} of {}", parameters.obstacles))?;
            taken.push(place);
            let (name, kind) = (format!("obstacle_{i}"), FixtureKind::Obstacle);
            fixtures.push(Fixture { name, kind, part, motion: None });
        }
        fixtures.extend(panels);
        fixtures.extend(parameters.disturbance.fixture());
        let pose = placement.pose(object.size_m);
        Ok(Self {
            object_pose: isometry(&pose.position, &pose.orientation),
            friction: parameters.friction,
            table_friction: parameters.table_friction,
            fixtures,
            target: [TARGET[0], TARGET[1], half],
            gravity: GRAVITY * parameters.gravity_scale,
            visual: parameters.visual,
            object,
        })
    }
}

/// The table: its top is the plane z = 0, in front of the base.
fn table() -> Fixture {
    let primitive = Primitive::Box { half: [TABLE_HALF[0], TABLE_HALF[1], 0.02] };
    let pose = Isometry3::translation(TABLE_CENTRE[0], TABLE_CENTRE[1], -0.02);
    let part = Part { primitive, pose };
    Fixture { name: "table".to_owned(), kind: FixtureKind::Table, part, motion: None }
}

/// A box or cylinder, 3 to 6 cm wide and 4 to 14 cm high, uniformly in the circle about the workspace
/// centre, clear of the circles in `taken`.
fn obstacle(stream: &mut Stream, taken: &[([f64; 2], f64)]) -> Option<(Part, ([f64; 2], f64))> {
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
    // A place is found within a few draws; the bound only keeps an impossible scene from hanging.
    (0..10_000).find_map(|_| {
        let distance = OBSTACLE_RADIUS * stream.uniform().sqrt();
        let (sin, cos) = stream.between(0.0, std::f64::consts::TAU).sin_cos();
        let at = [WORKSPACE_CENTRE[0] + distance * cos, WORKSPACE_CENTRE[1] + distance * sin];
        let free = taken
            .iter()
            .all(|(other, radius)| (at[0] - other[0]).hypot(at[1] - other[1]) >= footprint + radius + OBSTACLE_GAP);
        free.then(|| {
            let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), yaw);
            let pose = Isometry3::from_parts(Translation3::new(at[0], at[1], half_height), turn);
            (Part { primitive, pose }, (at, footprint))
        })
    })
}

/// A position (m) and a unit quaternion (w, x, y, z) as nalgebra has them.
pub(crate) fn isometry(position: &[f64; 3], orientation: &[f64; 4]) -> Isometry3<f64> {
    let [w, x, y, z] = *orientation;
    let turn = UnitQuaternion::from_quaternion(nalgebra::Quaternion::new(w, x, y, z));
    Isometry3::from_parts(Translation3::from(Vector3::from(*position)), turn)
}

/// A pose of nalgebra's in plain numbers.
pub(crate) fn pose(isometry: &Isometry3<f64>) -> Pose {
    let turn = &isometry.rotation;
    Pose { position: isometry.translation.vector.into(), orientation: [turn.w, turn.i, turn.j, turn.k] }
}

#[cfg(test)]
mod tests {
    use super::*;
    use robogate_core::Seed;

    #[test]
    fn obstacles_stand_in_their_circle_and_touch_nothing() {
        for index in 0..200 {
            let parameters = SceneParameters {
                obstacles: 5,
                size_m: 0.12,
                placement: Placement::NAMES[index as usize % 14].to_owned(),
                ..SceneParameters::default()
            };
            let placement = Placement::from_name(&parameters.placement).unwrap();
            let mut stream = Seed::campaign(1).episode(index).stream("obstacles");
            let scene = Scene::new(&parameters, &placement, &mut stream).unwrap();
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
