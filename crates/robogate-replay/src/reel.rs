//! Several clips as one document for a page.

use std::collections::BTreeMap;

use robogate_core::{Solid, SolidShape};
use serde_json::{Value, json};

use crate::clip::Clip;
use crate::pack::packed;

/// The budget of all meshes of a reel, in bytes before compression. A mesh beyond it is shown as its bounding box.
pub const MESH_BUDGET_BYTES: usize = 900_000;

/// Clips as one JSON document.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Reel {
    /// The document. It contains no `<`, so it can be placed in a page.
    pub json: String,
    /// Number of meshes that are shown as their bounding boxes, because the budget is used up.
    pub simplified: usize,
}

/// Packs clips for the viewer of a page. Solids that several clips share are stored once.
pub fn reel(clips: &[Clip]) -> Reel {
    let mut pool: Vec<Value> = Vec::new();
    let mut known: BTreeMap<String, usize> = BTreeMap::new();
    let mut meshes = Meshes { used: 0, simplified: 0 };
    let mut documents = Vec::with_capacity(clips.len());
    for clip in clips {
        let mut document = clip.document();
        for solid in clip.recording.trajectory.iter().flat_map(|trajectory| &trajectory.solids) {
            let key = format!("{solid:?}");
            let at = known.get(&key).copied().unwrap_or_else(|| {
                pool.push(meshes.solid(solid));
                known.insert(key, pool.len() - 1);
                pool.len() - 1
            });
            document.solids.push(at);
        }
        documents.push(document);
    }
    // Values, strings and finite numbers always serialise.
    let solids = serde_json::to_vec(&pool).unwrap_or_default();
    let whole = json!({ "version": 1, "solids": packed(&solids), "clips": documents });
    Reel { json: whole.to_string().replace('<', "\\u003c"), simplified: meshes.simplified }
}

/// The meshes of a reel so far.
struct Meshes {
    used: usize,
    simplified: usize,
}

impl Meshes {
    fn solid(&mut self, solid: &Solid) -> Value {
        let [x, y, z] = solid.pose.position.map(rounded);
        let [w, i, j, k] = solid.pose.orientation.map(rounded);
        let mut place = [x, y, z, w, i, j, k];
        let shape = match &solid.shape {
            SolidShape::Box { half } => json!({ "box": half }),
            SolidShape::Sphere { radius } => json!({ "sphere": radius }),
            SolidShape::Capsule { radius, half_height } => json!({ "capsule": [radius, half_height] }),
            SolidShape::Cylinder { radius, half_height } => json!({ "cylinder": [radius, half_height] }),
            SolidShape::Mesh { triangles } => self.mesh(triangles, &mut place),
        };
        let mut value = json!({ "body": solid.body, "at": place, "color": solid.color, "shape": shape });
        if solid.opacity < 1.0 {
            value["opacity"] = json!(solid.opacity);
        }
        value
    }

    /// An indexed mesh in units of 0.1 mm, or the bounding box of a mesh beyond the budget.
    fn mesh(&mut self, triangles: &[[[f32; 3]; 3]], place: &mut [f64; 7]) -> Value {
        let mut corners: Vec<[i32; 3]> = Vec::new();
        let mut known: BTreeMap<[i32; 3], usize> = BTreeMap::new();
        let mut faces: Vec<usize> = Vec::with_capacity(3 * triangles.len());
        for corner in triangles.iter().flatten() {
            let corner = corner.map(|x| (x * 1e4).round() as i32);
            let at = *known.entry(corner).or_insert_with(|| {
                corners.push(corner);
                corners.len() - 1
            });
            faces.push(at);
        }
        let bytes = 12 * corners.len() + 4 * faces.len();
        if self.used + bytes <= MESH_BUDGET_BYTES {
            self.used += bytes;
            return json!({ "mesh": { "corners": corners.concat(), "faces": faces } });
        }
        self.simplified += 1;
        let range = |axis: usize| {
            let values = || corners.iter().map(|corner| corner[axis]);
            [values().min().unwrap_or_default(), values().max().unwrap_or_default()].map(|x| f64::from(x) * 1e-4)
        };
        let ranges = [range(0), range(1), range(2)];
        let centre = ranges.map(|[low, high]| 0.5 * (low + high));
        let moved = rotate([place[3], place[4], place[5], place[6]], centre);
        for (to, by) in place.iter_mut().zip(moved) {
            *to = rounded(*to + by);
        }
        json!({ "box": ranges.map(|[low, high]| rounded(0.5 * (high - low))) })
    }
}

/// Rotates a vector by a unit quaternion (w, x, y, z).
fn rotate([w, x, y, z]: [f64; 4], [a, b, c]: [f64; 3]) -> [f64; 3] {
    let [tx, ty, tz] = [2.0 * (y * c - z * b), 2.0 * (z * a - x * c), 2.0 * (x * b - y * a)];
    [a + w * tx + y * tz - z * ty, b + w * ty + z * tx - x * tz, c + w * tz + x * ty - y * tx]
}

/// A number to a micrometre, or a quaternion to the sixth digit.
fn rounded(x: f64) -> f64 {
    (x * 1e6).round() / 1e6
}
