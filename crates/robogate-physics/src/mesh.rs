//! Closed triangle meshes: solids with a volume.

use std::collections::HashMap;

use nalgebra::{Matrix3, Point3, Vector3};

use crate::Triangles;

/// Smallest and largest bounding box along its longest edge, in metres.
const SIZE_M: [f64; 2] = [1e-3, 5.0];

/// A solid whose surface is a closed mesh of triangles. Lengths are in metres.
#[derive(Debug, Clone, PartialEq)]
pub struct Mesh {
    vertices: Vec<Point3<f64>>,
    /// The triangles of each connected surface, counter-clockwise seen from outside.
    bodies: Vec<Vec<[u32; 3]>>,
    bulk: Bulk,
}

/// Volume, and what follows from it for a homogeneous solid of unit mass.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Bulk {
    /// Volume in cubic metres.
    pub volume_m3: f64,
    /// Centre of mass, in metres.
    pub centre: Vector3<f64>,
    /// Inertia about the centre of mass, in m^2.
    pub inertia_m2: Matrix3<f64>,
}

impl Mesh {
    /// The solid of a file whose unit is `unit_m` metres.
    ///
    /// # Errors
    /// If its surface is not closed, has no volume, or has a size that no part of a cell has.
    pub fn new(read: &Triangles, unit_m: f64) -> Result<Self, String> {
        if read.faces.is_empty() {
            return Err("it has vertices but no faces. Expected a closed surface".to_owned());
        }
        let vertices: Vec<_> = read.vertices.iter().map(|point| point * unit_m).collect();
        check_size(&vertices, &read.faces, unit_m)?;
        // Many programs write the corners of each triangle separately, so corners at the same place are the same. Surfaces that
        // touch each other are left apart if the file says so.
        let (vertices, faces) = match open_edge(&read.faces) {
            None => (vertices, read.faces.clone()),
            Some(_) => welded(&vertices, &read.faces),
        };
        if let Some((count, [a, b])) = open_edge(&faces) {
            let [from, to] = [a, b].map(|index| shown(&vertices[index as usize], unit_m));
            return Err(format!(
                "its surface is not closed: {count} edges do not join two triangles that face the same way, such as the one from {from} \
                 to {to} in the unit of the file. Close it in a mesh editor (`make manifold`)"
            ));
        }
        let mut bodies = connected(&faces, vertices.len());
        let volumes: Vec<f64> = bodies.iter().map(|body| bulk(&vertices, std::iter::once(body)).volume_m3).collect();
        if volumes.iter().all(|volume| *volume < 0.0) {
            bodies.iter_mut().flatten().for_each(|triangle| triangle.swap(1, 2));
        } else if let Some(inside_out) = volumes.iter().position(|volume| *volume < 0.0) {
            let at = shown(&vertices[bodies[inside_out][0][0] as usize], unit_m);
            return Err(format!(
                "the surface at {at} in the unit of the file faces inwards and others face outwards. Expected no cavity, and triangles \
                 that are counter-clockwise seen from outside"
            ));
        }
        let bulk = bulk(&vertices, &bodies);
        let [low, high] = bounds(bodies.iter().flatten().flatten().map(|index| &vertices[*index as usize]));
        if bulk.volume_m3 < 1e-6 * (high - low).max().powi(3) {
            return Err("it has no volume. Expected a solid, not a flat surface".to_owned());
        }
        Ok(Self { vertices, bodies, bulk })
    }

    /// Volume, centre of mass and inertia. Bodies that overlap count twice where they do.
    pub fn bulk(&self) -> &Bulk {
        &self.bulk
    }

    /// The vertices.
    pub fn vertices(&self) -> &[Point3<f64>] {
        &self.vertices
    }

    /// The triangles of each connected surface as indices of vertices.
    pub(crate) fn bodies(&self) -> &[Vec<[u32; 3]>] {
        &self.bodies
    }

    /// The triangles as indices of vertices.
    pub fn triangles(&self) -> impl Iterator<Item = &[u32; 3]> {
        self.bodies.iter().flatten()
    }

    /// The corners of each triangle.
    pub fn corners(&self) -> impl Iterator<Item = [Point3<f64>; 3]> {
        self.triangles().map(|triangle| triangle.map(|index| self.vertices[index as usize]))
    }

    /// The same solid in a frame with this origin.
    pub(crate) fn about(&self, origin: &Vector3<f64>) -> Self {
        let vertices = self.vertices.iter().map(|point| point - origin).collect();
        Self { vertices, bodies: self.bodies.clone(), bulk: Bulk { centre: self.bulk.centre - origin, ..self.bulk } }
    }
}

/// A point in the unit of the file.
fn shown(point: &Point3<f64>, unit_m: f64) -> String {
    let rounded = |x: f64| ((x / unit_m) * 1e4).round() / 1e4 + 0.0;
    format!("({}, {}, {})", rounded(point.x), rounded(point.y), rounded(point.z))
}

/// The smallest and the largest coordinates of points.
pub(crate) fn bounds<'a>(points: impl Iterator<Item = &'a Point3<f64>>) -> [Vector3<f64>; 2] {
    let all = [Vector3::repeat(f64::INFINITY), Vector3::repeat(f64::NEG_INFINITY)];
    points.fold(all, |[low, high], point| [low.inf(&point.coords), high.sup(&point.coords)])
}

/// Checks the size, which a wrong unit makes a thousand times too large or too small.
fn check_size(vertices: &[Point3<f64>], faces: &[[u32; 3]], unit_m: f64) -> Result<(), String> {
    let [low, high] = bounds(faces.iter().flatten().map(|index| &vertices[*index as usize]));
    let size = (high - low).max();
    let [smallest, largest] = SIZE_M;
    if (smallest..=largest).contains(&size) {
        return Ok(());
    }
    let fits = |factor: f64| (smallest..=largest).contains(&(size * factor));
    let other = [(1e-3, "mm"), (1e-2, "cm"), (1.0, "m")]
        .into_iter()
        .filter(|(other, _)| (other / unit_m - 1.0).abs() > 1e-9)
        .find(|(other, _)| fits(other / unit_m));
    let question = match other {
        Some((_, unit)) => format!("Is the file in {unit}? Then write `unit = \"{unit}\"`"),
        None => format!("Expected {} mm to {largest} m", 1e3 * smallest),
    };
    Err(format!("its largest extent is {size:.3} m. {question}"))
}

/// Unites vertices at the same place, and removes triangles that have become lines.
fn welded(vertices: &[Point3<f64>], faces: &[[u32; 3]]) -> (Vec<Point3<f64>>, Vec<[u32; 3]>) {
    let mut known: HashMap<[u64; 3], u32> = HashMap::with_capacity(vertices.len());
    let mut kept = Vec::new();
    let index: Vec<u32> = vertices
        .iter()
        .map(|point| {
            // 0 and -0 are the same.
            let bits = [point.x, point.y, point.z].map(|x| (x + 0.0).to_bits());
            *known.entry(bits).or_insert_with(|| {
                kept.push(*point);
                kept.len() as u32 - 1
            })
        })
        .collect();
    let faces = faces.iter().map(|face| face.map(|corner| index[corner as usize]));
    (kept, faces.filter(|[a, b, c]| a != b && b != c && c != a).collect())
}

/// How many edges are not passed as often in one direction as in the other, and the first of them.
fn open_edge(faces: &[[u32; 3]]) -> Option<(usize, [u32; 2])> {
    let mut balance: HashMap<[u32; 2], i64> = HashMap::with_capacity(2 * faces.len());
    let edges = || faces.iter().flat_map(|[a, b, c]| [[*a, *b], [*b, *c], [*c, *a]]);
    let ordered = |[a, b]: [u32; 2]| [a.min(b), a.max(b)];
    for edge in edges() {
        *balance.entry(ordered(edge)).or_default() += if edge[0] < edge[1] { 1 } else { -1 };
    }
    let count = balance.values().filter(|balance| **balance != 0).count();
    edges().find(|edge| balance[&ordered(*edge)] != 0).map(|edge| (count, edge))
}

/// The triangles of each connected surface, in the order of their first triangles.
fn connected(faces: &[[u32; 3]], vertices: usize) -> Vec<Vec<[u32; 3]>> {
    let mut parent: Vec<u32> = (0..vertices as u32).collect();
    fn root(parent: &mut [u32], mut of: u32) -> u32 {
        while parent[of as usize] != of {
            parent[of as usize] = parent[parent[of as usize] as usize];
            of = parent[of as usize];
        }
        of
    }
    for [a, b, c] in faces {
        for other in [b, c] {
            let (one, other) = (root(&mut parent, *a), root(&mut parent, *other));
            parent[other as usize] = one;
        }
    }
    let mut order: HashMap<u32, usize> = HashMap::new();
    let mut bodies: Vec<Vec<[u32; 3]>> = Vec::new();
    for face in faces {
        let body = *order.entry(root(&mut parent, face[0])).or_insert_with(|| {
            bodies.push(Vec::new());
            bodies.len() - 1
        });
        bodies[body].push(*face);
    }
    bodies
}

/// Volume, centre and inertia of closed surfaces: the sum over the tetrahedra between each triangle and a point (Tonon 2004).
fn bulk<'a>(vertices: &[Point3<f64>], bodies: impl IntoIterator<Item = &'a Vec<[u32; 3]>>) -> Bulk {
    let [low, high] = bounds(vertices.iter());
    // A point in the middle keeps the terms small.
    let middle = 0.5 * (low + high);
    let (mut volume, mut first, mut second) = (0.0, Vector3::zeros(), Matrix3::zeros());
    for triangle in bodies.into_iter().flatten() {
        let [a, b, c] = triangle.map(|index| vertices[index as usize].coords - middle);
        let sixth = a.dot(&b.cross(&c)) / 6.0;
        let sum = a + b + c;
        volume += sixth;
        first += sum * (sixth / 4.0);
        let outer = a * a.transpose() + b * b.transpose() + c * c.transpose() + sum * sum.transpose();
        second += outer * (sixth / 20.0);
    }
    let centre = first / volume;
    let about = second / volume - centre * centre.transpose();
    let inertia = Matrix3::identity() * about.trace() - about;
    Bulk { volume_m3: volume, centre: centre + middle, inertia_m2: inertia }
}
