//! Shapes and contacts as entities of a 3-D view.

use std::collections::BTreeMap;

use robogate_core::{ContactBetween, ContactPoint, Pose, Solid, SolidShape, Trajectory};
use serde_json::{Value, json};

use super::{ROOT, stamp};

/// The length of a contact's arrow per newton, in metres, and the largest length.
const ARROW_M_PER_N: f64 = 0.005;
const LONGEST_ARROW_M: f64 = 0.3;

/// A position or a size.
pub(super) fn vector([x, y, z]: [f64; 3]) -> Value {
    json!({ "x": rounded(x), "y": rounded(y), "z": rounded(z) })
}

/// A rotation. The scalar part is the first number here and `w` there.
pub(super) fn rotation([w, x, y, z]: [f64; 4]) -> Value {
    json!({ "x": rounded(x), "y": rounded(y), "z": rounded(z), "w": rounded(w) })
}

/// A number to a micrometre, or a quaternion to the sixth digit.
fn rounded(x: f64) -> f64 {
    (x * 1e6).round() / 1e6
}

fn pose(pose: Pose) -> Value {
    json!({ "position": vector(pose.position), "orientation": rotation(pose.orientation) })
}

fn color([r, g, b]: [u8; 3], opacity: f64) -> Value {
    let share = |x: u8| (f64::from(x) / 255.0 * 1e3).round() / 1e3;
    json!({ "r": share(r), "g": share(g), "b": share(b), "a": opacity })
}

/// One entity for each body with a shape, locked to the body's frame.
pub(super) fn bodies(trajectory: &Trajectory, frames: &[String], time_s: f64) -> Value {
    let mut entities = Vec::new();
    for (body, frame) in frames.iter().enumerate() {
        let mut kinds: BTreeMap<&str, Vec<Value>> = BTreeMap::new();
        for solid in trajectory.solids.iter().filter(|solid| solid.body == body) {
            for (kind, primitive) in primitives(solid) {
                kinds.entry(kind).or_default().push(primitive);
            }
        }
        if !kinds.is_empty() {
            entities.push(entity(frame, frame, time_s, kinds));
        }
    }
    json!({ "deletions": [], "entities": entities })
}

fn entity(frame: &str, name: &str, time_s: f64, kinds: BTreeMap<&str, Vec<Value>>) -> Value {
    let mut entity = json!({
        "timestamp": stamp(time_s),
        "frame_id": frame,
        "id": name,
        "lifetime": { "sec": 0, "nsec": 0 },
        "frame_locked": true,
        "metadata": [],
    });
    for kind in ["arrows", "cubes", "spheres", "cylinders", "triangles"] {
        entity[kind] = json!(kinds.get(kind).cloned().unwrap_or_default());
    }
    entity
}

/// A solid as primitives with their kinds. A capsule is a cylinder with two balls.
fn primitives(solid: &Solid) -> Vec<(&'static str, Value)> {
    let color = color(solid.color, solid.opacity);
    let at = pose(solid.pose);
    let cylinder = |radius: f64, half_height: f64| {
        let size = vector([2.0 * radius, 2.0 * radius, 2.0 * half_height]);
        json!({ "pose": at, "size": size, "bottom_scale": 1.0, "top_scale": 1.0, "color": color })
    };
    let ball = |at: Value, radius: f64| json!({ "pose": at, "size": vector([2.0 * radius; 3]), "color": color });
    match &solid.shape {
        SolidShape::Box { half } => {
            vec![("cubes", json!({ "pose": at, "size": vector(half.map(|x| 2.0 * x)), "color": color }))]
        }
        SolidShape::Sphere { radius } => vec![("spheres", ball(at.clone(), *radius))],
        SolidShape::Cylinder { radius, half_height } => vec![("cylinders", cylinder(*radius, *half_height))],
        SolidShape::Capsule { radius, half_height } => {
            let mut parts = vec![("cylinders", cylinder(*radius, *half_height))];
            for z in [-half_height, *half_height] {
                let [x, y, z] = rotated(solid.pose.orientation, [0.0, 0.0, z]);
                let [a, b, c] = solid.pose.position;
                let end = Pose { position: [a + x, b + y, c + z], orientation: solid.pose.orientation };
                parts.push(("spheres", ball(pose(end), *radius)));
            }
            parts
        }
        SolidShape::Mesh { triangles } => {
            let mut points: Vec<Value> = Vec::new();
            let mut known: BTreeMap<[i64; 3], usize> = BTreeMap::new();
            let mut indices = Vec::with_capacity(3 * triangles.len());
            for corner in triangles.iter().flatten() {
                let corner = corner.map(f64::from);
                let at = *known.entry(corner.map(|x| (x * 1e6).round() as i64)).or_insert_with(|| {
                    points.push(vector(corner));
                    points.len() - 1
                });
                indices.push(at);
            }
            let mesh = json!({ "pose": at, "points": points, "color": color, "colors": [], "indices": indices });
            vec![("triangles", mesh)]
        }
    }
}

/// Rotates a vector by a unit quaternion (w, x, y, z).
fn rotated([w, x, y, z]: [f64; 4], [a, b, c]: [f64; 3]) -> [f64; 3] {
    let [tx, ty, tz] = [2.0 * (y * c - z * b), 2.0 * (z * a - x * c), 2.0 * (x * b - y * a)];
    [a + w * tx + y * tz - z * ty, b + w * ty + z * tx - x * tz, c + w * tz + x * ty - y * tx]
}

/// The length of a vector.
fn length(of: [f64; 3]) -> f64 {
    of.iter().map(|x| x * x).sum::<f64>().sqrt()
}

/// An arrow for each contact, in one entity that replaces the one of the last frame.
pub(super) fn arrows(contacts: &[ContactPoint], time_s: f64) -> Value {
    let arrows = contacts.iter().filter(|contact| length(contact.force_n) > 0.0).map(arrow).collect();
    let entity = entity(ROOT, "contacts", time_s, BTreeMap::from([("arrows", arrows)]));
    json!({ "deletions": [], "entities": [entity] })
}

fn arrow(contact: &ContactPoint) -> Value {
    let force = length(contact.force_n);
    let whole = (ARROW_M_PER_N * force).clamp(0.01, LONGEST_ARROW_M);
    let at = Pose { position: contact.position, orientation: from_x(contact.force_n.map(|x| x / force)) };
    let shade = match contact.between {
        ContactBetween::RobotAndObject => [214, 102, 30],
        ContactBetween::RobotAndSurroundings => [200, 40, 40],
        ContactBetween::ObjectAndSurroundings => [110, 120, 130],
    };
    json!({
        "pose": pose(at),
        "shaft_length": rounded(0.75 * whole),
        "shaft_diameter": 0.004,
        "head_length": rounded(0.25 * whole),
        "head_diameter": 0.01,
        "color": color(shade, 1.0),
    })
}

/// The shortest rotation from the x axis to a unit vector.
fn from_x([x, y, z]: [f64; 3]) -> [f64; 4] {
    if x < -1.0 + 1e-9 {
        return [0.0, 0.0, 0.0, 1.0];
    }
    let q = [1.0 + x, 0.0, -z, y];
    let norm = q.iter().map(|x| x * x).sum::<f64>().sqrt();
    q.map(|x| x / norm)
}

/// The contacts as numbers.
pub(super) fn contacts(contacts: &[ContactPoint], time_s: f64) -> Value {
    let one = |contact: &ContactPoint| {
        let between = match contact.between {
            ContactBetween::RobotAndObject => "robot and object",
            ContactBetween::RobotAndSurroundings => "robot and surroundings",
            ContactBetween::ObjectAndSurroundings => "object and surroundings",
        };
        json!({ "between": between, "position": vector(contact.position), "force_n": vector(contact.force_n) })
    };
    let on_robot = contacts.iter().filter(|contact| contact.between != ContactBetween::ObjectAndSurroundings);
    let total: f64 = on_robot.map(|contact| length(contact.force_n)).sum();
    let contacts: Vec<Value> = contacts.iter().map(one).collect();
    json!({ "timestamp": stamp(time_s), "total_force_n": rounded(total), "contacts": contacts })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn arrows_point_along_the_force() {
        for force in [[1.0, 0.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.6, -0.8], [0.0, 0.0, 1.0]] {
            let along = rotated(from_x(force), [1.0, 0.0, 0.0]);
            assert!(along.iter().zip(force).all(|(a, b)| (a - b).abs() < 1e-12), "{force:?}: {along:?}");
        }
    }
}
