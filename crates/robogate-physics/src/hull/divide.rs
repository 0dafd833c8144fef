//! Divides a solid into convex parts by planes.

use std::collections::HashMap;

use parry3d_f64::math::Vector;

use super::CONVEX;
use super::shell::{Shell, signed_volume};

/// Bounds on the number of planes that are tried for a cut, which times the number of polygons is at most the work, if it can be.
const LEAST_PLANES: usize = 12;
const MOST_PLANES: usize = 120;
const WORK: usize = 80_000;

/// A part of a solid while it is divided: the pieces of its surface, whose hull is that of the part.
#[derive(Debug)]
struct Chunk {
    points: Vec<Vector>,
    /// Convex polygons as indices of points, with their outward normals of any length.
    surface: Vec<(Vec<u32>, Vector)>,
    /// The planes of the cuts around it, with the part below.
    planes: Vec<Plane>,
    /// Points inside the solid at which three of these planes meet.
    inner: Vec<Vector>,
    shell: Shell,
    /// The best cut through it: by how much it reduces the volume of the hulls, and its two sides.
    cut: Option<(f64, [Box<Self>; 2])>,
}

/// A unit normal, and the distance from the origin.
type Plane = (Vector, f64);

/// A solid that is divided.
struct Solid<'a> {
    points: &'a [Vector],
    faces: &'a [[u32; 3]],
    notches: Vec<Plane>,
}

/// Divides a closed surface by planes: always by the one that reduces the volume of the hulls most, until they fill the solid or are as
/// many as allowed. The planes are those of faces that meet in a notch, those between them, and some along the axes.
pub(super) fn divide(points: &[Vector], faces: &[[u32; 3]], most: usize) -> Option<Vec<Shell>> {
    let solid = Solid { points, faces, notches: notches(points, faces) };
    let volume = signed_volume(points, faces);
    let polygon = |face: &[u32; 3]| {
        let [a, b, c] = face.map(|index| points[index as usize]);
        (face.to_vec(), (b - a).cross(c - a))
    };
    let surface = faces.iter().map(polygon).collect();
    let with_cut = |chunk: Chunk| Chunk { cut: chunk.best_cut(&solid), ..chunk };
    let mut chunks = vec![with_cut(Chunk::of(points.to_vec(), surface, Vec::new(), Vec::new())?)];
    while chunks.len() < most && chunks.iter().map(|chunk| chunk.shell.volume).sum::<f64>() > (1.0 + CONVEX) * volume {
        let gain = |chunk: &Chunk| chunk.cut.as_ref().map_or(0.0, |(gain, _)| *gain);
        let best = (0..chunks.len()).max_by(|a, b| gain(&chunks[*a]).total_cmp(&gain(&chunks[*b])))?;
        let sides = if gain(&chunks[best]) > 0.1 * CONVEX * volume {
            chunks.swap_remove(best).cut.map(|(_, sides)| sides)
        } else {
            // The first cut through a ring gains nothing.
            let size = |chunk: &Chunk| if chunk.is_convex() { 0.0 } else { chunk.shell.volume };
            let largest = (0..chunks.len()).max_by(|a, b| size(&chunks[*a]).total_cmp(&size(&chunks[*b])))?;
            if size(&chunks[largest]) <= 0.0 {
                break;
            }
            let chunk = chunks.swap_remove(largest);
            let middle = chunk.middle();
            let sides = chunk.split(&middle, &solid);
            if sides.is_none() {
                chunks.push(chunk);
            }
            sides
        };
        let Some(sides) = sides else { break };
        chunks.extend(sides.map(|side| with_cut(*side)));
    }
    Some(chunks.into_iter().map(|chunk| chunk.shell).collect())
}

/// Planes through the edges at which faces meet in a notch, without those that are almost the same.
fn notches(points: &[Vector], faces: &[[u32; 3]]) -> Vec<Plane> {
    let mut open: HashMap<[u32; 2], usize> = HashMap::new();
    let mut planes: Vec<Plane> = Vec::new();
    let normal = |face: &[u32; 3]| {
        let [a, b, c] = face.map(|index| points[index as usize]);
        (b - a).cross(c - a).normalize_or_zero()
    };
    for (index, face) in faces.iter().enumerate() {
        for (from, to) in [(0, 1), (1, 2), (2, 0)].map(|(from, to)| (face[from], face[to])) {
            let Some(other) = open.remove(&[to, from]) else {
                open.insert([from, to], index);
                continue;
            };
            let [one, two] = [normal(face), normal(&faces[other])];
            let (at, along) = (points[from as usize], points[to as usize] - points[from as usize]);
            // In a notch the second face rises from the plane of the first one.
            if along.cross(two).dot(one) >= -1e-6 * along.length() {
                continue;
            }
            for normal in [one, two, along.cross(one + two).normalize_or_zero()] {
                let plane = (normal, normal.dot(at));
                let same = |known: &Plane| {
                    let sign = known.0.dot(normal).signum();
                    (known.0 * sign - normal).length() < 1e-6 && (known.1 * sign - plane.1).abs() < 1e-9
                };
                let known = planes.iter().rev().take(MOST_PLANES).any(same);
                if normal != Vector::ZERO && !known {
                    planes.push(plane);
                }
            }
        }
    }
    planes
}

impl Chunk {
    fn of(
        points: Vec<Vector>,
        surface: Vec<(Vec<u32>, Vector)>,
        planes: Vec<Plane>,
        inner: Vec<Vector>,
    ) -> Option<Self> {
        let shell = match inner.is_empty() {
            true => Shell::of(&points)?,
            false => Shell::of(&[&points[..], &inner].concat())?,
        };
        Some(Self { points, surface, planes, inner, shell, cut: None })
    }

    /// Whether its surface lies on its hull.
    fn is_convex(&self) -> bool {
        let [low, high] = self.shell.bounds();
        let tolerance = -1e-3 * (high - low).max_element();
        let middle = |polygon: &[u32]| {
            polygon.iter().map(|index| self.points[*index as usize]).sum::<Vector>() / polygon.len() as f64
        };
        self.surface.iter().all(|(polygon, _)| self.shell.height(&middle(polygon)) >= tolerance)
    }

    /// The plane across the middle of its longest edge.
    fn middle(&self) -> Plane {
        let [low, high] = self.shell.bounds();
        let axis = (high - low).max_position();
        (Vector::AXES[axis], 0.5 * (low[axis] + high[axis]))
    }

    /// The cut that leaves hulls of the least volume.
    fn best_cut(&self, solid: &Solid<'_>) -> Option<(f64, [Box<Self>; 2])> {
        let [low, high] = self.shell.bounds();
        let near = 1e-4 * (high - low).max_element();
        // The work is almost the same for any number of triangles.
        let most = (WORK / self.surface.len().max(1)).clamp(LEAST_PLANES, MOST_PLANES);
        let through = |(normal, distance): &&Plane| {
            let heights = || self.shell.points.iter().map(|point| normal.dot(*point) - distance);
            heights().any(|height| height > near) && heights().any(|height| height < -near)
        };
        let found: Vec<Plane> = solid.notches.iter().filter(through).copied().collect();
        let step = found.len().div_ceil(most).max(1);
        let along = |axis: usize| {
            (1..8).map(move |k| (Vector::AXES[axis], low[axis] + (high[axis] - low[axis]) * f64::from(k) / 8.0))
        };
        let mut best = None;
        for plane in found.into_iter().step_by(step).chain((0..3).flat_map(along)) {
            let Some(sides) = self.split(&plane, solid) else { continue };
            let gain = self.shell.volume - sides[0].shell.volume - sides[1].shell.volume;
            if best.as_ref().is_none_or(|(known, _)| gain > *known) {
                best = Some((gain, sides));
            }
        }
        best
    }

    /// Its parts below and above a plane. `None` if one of them has no volume.
    fn split(&self, plane: &Plane, solid: &Solid<'_>) -> Option<[Box<Self>; 2]> {
        let (normal, distance) = plane;
        let [low, high] = self.shell.bounds();
        let tolerance = 1e-9 * (high - low).max_element();
        let heights: Vec<f64> = self.points.iter().map(|point| normal.dot(*point) - distance).collect();
        let mut sides = [Side::new(&self.points), Side::new(&self.points)];
        for (polygon, outward) in &self.surface {
            let height = |index: &u32| heights[*index as usize];
            let rises = polygon.iter().any(|index| height(index) > tolerance);
            let falls = polygon.iter().any(|index| height(index) < -tolerance);
            match (falls, rises) {
                // The solid is behind a piece of the surface that lies in the plane.
                (false, false) => sides[usize::from(outward.dot(*normal) < 0.0)].add(polygon, *outward),
                (true, false) => sides[0].add(polygon, *outward),
                (false, true) => sides[1].add(polygon, *outward),
                (true, true) => {
                    let mut cut = [Vec::new(), Vec::new()];
                    for (from, to) in polygon.iter().zip(polygon.iter().cycle().skip(1)) {
                        let (start, end) = (height(from), height(to));
                        if start <= tolerance {
                            cut[0].push(sides[0].point(*from));
                        }
                        if start >= -tolerance {
                            cut[1].push(sides[1].point(*from));
                        }
                        if start.min(end) < -tolerance && start.max(end) > tolerance {
                            for (side, cut) in sides.iter_mut().zip(&mut cut) {
                                cut.push(side.crossing([*from, *to], [start, end]));
                            }
                        }
                    }
                    for (side, cut) in sides.iter_mut().zip(cut) {
                        side.surface.push((cut, *outward));
                    }
                }
            }
        }
        // A wedge between two cuts through one edge has no surface there, but the edge.
        for (side, sign) in sides.iter_mut().zip([1.0, -1.0]) {
            let middle = side.points.iter().sum::<Vector>() / side.points.len().max(1) as f64;
            for index in (0..heights.len()).filter(|index| heights[*index].abs() <= tolerance) {
                let point = self.points[index];
                let near = point + (middle - point).normalize_or_zero() * (1e5 * tolerance);
                let falls = (normal.dot(near) - distance) * sign < -tolerance;
                let within = |(normal, distance): &Plane| normal.dot(near) - distance < -tolerance;
                if side.index[index].is_none()
                    && falls
                    && self.planes.iter().all(within)
                    && contains(solid.points, solid.faces, &near)
                {
                    side.point(index as u32);
                }
            }
        }
        let mut meetings: Vec<Vector> = Vec::new();
        for (index, one) in self.planes.iter().enumerate() {
            let others = self.planes[..index].iter();
            meetings.extend(others.filter_map(|other| meeting(plane, one, other)).filter(|point| {
                self.shell.height(point) <= tolerance
                    && self.planes.iter().all(|(normal, distance)| normal.dot(*point) - distance <= tolerance)
                    && contains(solid.points, solid.faces, point)
            }));
        }
        let [below, above] = sides;
        let half = |side: Side<'_>, sign: f64| {
            let planes = self.planes.iter().copied().chain([(*normal * sign, distance * sign)]).collect();
            let own = |point: &Vector| (normal.dot(*point) - distance) * sign <= tolerance;
            let inner = self.inner.iter().filter(|point| own(point)).chain(&meetings).copied().collect();
            Self::of(side.points, side.surface, planes, inner).map(Box::new)
        };
        Some([half(below, 1.0)?, half(above, -1.0)?])
    }
}

/// The point at which three planes meet.
fn meeting(a: &Plane, b: &Plane, c: &Plane) -> Option<Vector> {
    let across = b.0.cross(c.0);
    let determinant = a.0.dot(across);
    let sum = across * a.1 + c.0.cross(a.0) * b.1 + a.0.cross(b.0) * c.1;
    (determinant.abs() > 1e-6).then(|| sum / determinant)
}

/// Whether a point is inside a closed surface, from the solid angle that it covers (Van Oosterom and Strackee 1983).
pub(super) fn contains(points: &[Vector], faces: &[[u32; 3]], point: &Vector) -> bool {
    let angle = |face: &[u32; 3]| {
        let [a, b, c] = face.map(|index| points[index as usize] - *point);
        let [x, y, z] = [a.length(), b.length(), c.length()];
        let under = x * y * z + a.dot(b) * z + b.dot(c) * x + c.dot(a) * y;
        2.0 * a.dot(b.cross(c)).atan2(under)
    };
    faces.iter().map(angle).sum::<f64>() > std::f64::consts::TAU
}

/// A side of a cut under construction.
struct Side<'a> {
    whole: &'a [Vector],
    /// The index here of each point of the whole part, and of each point at which the cut crosses an edge.
    index: Vec<Option<u32>>,
    crossings: HashMap<[u32; 2], u32>,
    points: Vec<Vector>,
    surface: Vec<(Vec<u32>, Vector)>,
}

impl<'a> Side<'a> {
    fn new(whole: &'a [Vector]) -> Self {
        let index = vec![None; whole.len()];
        Self { whole, index, crossings: HashMap::new(), points: Vec::new(), surface: Vec::new() }
    }

    fn point(&mut self, of: u32) -> u32 {
        *self.index[of as usize].get_or_insert_with(|| {
            self.points.push(self.whole[of as usize]);
            self.points.len() as u32 - 1
        })
    }

    /// Where an edge, with the heights of its ends, crosses the plane.
    fn crossing(&mut self, edge: [u32; 2], heights: [f64; 2]) -> u32 {
        let ([from, to], [start, end]) =
            if edge[0] < edge[1] { (edge, heights) } else { ([edge[1], edge[0]], [heights[1], heights[0]]) };
        *self.crossings.entry([from, to]).or_insert_with(|| {
            let (from, to) = (self.whole[from as usize], self.whole[to as usize]);
            self.points.push(from + (to - from) * (start / (start - end)));
            self.points.len() as u32 - 1
        })
    }

    fn add(&mut self, polygon: &[u32], outward: Vector) {
        let polygon = polygon.iter().map(|index| self.point(*index)).collect();
        self.surface.push((polygon, outward));
    }
}
