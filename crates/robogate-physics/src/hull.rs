//! Convex pieces of a mesh. All engines get the same pieces: they follow from the mesh alone, without randomness.

mod divide;
mod shell;

use std::sync::Arc;

use nalgebra::{Isometry3, Point3, Translation3, Vector3};
use parry3d_f64::math::Vector;
use parry3d_f64::query::PointQuery;
use parry3d_f64::shape::TriMesh;
use robogate_core::guard::guarded;

use self::divide::{contains, divide};
use self::shell::{Shell, signed_volume};
use crate::mesh::bounds;
use crate::{Mesh, Part, Primitive, Triangles};

/// The largest number of pieces of a mesh.
pub const MOST_PIECES: usize = 64;

/// A body that fills its convex hull up to this fraction is convex, and so are pieces whose common hull exceeds them by less.
const CONVEX: f64 = 1e-3;

/// Distances are measured at points that are this fraction of the size apart, and at no more than so many points.
const SPACING: f64 = 1.0 / 60.0;
const MOST_POINTS: usize = 60_000;

/// A convex piece of a mesh. The centre of its bounding box is its origin.
#[derive(Debug, Clone, PartialEq)]
pub struct Hull {
    corners: Vec<Point3<f64>>,
    /// The planes of its faces: outward unit normal, and distance from the origin.
    planes: Vec<(Vector3<f64>, f64)>,
    half: [f64; 3],
    mesh: Option<Arc<Mesh>>,
}

impl Hull {
    /// The corners, in metres.
    pub fn corners(&self) -> &[Point3<f64>] {
        &self.corners
    }

    /// Half of the edges of its bounding box, in metres.
    pub fn half(&self) -> [f64; 3] {
        self.half
    }

    /// The mesh of which it is a piece, in the frame of this piece. Of all pieces of a mesh the first one has it: it is drawn and
    /// weighed in place of the pieces.
    pub fn mesh(&self) -> Option<&Mesh> {
        self.mesh.as_deref()
    }

    /// How far it reaches from its origin against and along a unit vector, in metres.
    pub(crate) fn extent(&self, along: &Vector3<f64>) -> [f64; 2] {
        let reach = self.corners.iter().map(|corner| corner.coords.dot(along));
        reach.fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], x| [low.min(x), high.max(x)])
    }

    /// The part of a ray within it, in multiples of the direction.
    pub(crate) fn along(&self, from: &Point3<f64>, direction: &Vector3<f64>) -> Option<(f64, f64)> {
        let (mut enter, mut leave) = (f64::NEG_INFINITY, f64::INFINITY);
        for (normal, distance) in &self.planes {
            let (height, speed) = (normal.dot(&from.coords) - distance, normal.dot(direction));
            if speed.abs() < 1e-12 {
                if height > 0.0 {
                    return None;
                }
            } else if speed < 0.0 {
                enter = enter.max(-height / speed);
            } else {
                leave = leave.min(-height / speed);
            }
        }
        Some((enter, leave))
    }
}

/// The convex pieces of a mesh, in its frame.
#[derive(Debug, Clone)]
pub struct Pieces {
    /// The pieces. The first one has the mesh.
    pub parts: Vec<Part>,
    /// Sum of the volumes of the pieces as a multiple of that of the mesh.
    pub volume: f64,
    /// Largest distance by which the pieces stand out of the mesh or fall short of it, in metres, measured at points on both.
    pub distance_m: f64,
}

impl Pieces {
    /// Divides a mesh into at most `most` convex pieces. Surfaces of the mesh that are convex are pieces without an error.
    ///
    /// # Errors
    /// If the shape cannot be divided.
    pub fn of(mesh: &Mesh, most: usize) -> Result<Self, String> {
        // The library panics on some degenerate shapes.
        let found = guarded(|| Self::divided(mesh, most.clamp(1, MOST_PIECES)));
        found.ok().flatten().ok_or_else(|| {
            "it cannot be divided into convex pieces: it has parts that are thinner than the numbers of its file can say. Write each \
             convex part as a separate closed surface"
                .to_owned()
        })
    }

    fn divided(mesh: &Mesh, most: usize) -> Option<Self> {
        let mut shells = Vec::new();
        for body in mesh.bodies() {
            let (points, faces) = separate(mesh, body);
            let whole = Shell::of(&points)?;
            if signed_volume(&points, &faces) >= (1.0 - CONVEX) * whole.volume {
                shells.push(whole);
            } else {
                shells.extend(divide(&points, &faces, most)?);
            }
        }
        merge(&mut shells, most, mesh.bulk().volume_m3);
        let volume = shells.iter().map(|shell| shell.volume).sum::<f64>() / mesh.bulk().volume_m3;
        let distance_m = distance(mesh, &shells)?;
        let mut parts = Vec::with_capacity(shells.len());
        for shell in &shells {
            let (mut hull, centre) = shell.hull();
            hull.mesh = parts.is_empty().then(|| Arc::new(mesh.about(&centre)));
            let pose = Isometry3::from_parts(Translation3::from(centre), nalgebra::UnitQuaternion::identity());
            parts.push(Part { primitive: Primitive::Hull(Arc::new(hull)), pose });
        }
        (!parts.is_empty()).then_some(Self { parts, volume, distance_m })
    }
}

impl Triangles {
    /// The convex hull. `None` if the vertices have no volume.
    pub fn hull(&self) -> Option<Self> {
        let points: Vec<Vector> = self.vertices.iter().map(vector).collect();
        let shell = guarded(|| Shell::of(&points)).ok().flatten()?;
        let flat = shell.faces.iter().map(|face| face.corners).collect();
        Some(Self { vertices: shell.points.iter().map(|p| Point3::new(p.x, p.y, p.z)).collect(), faces: flat })
    }
}

fn vector(point: &Point3<f64>) -> Vector {
    Vector::new(point.x, point.y, point.z)
}

/// A surface with its own vertices.
fn separate(mesh: &Mesh, body: &[[u32; 3]]) -> (Vec<Vector>, Vec<[u32; 3]>) {
    let mut used: Vec<u32> = body.iter().flatten().copied().collect();
    used.sort_unstable();
    used.dedup();
    let index = |old: u32| used.binary_search(&old).unwrap_or_default() as u32;
    let faces = body.iter().map(|face| face.map(index)).collect();
    (used.iter().map(|old| vector(&mesh.vertices()[*old as usize])).collect(), faces)
}

/// Unites the pieces whose common hull adds least volume, while there are too many, or while it adds almost none.
fn merge(shells: &mut Vec<Shell>, most: usize, whole: f64) {
    let united = |a: &Shell, b: &Shell| {
        let points: Vec<Vector> = a.points.iter().chain(&b.points).copied().collect();
        let shell = Shell::of(&points)?;
        Some((shell.volume - a.volume - b.volume, shell))
    };
    // The added volume of each pair.
    let mut costs: Vec<Vec<f64>> = Vec::new();
    let cost = |a: &Shell, b: &Shell| united(a, b).map_or(f64::INFINITY, |(cost, _)| cost.max(0.0));
    for (index, shell) in shells.iter().enumerate() {
        costs.push(shells[..index].iter().map(|other| cost(other, shell)).collect());
    }
    loop {
        let pairs =
            costs.iter().enumerate().flat_map(|(i, row)| row.iter().enumerate().map(move |(j, cost)| (*cost, i, j)));
        let Some((least, i, j)) = pairs.min_by(|a, b| a.0.total_cmp(&b.0)) else { return };
        if shells.len() <= most && least > 0.1 * CONVEX * whole {
            return;
        }
        let Some((_, shell)) = united(&shells[i], &shells[j]) else { return };
        shells[j] = shell;
        shells.remove(i);
        costs.remove(i);
        costs.iter_mut().skip(i).for_each(|row| {
            row.remove(i);
        });
        for other in (0..shells.len()).filter(|other| *other != j) {
            costs[other.max(j)][other.min(j)] = cost(&shells[other], &shells[j]);
        }
    }
}

/// The largest distance between the surface of a mesh and that of its pieces, where one is outside of the other.
fn distance(mesh: &Mesh, shells: &[Shell]) -> Option<f64> {
    let [low, high] = bounds(mesh.triangles().flatten().map(|index| &mesh.vertices()[*index as usize]));
    let size = (high - low).max();
    let within = |point: &Vector, but: Option<usize>| {
        shells.iter().enumerate().any(|(index, shell)| Some(index) != but && shell.height(point) <= 1e-6 * size)
    };
    let (mut points, mut faces) = (Vec::new(), Vec::new());
    for shell in shells {
        let first = points.len() as u32;
        points.extend(&shell.points);
        faces.extend(shell.faces.iter().map(|face| face.corners.map(|index| index + first)));
    }
    let surface = TriMesh::new(points, faces).ok()?;
    let vertices: Vec<Vector> = mesh.vertices().iter().map(vector).collect();
    let faces: Vec<[u32; 3]> = mesh.triangles().copied().collect();
    let original = TriMesh::new(vertices.clone(), faces.clone()).ok()?;
    let triangles = |shell: &Shell| {
        let corners = shell.faces.iter().map(|face| face.corners.map(|index| shell.points[index as usize]));
        corners.collect::<Vec<_>>()
    };
    let of_mesh: Vec<[Vector; 3]> = mesh.corners().map(|corners| corners.map(|corner| vector(&corner))).collect();
    let mut farthest: f64 = 0.0;
    samples(&of_mesh, size, &mut |point| {
        if !within(point, None) {
            farthest = farthest.max(surface.project_local_point(*point, false).point.distance(*point));
        }
    });
    for (index, shell) in shells.iter().enumerate() {
        samples(&triangles(shell), size, &mut |point| {
            if within(point, Some(index)) {
                return;
            }
            let off = original.project_local_point(*point, false).point.distance(*point);
            if off > farthest && !contains(&vertices, &faces, point) {
                farthest = off;
            }
        });
    }
    Some(farthest)
}

/// Points on triangles, evenly spaced.
fn samples(triangles: &[[Vector; 3]], size: f64, sink: &mut dyn FnMut(&Vector)) {
    let most = (MOST_POINTS / triangles.len().max(1)).max(3);
    for [a, b, c] in triangles {
        let longest = (*b - *a).length().max((*c - *b).length()).max((*a - *c).length());
        let mut rows = (longest / (SPACING * size)).ceil().max(1.0) as usize;
        while (rows + 1) * (rows + 2) / 2 > most.max(3) && rows > 1 {
            rows -= 1;
        }
        for i in 0..=rows {
            for j in 0..=rows - i {
                let (u, v) = (i as f64 / rows as f64, j as f64 / rows as f64);
                sink(&(*a + (*b - *a) * u + (*c - *a) * v));
            }
        }
    }
}
