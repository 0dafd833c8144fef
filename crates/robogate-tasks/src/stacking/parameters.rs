//! The parameter table of stacking: one row per parameter.

use robogate_physics::{GRAVITY, Readback};

use crate::arm::{Access, Acting, InSurroundings, Row, Surroundings, Table, Words, scale};

/// The orders in which the parts can be stacked, from the bottom up.
pub(super) const ORDERS: [&str; 6] = ["abc", "acb", "bac", "bca", "cab", "cba"];

/// The parts' names.
pub(super) const PARTS: [char; 3] = ['a', 'b', 'c'];

/// The decoded parameters of a scenario, and its draws.
#[derive(Debug, Clone, Default)]
pub(super) struct Settings {
    pub(super) size_m: f64,
    pub(super) mass_kg: f64,
    pub(super) mass_step: f64,
    pub(super) overhang: f64,
    pub(super) friction: f64,
    pub(super) gravity_scale: f64,
    pub(super) position_jitter_m: f64,
    pub(super) yaw_jitter_rad: f64,
    pub(super) around: Surroundings,
    /// Indices of the parts from the bottom up.
    pub(super) order: [usize; 3],
    /// Nominal position (x, y) of each part, in metres.
    pub(super) places: [[f64; 2]; 3],
    /// For each part, a point of the unit disc: the direction and fraction of the position jitter.
    pub(super) shift: [[f64; 2]; 3],
    /// For each part, a number from -1 to 1: the fraction of the yaw jitter.
    pub(super) turn: [f64; 3],
}

impl InSurroundings for Settings {
    fn around_mut(&mut self) -> &mut Surroundings {
        &mut self.around
    }
}

/// Mass (kg), position (x, y, yaw in m and rad) and size (m) of a part in the engine.
struct Found {
    mass_kg: f64,
    at: [f64; 3],
    edge_m: f64,
}

/// A part in the engine.
fn found(engine: &Readback, part: usize) -> Found {
    let (mass_kg, pose, parts) = match part.checked_sub(1).and_then(|other| engine.others.get(other)) {
        Some(read) => (read.mass_kg, &read.pose, &read.parts),
        None => (engine.mass_kg, &engine.object, &engine.parts),
    };
    let edge_m = parts.first().map_or(f64::NAN, |part| 2.0 * part.half_extent()[0]);
    Found { mass_kg, at: [pose.translation.x, pose.translation.y, pose.rotation.euler_angles().2], edge_m }
}

/// The common value of three readings. `NaN` if they differ by more than `bound`.
fn common(values: [f64; 3], bound: f64) -> f64 {
    if values.iter().all(|value| (value - values[0]).abs() <= bound) { values[0] } else { f64::NAN }
}

fn size(acting: &Acting<'_, Settings>) -> f64 {
    common([0, 1, 2].map(|part| found(acting.found.engine, part).edge_m), 1e-9)
}

/// Mass of the part at a level of the stack, in kilograms.
fn mass_at(acting: &Acting<'_, Settings>, level: usize) -> f64 {
    found(acting.found.engine, acting.settings.order[level]).mass_kg
}

fn mass_step(acting: &Acting<'_, Settings>) -> f64 {
    let [first, second, third] = [0, 1, 2].map(|level| mass_at(acting, level));
    if (third / second - second / first).abs() < 1e-6 * (second / first) { second / first } else { f64::NAN }
}

fn position_jitter(acting: &Acting<'_, Settings>) -> f64 {
    let Settings { shift, places, .. } = acting.settings;
    let at = [0, 1, 2].map(|part| found(acting.found.engine, part).at);
    let displacements: Vec<f64> =
        (0..3).flat_map(|part| (0..2).map(move |axis| at[part][axis] - places[part][axis])).collect();
    scale(shift.as_flattened(), &displacements)
}

fn yaw_jitter(acting: &Acting<'_, Settings>) -> f64 {
    scale(&acting.settings.turn, &[0, 1, 2].map(|part| found(acting.found.engine, part).at[2]))
}

/// The order that the masses and the places of the parts have in the engine: it is the request, if the engine has three
/// parts at the places of the layout.
fn order(acting: &Acting<'_, Settings>) -> String {
    let near = |part: usize| {
        let ([x, y, _], [px, py]) = (found(acting.found.engine, part).at, acting.settings.places[part]);
        (x - px).hypot(y - py) <= acting.settings.position_jitter_m + 1e-6
    };
    if acting.found.engine.others.len() == 2 && (0..3).all(near) {
        acting.settings.order.map(|part| PARTS[part]).iter().collect()
    } else {
        "not set up".to_owned()
    }
}

type Parameter = Row<Settings>;

/// Every parameter of the task.
pub(super) static TABLE: Table<Settings> = Table(&[
    Parameter::new(
        "order",
        "Order of the parts in the stack, from the bottom up. The first part stays where it is.",
        "the parts' poses in the engine",
        Access::Word {
            words: Words { choices: || ORDERS.into(), form: None },
            nominal: "abc",
            set: |s, word| {
                let part = |letter| PARTS.iter().position(|part| *part == letter);
                s.order = word.chars().map(part).collect::<Option<Vec<_>>>()?.try_into().ok()?;
                Some(())
            },
            read: order,
        },
    )
    .in_family("stack"),
    Parameter::number(
        "overhang",
        "Offset of each part from the part below it along x, as a fraction of its size; the policy is told.",
        "the offset in the referee",
        ([0.0, 0.6], 0.0),
        |s, x| s.overhang = x,
        |a| a.settings.overhang,
    )
    .in_family("stack"),
    Parameter::number(
        "size_m",
        "Edge of each part.",
        "the parts' shapes in the engine",
        ([0.03, 0.07], 0.05),
        |s, x| s.size_m = x,
        size,
    )
    .in_family("parts"),
    Parameter::number(
        "mass_kg",
        "Mass of the part at the bottom.",
        "the part's mass in the engine",
        ([0.01, 5.0], 0.2),
        |s, x| s.mass_kg = x,
        |a| mass_at(a, 0),
    )
    .in_family("parts"),
    Parameter::number(
        "mass_step",
        "Mass of each part as a multiple of the part below it.",
        "the parts' masses in the engine",
        ([0.25, 4.0], 1.0),
        |s, x| s.mass_step = x,
        mass_step,
    )
    .in_family("parts"),
    Parameter::number(
        "friction",
        "Coulomb friction coefficient of the parts against everything they touch.",
        "the contacts' friction in the engine",
        ([0.01, 10.0], 0.8),
        |s, x| s.friction = x,
        |a| if a.found.engine.friction == a.found.engine.table_friction { a.found.engine.friction } else { f64::NAN },
    )
    .in_family("parts"),
    Parameter::number(
        "gravity_scale",
        "Gravity as a multiple of 9.81 m/s^2.",
        "gravity in the engine",
        ([0.1, 3.0], 1.0),
        |s, x| s.gravity_scale = x,
        |a| a.found.engine.gravity / GRAVITY,
    ),
    Parameter::number(
        "position_jitter_m",
        "Radius of the disc from which each part's offset from its place is drawn; the policy is not told.",
        "the parts' poses in the engine",
        ([0.0, 0.03], 0.0),
        |s, x| s.position_jitter_m = x,
        position_jitter,
    )
    .in_family("layout"),
    Parameter::number(
        "yaw_jitter_rad",
        "Largest rotation of each part about the vertical, in both directions; the policy is not told.",
        "the parts' poses in the engine",
        ([0.0, 0.7], 0.0),
        |s, x| s.yaw_jitter_rad = x,
        yaw_jitter,
    )
    .in_family("layout"),
    Parameter::encoder_bias("encoder_bias_rad", 0.1),
]);
