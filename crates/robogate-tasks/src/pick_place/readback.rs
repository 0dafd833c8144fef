//! Readers of applied values. They use the state that acts in the episode, never the request.
//!
//! If a parameter scales a random draw (encoder bias, position jitter), the reader divides the acting value by the
//! draw. The request is used only to interpret the state: the shape to which a size refers.

use nalgebra::{Isometry3, Vector2};
use robogate_physics::{FixtureKind, FixtureRead, GRAVITY, Primitive, isometry};

use super::cell::{TARGET_ROOM_M, Told};
use super::scene::target;
use super::{Disturbance, Placement, Shape};
use crate::arm::Acting;

/// Poses within this distance (m) and angle (rad) are equal. Engines may store poses in single precision.
const POSE_TOLERANCE: f64 = 1e-6;

type Context<'a> = Acting<'a, Told>;

impl Acting<'_, Told> {
    /// The engine's fixtures of this kind that match the cell exactly in pose and shape.
    fn fixtures(&self, kind: FixtureKind) -> impl Iterator<Item = &FixtureRead> {
        self.found.engine.fixtures.iter().filter(move |read| {
            self.settings.cell.scene.fixtures.get(read.fixture).is_some_and(|fixture| {
                fixture.kind == kind
                    && read
                        .primitive
                        .as_ref()
                        .is_some_and(|primitive| same_primitive(&fixture.part.primitive, primitive))
                    && same_pose(&fixture.part.pose, &read.pose)
            })
        })
    }

    /// The object's position relative to the requested placement without offset and jitter, in metres (x, y).
    fn displacement(&self) -> Vector2<f64> {
        let nominal = Placement::from_name(&self.settings.cell.parameters.placement);
        let nominal = nominal.map_or([f64::NAN; 2], |placement| placement.scaled(self.settings.cell.scale).position);
        self.found.engine.object.translation.vector.xy() - Vector2::from(nominal)
    }

    /// The displacement of the object by the position jitter, in metres (x, y).
    fn jitter(&self) -> Vector2<f64> {
        Vector2::from(self.settings.cell.jitter) * self.settings.cell.parameters.position_jitter_m
    }

    /// Whether the engine has the object at this placement, with offset and jitter.
    fn stands_at(&self, placement: &Placement) -> bool {
        let placement = placement.scaled(self.settings.cell.scale);
        let placement = placement.moved(self.settings.cell.parameters.offset_m).moved(self.jitter().into());
        let pose = placement.pose(self.settings.cell.parameters.size_m);
        same_pose(&isometry(&pose.position, &pose.orientation), &self.found.engine.object)
    }
}

fn same_pose(a: &Isometry3<f64>, b: &Isometry3<f64>) -> bool {
    let off = a.inverse() * b;
    off.translation.vector.norm() < POSE_TOLERANCE && off.rotation.angle() < POSE_TOLERANCE
}

/// Compares shapes in single precision, the precision of some engines.
fn same_primitive(a: &Primitive, b: &Primitive) -> bool {
    std::mem::discriminant(a) == std::mem::discriminant(b)
        && a.half_extent().iter().zip(b.half_extent()).all(|(a, b)| (a - b).abs() < 1e-7)
}

/// The size for which the requested shape has the engine's first part.
pub(super) fn size(context: &Context<'_>) -> f64 {
    let unit = context.settings.cell.parameters.shape.object(1.0, 1.0, 0.0);
    let extent = |part: &Primitive| part.half_extent()[0];
    context.found.engine.parts.first().map_or(f64::NAN, extent) / extent(&unit.parts[0].primitive)
}

pub(super) fn com_offset(context: &Context<'_>) -> f64 {
    context.settings.cell.parameters.shape.com_offset_of(size(context), &context.found.engine.centre_of_mass)
}

/// The shape whose parts the engine has.
pub(super) fn shape(context: &Context<'_>) -> String {
    let read = &context.found.engine.parts;
    let same = |shape: &Shape| {
        let parts = shape.object(context.settings.cell.parameters.size_m, 1.0, 0.0).parts;
        parts.len() == read.len() && parts.iter().zip(read).all(|(part, read)| same_primitive(&part.primitive, read))
    };
    Shape::ALL.into_iter().find(same).map_or_else(|| format!("{read:?}"), |shape| shape.as_str().to_owned())
}

pub(super) fn gravity_scale(context: &Context<'_>) -> f64 {
    context.found.engine.gravity / GRAVITY
}

/// The placement of the object in the engine, or its position if no placement matches.
pub(super) fn placement(context: &Context<'_>) -> String {
    let requested = context.settings.cell.parameters.placement.as_str();
    let stands = |name: &&str| Placement::from_name(name).is_some_and(|placement| context.stands_at(&placement));
    let found = std::iter::once(requested).chain(Placement::NAMES).find(stands);
    found.map_or_else(|| format!("{:.6?}", context.found.engine.object.translation.vector.as_slice()), str::to_owned)
}

/// The offset of the object from its placement, in metres.
pub(super) fn offset(context: &Context<'_>) -> [f64; 2] {
    (context.displacement() - context.jitter()).into()
}

/// The radius of the disc from which the object's displacement was sampled. `NaN` if the direction of the displacement,
/// or the object's height or yaw, is wrong.
pub(super) fn position_jitter(context: &Context<'_>) -> f64 {
    let parameters = &context.settings.cell.parameters;
    let draw = Vector2::from(context.settings.cell.jitter);
    let displacement = context.displacement() - Vector2::from(parameters.offset_m);
    let radius = displacement.dot(&draw) / draw.norm_squared();
    let requested = parameters.position_jitter_m;
    if (radius - requested).abs() * draw.norm() < POSE_TOLERANCE {
        let placement = Placement::from_name(&parameters.placement);
        let stands = placement.is_some_and(|placement| context.stands_at(&placement));
        return if stands { requested } else { f64::NAN };
    }
    if (displacement - draw * radius).norm() < POSE_TOLERANCE { radius } else { f64::NAN }
}

pub(super) fn obstacles(context: &Context<'_>) -> usize {
    context.fixtures(FixtureKind::Obstacle).count()
}

pub(super) fn occluders(context: &Context<'_>) -> usize {
    context.fixtures(FixtureKind::Occluder).count()
}

/// The requested gap if all obstacles of the engine respect it, otherwise the smallest actual gap.
pub(super) fn obstacle_gap(context: &Context<'_>) -> f64 {
    let object = context.found.engine.object.translation.vector.xy();
    let half_diagonal = 0.5 * size(context) * std::f64::consts::SQRT_2;
    let areas =
        [(object, half_diagonal), (Vector2::from(target(context.settings.cell.scale)), half_diagonal + TARGET_ROOM_M)];
    let scene = &context.settings.cell.scene;
    let obstacles =
        context.found.engine.fixtures.iter().filter(|read| {
            scene.fixtures.get(read.fixture).is_some_and(|fixture| fixture.kind == FixtureKind::Obstacle)
        });
    let gaps = obstacles.flat_map(|read| {
        let at = read.pose.translation.vector.xy();
        let radius = read.primitive.as_ref().map_or(f64::NAN, footprint);
        areas.map(|(centre, area)| (at - centre).norm() - area - radius)
    });
    let requested = context.settings.cell.parameters.obstacle_gap_m;
    let keeps = |gap: &f64| *gap >= requested - POSE_TOLERANCE;
    gaps.filter(|gap| !keeps(gap)).reduce(f64::min).unwrap_or(requested)
}

/// Radius of the bounding circle of a primitive's footprint, in metres.
fn footprint(primitive: &Primitive) -> f64 {
    match primitive {
        Primitive::Cylinder { radius, .. } | Primitive::Sphere { radius } => *radius,
        _ => {
            let [x, y, _] = primitive.half_extent();
            x.hypot(y)
        }
    }
}

/// The disturbance in the engine.
pub(super) fn disturbance(context: &Context<'_>) -> Disturbance {
    let mover = context.fixtures(FixtureKind::Disturbance).find_map(|read| Some((&read.pose, read.motion.as_ref()?)));
    context.settings.cell.parameters.disturbance.read(mover)
}

#[cfg(test)]
mod tests {
    use robogate_core::{Assignment, Fault, FaultKind, Scenario, Seed, Value, check_applied};
    use robogate_physics::{GripperUnit, Readback, built_in_robot};

    use super::*;
    use crate::arm::Found;
    use crate::pick_place::PickPlace;
    use crate::pick_place::cell::ResolvedCell;
    use crate::pick_place::parameters::TABLE;
    use crate::pick_place::spec::Briefing;

    /// The readback of an engine with exactly the cell's scene.
    fn faithful(cell: &ResolvedCell) -> Readback {
        let scene = &cell.scene;
        let fixtures = scene.fixtures.iter().enumerate().map(|(i, fixture)| FixtureRead {
            fixture: i,
            primitive: Some(fixture.part.primitive.clone()),
            pose: fixture.part.pose,
            motion: fixture.motion,
            friction: None,
        });
        Readback {
            friction: scene.friction,
            table_friction: scene.table_friction.unwrap_or(scene.friction),
            pad_friction: Some(scene.friction * scene.gripper.pad_friction_scale),
            own_friction: Vec::new(),
            gravity: scene.gravity,
            arm_stiffness: Some(scene.arm_stiffness),
            mass_kg: scene.object.mass.mass_kg,
            centre_of_mass: scene.object.mass.centre,
            parts: scene.object.parts.iter().map(|part| part.primitive.clone()).collect(),
            object: scene.object_pose,
            others: Vec::new(),
            fixtures: fixtures.collect(),
            joints: Vec::new(),
        }
    }

    /// Requests one parameter, lets `change` modify the acting state, and checks the value that is read.
    fn check(
        robot: &str,
        (name, value): (&str, Value),
        change: impl FnOnce(&mut ResolvedCell, &mut Briefing, &mut Option<f64>),
    ) -> Result<(), Fault> {
        let requested: Assignment = [(name.into(), value)].into_iter().collect();
        let scenario = Scenario { index: 3, seed: Seed::campaign(1).episode(3), requested };
        let mut cell = ResolvedCell::new(&scenario, &built_in_robot(robot).unwrap(), &PickPlace::DEFAULT).unwrap();
        let mut briefing = cell.briefing();
        let mut grip_threshold_m = Some(cell.parameters.grip_threshold_m);
        change(&mut cell, &mut briefing, &mut grip_threshold_m);
        let (engine, visual) = (faithful(&cell), cell.scene.visual);
        let grip_force_scale = Some(cell.scene.gripper.force_scale);
        let found = Found { engine: &engine, visual: &visual, grip_threshold_m, grip_force_scale };
        let (bias, told) = (cell.bias.clone(), Told { cell, briefing });
        let acting = Acting { settings: &told, around: &told.cell.parameters.around, found: &found, bias: &bias };
        check_applied(&scenario.requested, &TABLE.applied(&scenario.requested, &acting))
    }

    fn assert_not_applied(checked: Result<(), Fault>) {
        assert_eq!(checked.unwrap_err().kind, FaultKind::NotApplied);
    }

    #[test]
    fn encoder_noise_is_read_from_biases() {
        let noise = || ("ik_noise_rad", Value::Number(0.02));
        check("franka", noise(), |_, _, _| {}).unwrap();
        assert_not_applied(check("franka", noise(), |cell, _, _| cell.bias.fill(0.0)));
        assert_not_applied(check("franka", noise(), |cell, _, _| cell.bias.iter_mut().for_each(|bias| *bias *= 1.01)));
        assert_not_applied(check("franka", noise(), |cell, _, _| cell.bias.swap(0, 1)));
        assert_not_applied(check("franka", noise(), |cell, _, _| cell.bias.truncate(6)));
    }

    #[test]
    fn unit_parameters_are_read_from_drives() {
        let bias = || ("unit_bias_4_rad", Value::Number(0.01));
        check("franka", bias(), |_, _, _| {}).unwrap();
        assert_not_applied(check("franka", bias(), |cell, _, _| cell.bias[3] = 0.0));
        assert_not_applied(check("franka", bias(), |cell, _, _| cell.bias.truncate(3)));
        for name in ["grip_force_scale", "pad_friction_scale"] {
            let scale = || (name, Value::Number(0.7));
            check("franka", scale(), |_, _, _| {}).unwrap();
            assert_not_applied(check("franka", scale(), |cell, _, _| cell.scene.gripper = GripperUnit::default()));
        }
    }

    #[test]
    fn approach_speed_is_read_from_briefing() {
        let speed = || ("approach_speed_m_s", Value::Number(0.2));
        check("franka", speed(), |_, _, _| {}).unwrap();
        assert_not_applied(check("franka", speed(), |_, briefing, _| briefing.approach_speed_m_s = None));
        assert_not_applied(check("franka", speed(), |_, briefing, _| briefing.approach_speed_m_s = Some(0.21)));
    }

    #[test]
    fn grip_threshold_is_read_from_cup() {
        let threshold = || ("grip_threshold_m", Value::Number(0.015));
        check("ur5e", threshold(), |_, _, _| {}).unwrap();
        assert_not_applied(check("ur5e", threshold(), |_, _, cup| *cup = Some(0.01)));
        assert_not_applied(check("ur5e", threshold(), |_, _, cup| *cup = None));
    }

    #[test]
    fn missing_jitter_is_detected() {
        let jitter = || ("position_jitter_m", Value::Number(0.03));
        check("franka", jitter(), |_, _, _| {}).unwrap();
        let forgotten = |cell: &mut ResolvedCell, _: &mut Briefing, _: &mut Option<f64>| {
            let pose = Placement::from_name("center_0").unwrap().pose(cell.parameters.size_m);
            cell.scene.object_pose = isometry(&pose.position, &pose.orientation);
        };
        assert_not_applied(check("franka", jitter(), forgotten));
    }
}
