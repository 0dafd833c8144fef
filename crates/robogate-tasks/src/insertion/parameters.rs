//! The parameter table of insertion: one row per parameter.

use nalgebra::Isometry3;
use robogate_physics::{FixtureKind, Primitive, Readback};

use super::parts;
use crate::arm::{Acting, InSurroundings, Row, Surroundings, Table};

/// The decoded parameters of a scenario, and its draws.
#[derive(Debug, Clone, Default)]
pub(super) struct Settings {
    pub(super) clearance_m: f64,
    pub(super) chamfer_m: f64,
    pub(super) width_m: f64,
    pub(super) mass_kg: f64,
    pub(super) friction: f64,
    pub(super) arm_stiffness: f64,
    pub(super) hole_jitter_m: f64,
    pub(super) hole_tilt_rad: f64,
    pub(super) peg_jitter_m: f64,
    pub(super) around: Surroundings,
    /// Nominal position (x, y) of the peg and of the hole, in metres.
    pub(super) places: [[f64; 2]; 2],
    /// Points of the unit disc: direction and fraction of the deviations of peg and hole.
    pub(super) shift: [[f64; 2]; 2],
    /// Direction of the axis about which the hole tilts, in radians, and fraction of the tilt.
    pub(super) tilt: [f64; 2],
}

impl InSurroundings for Settings {
    fn around_mut(&mut self) -> &mut Surroundings {
        &mut self.around
    }
}

/// The walls of the hole in the engine: shape and pose, in the order of the sides.
fn walls(engine: &Readback) -> Vec<([f64; 3], Isometry3<f64>)> {
    let mut walls: Vec<_> = engine.fixtures.iter().collect();
    walls.sort_by_key(|read| read.fixture);
    let shape = |primitive: Option<&Primitive>| primitive.map_or([f64::NAN; 3], |primitive| primitive.half_extent());
    walls.into_iter().map(|read| (shape(read.primitive.as_ref()), read.pose)).collect()
}

/// The parts of the block in the engine that differ from the block of the settings with this chamfer, or are missing.
fn is_block(acting: &Acting<'_, Settings>) -> bool {
    let settings = acting.settings;
    let expected = parts::block(&settings.mouth(), settings.width_m + settings.clearance_m, settings.chamfer_m);
    // The first fixture is the table.
    let found = walls(acting.found.engine);
    let close = |(fixture, (half, pose)): (&robogate_physics::Fixture, &([f64; 3], Isometry3<f64>))| {
        let off = fixture.part.pose.inverse() * pose;
        let same = fixture.part.primitive.half_extent().iter().zip(half).all(|(a, b)| (a - b).abs() < 1e-7);
        fixture.kind == FixtureKind::Receptacle
            && same
            && off.translation.vector.norm() < 1e-6
            && off.rotation.angle() < 1e-6
    };
    found.len() == expected.len() + 1 && expected.iter().zip(&found[1..]).all(close)
}

/// A value that acts through the geometry of the block: the request, if the engine has that block.
fn of_block(acting: &Acting<'_, Settings>, value: f64) -> f64 {
    if is_block(acting) { value } else { f64::NAN }
}

/// The hole's width in the engine, from the inner faces of opposite walls, minus that of the shaft.
fn clearance(acting: &Acting<'_, Settings>) -> f64 {
    let found = walls(acting.found.engine);
    let per_side = if acting.settings.chamfer_m > 0.0 { 3 } else { 1 };
    let (Some((half, first)), Some((_, opposite))) = (found.get(1), found.get(1 + 2 * per_side)) else {
        return f64::NAN;
    };
    let hole = (first.translation.vector - opposite.translation.vector).norm() - 2.0 * half[0];
    // The difference of two poses has fewer digits than the request.
    let read = hole - width(acting);
    if (read - acting.settings.clearance_m).abs() < 1e-9 { acting.settings.clearance_m } else { read }
}

fn width(acting: &Acting<'_, Settings>) -> f64 {
    acting.found.engine.parts.first().map_or(f64::NAN, |part| 2.0 * part.half_extent()[0])
}

/// The scale of a point of the unit disc that gives this displacement. `NaN` if the direction disagrees.
fn scale(draw: [f64; 2], found: [f64; 2]) -> f64 {
    let scale = (draw[0] * found[0] + draw[1] * found[1]) / (draw[0] * draw[0] + draw[1] * draw[1]);
    let agrees = draw.iter().zip(found).all(|(draw, found)| (draw * scale - found).abs() < 1e-6);
    if agrees { scale } else { f64::NAN }
}

fn peg_jitter(acting: &Acting<'_, Settings>) -> f64 {
    let (at, [x, y]) = (acting.found.engine.object.translation, acting.settings.places[0]);
    scale(acting.settings.shift[0], [at.x - x, at.y - y])
}

type Parameter = Row<Settings>;

/// Every parameter of the task.
pub(super) static TABLE: Table<Settings> = Table(&[
    Parameter::number(
        "clearance_m",
        "Difference of the widths of hole and peg; the policy is told.",
        "the shapes and poses of walls and shaft in the engine",
        ([0.0002, 0.003], 0.001),
        |s, x| s.clearance_m = x,
        clearance,
    )
    .in_family("hole"),
    Parameter::number(
        "chamfer_m",
        "Width of the 45 degree chamfer of the hole; the policy is told.",
        "the shapes and poses of the block's parts in the engine",
        ([0.0, 0.004], 0.001),
        |s, x| s.chamfer_m = x,
        |a| of_block(a, a.settings.chamfer_m),
    )
    .in_family("hole"),
    Parameter::number(
        "width_m",
        "Width of the peg's square shaft.",
        "the shaft's shape in the engine",
        ([0.015, 0.04], 0.03),
        |s, x| s.width_m = x,
        width,
    )
    .in_family("peg"),
    Parameter::number(
        "mass_kg",
        "Mass of the peg.",
        "the peg's mass in the engine",
        ([0.02, 2.0], 0.2),
        |s, x| s.mass_kg = x,
        |a| a.found.engine.mass_kg,
    )
    .in_family("peg"),
    Parameter::number(
        "friction",
        "Coulomb friction coefficient of the peg against block and table.",
        "the contacts' friction in the engine",
        ([0.01, 2.0], 0.2),
        |s, x| s.friction = x,
        |a| a.found.engine.table_friction,
    )
    .in_family("peg"),
    Parameter::number(
        "arm_stiffness",
        "Stiffness of the arm's servos as a multiple of the robot's own; the policy is told.",
        "the servos' stiffness in the engine",
        ([0.05, 2.0], 0.25),
        |s, x| s.arm_stiffness = x,
        |a| a.found.engine.arm_stiffness.unwrap_or(f64::NAN),
    )
    .in_family("arm"),
    Parameter::number(
        "hole_jitter_m",
        "Radius of the disc from which the hole's offset from its place is drawn; the policy is not told.",
        "the poses of the block's parts in the engine",
        ([0.0, 0.01], 0.0),
        |s, x| s.hole_jitter_m = x,
        |a| of_block(a, a.settings.hole_jitter_m),
    )
    .in_family("hole"),
    Parameter::number(
        "hole_tilt_rad",
        "Largest tilt of the hole's axis, about an axis in a random direction; the policy is not told.",
        "the poses of the block's parts in the engine",
        ([0.0, 0.05], 0.0),
        |s, x| s.hole_tilt_rad = x,
        |a| of_block(a, a.settings.hole_tilt_rad),
    )
    .in_family("hole"),
    Parameter::number(
        "peg_jitter_m",
        "Radius of the disc from which the peg's offset from its place is drawn; the policy is not told.",
        "the peg's pose in the engine",
        ([0.0, 0.03], 0.0),
        |s, x| s.peg_jitter_m = x,
        peg_jitter,
    )
    .in_family("peg"),
    Parameter::encoder_bias("encoder_bias_rad", 0.1),
]);
