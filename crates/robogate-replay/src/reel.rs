//! Several clips as one document for a page.

use std::collections::hash_map::DefaultHasher;
use std::collections::{BTreeMap, HashMap};
use std::hash::{Hash, Hasher};

use robogate_core::{Solid, SolidShape};
use serde_json::{Value, json};

use crate::clip::Clip;
use crate::mesh::{DETAILS, IndexedMesh};
use crate::pack::packed;

/// The budget of all meshes of a reel, in bytes before compression. Meshes get fewer triangles until they are within it.
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
    let mut pool: Vec<&Solid> = Vec::new();
    let mut known: HashMap<u64, Vec<usize>> = HashMap::new();
    let mut documents = Vec::with_capacity(clips.len());
    for clip in clips {
        let mut document = clip.document();
        for solid in clip.recording.trajectory.iter().flat_map(|trajectory| &trajectory.solids) {
            let same = known.entry(key(solid)).or_default();
            let at = same.iter().copied().find(|at| pool[*at] == solid).unwrap_or_else(|| {
                pool.push(solid);
                same.push(pool.len() - 1);
                pool.len() - 1
            });
            document.solids.push(at);
        }
        documents.push(document);
    }
    let mut meshes = Meshes::of(&pool);
    let solids: Vec<Value> = pool.iter().enumerate().map(|(at, solid)| meshes.solid(at, solid)).collect();
    // Values, strings and finite numbers always serialise.
    let solids = serde_json::to_vec(&solids).unwrap_or_default();
    let whole = json!({ "version": 1, "solids": packed(&solids), "clips": documents });
    Reel { json: whole.to_string().replace('<', "\\u003c"), simplified: meshes.boxes }
}

/// A number that equal solids have in common.
fn key(solid: &Solid) -> u64 {
    let mut hasher = DefaultHasher::new();
    solid.body.hash(&mut hasher);
    solid.pose.to_array().map(f64::to_bits).hash(&mut hasher);
    if let SolidShape::Mesh { triangles } = &solid.shape {
        triangles.iter().flatten().flatten().for_each(|x| x.to_bits().hash(&mut hasher));
    }
    hasher.finish()
}

/// The meshes of a reel, by the place of their solid.
struct Meshes {
    detailed: BTreeMap<usize, IndexedMesh>,
    /// Bytes of the meshes so far.
    used: usize,
    /// Meshes that became boxes.
    boxes: usize,
}

impl Meshes {
    /// The meshes of these solids, all with the finest detail that is within the budget.
    fn of(solids: &[&Solid]) -> Self {
        let mut full: BTreeMap<usize, IndexedMesh> = BTreeMap::new();
        for (at, solid) in solids.iter().enumerate() {
            if let SolidShape::Mesh { triangles } = &solid.shape {
                full.insert(at, IndexedMesh::of(triangles));
            }
        }
        let mut detailed = full.clone();
        for cells in DETAILS {
            if detailed.values().map(IndexedMesh::bytes).sum::<usize>() <= MESH_BUDGET_BYTES {
                break;
            }
            detailed = full.iter().map(|(at, mesh)| (*at, mesh.with_detail(cells))).collect();
        }
        Self { detailed, used: 0, boxes: 0 }
    }

    fn solid(&mut self, at: usize, solid: &Solid) -> Value {
        let [x, y, z] = solid.pose.position.map(rounded);
        let [w, i, j, k] = solid.pose.orientation.map(rounded);
        let mut place = [x, y, z, w, i, j, k];
        let shape = match &solid.shape {
            SolidShape::Box { half } => json!({ "box": half }),
            SolidShape::Sphere { radius } => json!({ "sphere": radius }),
            SolidShape::Capsule { radius, half_height } => json!({ "capsule": [radius, half_height] }),
            SolidShape::Cylinder { radius, half_height } => json!({ "cylinder": [radius, half_height] }),
            SolidShape::Mesh { .. } => self.mesh(at, &mut place),
        };
        let mut value = json!({ "body": solid.body, "at": place, "color": solid.color, "shape": shape });
        if solid.opacity < 1.0 {
            value["opacity"] = json!(solid.opacity);
        }
        value
    }

    /// An indexed mesh in units of 0.1 mm, or the bounding box of a mesh beyond the budget.
    fn mesh(&mut self, at: usize, place: &mut [f64; 7]) -> Value {
        let mesh = self.detailed.remove(&at).unwrap_or_default();
        if self.used + mesh.bytes() <= MESH_BUDGET_BYTES {
            self.used += mesh.bytes();
            return json!({ "mesh": { "corners": mesh.corners.concat(), "faces": mesh.faces.concat() } });
        }
        self.boxes += 1;
        let ranges = mesh.bounds().map(|range| range.map(|x| f64::from(x) * 1e-4));
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
