//! The convex hull of points.

use nalgebra::{Point3, Vector3};
use parry3d_f64::math::Vector;

use super::Hull;
use crate::mesh::bounds;

/// The largest number of corners of a hull: collisions of a piece take time that grows with it.
const MOST_CORNERS: usize = 96;

/// A convex hull of points.
#[derive(Debug, Clone)]
pub(super) struct Shell {
    pub(super) points: Vec<Vector>,
    pub(super) faces: Vec<Face>,
    pub(super) volume: f64,
}

/// A triangle of a hull.
#[derive(Debug, Clone, Copy)]
pub(super) struct Face {
    pub(super) corners: [u32; 3],
    normal: Vector,
    distance: f64,
}

impl Face {
    /// The outward plane of a triangle. That of one without an area is below every point.
    fn of(points: &[Vector], corners: [u32; 3], size: f64) -> Self {
        let [a, b, c] = corners.map(|index| points[index as usize]);
        let normal = (b - a).cross(c - a);
        let length = normal.length();
        if length <= 1e-10 * size * size {
            return Self { corners, normal: Vector::ZERO, distance: f64::INFINITY };
        }
        let normal = normal / length;
        Self { corners, normal, distance: normal.dot(a) }
    }

    fn height(&self, point: &Vector) -> f64 {
        self.normal.dot(*point) - self.distance
    }
}

impl Shell {
    /// The hull of points, of at most [`MOST_CORNERS`] of them ("quickhull", Barber, Dobkin and Huhdanpaa 1996): always the point that is
    /// farthest outside of the hull so far is added. `None` if they have no volume.
    pub(super) fn of(given: &[Vector]) -> Option<Self> {
        let [low, high] = extremes(given);
        let size = (high - low).max_element();
        let tolerance = 1e-7 * size;
        let farthest = |distance: &dyn Fn(&Vector) -> f64| {
            let of = (0..given.len()).max_by(|a, b| distance(&given[*a]).total_cmp(&distance(&given[*b])))?;
            (distance(&given[of]) > tolerance).then_some(given[of])
        };
        // A first tetrahedron.
        let a = farthest(&|point| high.x - point.x + tolerance * 2.0)?;
        let b = farthest(&|point| (*point - a).length())?;
        let axis = (b - a).normalize_or_zero();
        let c = farthest(&|point| (*point - a).cross(axis).length())?;
        let normal = (b - a).cross(c - a).normalize_or_zero();
        let d = farthest(&|point| (*point - a).dot(normal).abs())?;
        let mut points = if (d - a).dot(normal) > 0.0 { vec![a, c, b, d] } else { vec![a, b, c, d] };
        let mut faces: Vec<(Face, Vec<Vector>)> = [[0, 1, 2], [0, 2, 3], [0, 3, 1], [1, 3, 2]]
            .map(|corners| (Face::of(&points, corners, size), Vec::new()))
            .into();
        distribute(given.iter().copied(), &mut faces, 0, tolerance);
        while points.len() < MOST_CORNERS {
            // Each face has the points outside of it.
            let highest = |(face, outside): &(Face, Vec<Vector>)| {
                outside.iter().map(|point| (face.height(point), *point)).max_by(|a, b| a.0.total_cmp(&b.0))
            };
            let Some((_, next)) = faces.iter().filter_map(highest).max_by(|a, b| a.0.total_cmp(&b.0)) else { break };
            let (seen, kept): (Vec<_>, Vec<_>) =
                faces.into_iter().partition(|(face, _)| face.height(&next) > tolerance);
            faces = kept;
            let edges = |corners: [u32; 3]| [0, 1, 2].map(|k| [corners[k], corners[(k + 1) % 3]]);
            let rim: Vec<[u32; 2]> = seen.iter().flat_map(|(face, _)| edges(face.corners)).collect();
            let first = faces.len();
            points.push(next);
            let index = points.len() as u32 - 1;
            for [from, to] in rim.iter().filter(|[from, to]| !rim.contains(&[*to, *from])) {
                faces.push((Face::of(&points, [*from, *to, index], size), Vec::new()));
            }
            distribute(seen.into_iter().flat_map(|(_, outside)| outside), &mut faces, first, tolerance);
        }
        let faces: Vec<Face> = faces.into_iter().map(|(face, _)| face).collect();
        let corners: Vec<[u32; 3]> = faces.iter().map(|face| face.corners).collect();
        let volume = signed_volume(&points, &corners);
        (volume > 0.0).then_some(Self { points, faces, volume })
    }

    /// How far a point is above the highest plane of its faces.
    pub(super) fn height(&self, point: &Vector) -> f64 {
        self.faces.iter().map(|face| face.height(point)).fold(f64::NEG_INFINITY, f64::max)
    }

    pub(super) fn bounds(&self) -> [Vector; 2] {
        extremes(&self.points)
    }

    /// The hull about the centre of its bounding box, and that centre.
    pub(super) fn hull(&self) -> (Hull, Vector3<f64>) {
        let mut corners: Vec<Point3<f64>> = self.points.iter().map(|p| Point3::new(p.x, p.y, p.z)).collect();
        // An order that does not depend on how the hull was found.
        corners.sort_by(|a, b| a.x.total_cmp(&b.x).then(a.y.total_cmp(&b.y)).then(a.z.total_cmp(&b.z)));
        let [low, high] = bounds(corners.iter());
        let centre = 0.5 * (low + high);
        corners.iter_mut().for_each(|corner| *corner -= centre);
        let flat = self.faces.iter().filter(|face| face.distance.is_finite());
        let plane = |face: &Face| {
            let normal = Vector3::new(face.normal.x, face.normal.y, face.normal.z);
            (normal, face.distance - normal.dot(&centre))
        };
        let planes = flat.map(plane).collect();
        (Hull { corners, planes, half: (0.5 * (high - low)).into(), mesh: None }, centre)
    }
}

/// Gives each point that is outside of one of the faces from `first` on to the face that it is farthest outside of.
fn distribute(points: impl Iterator<Item = Vector>, faces: &mut [(Face, Vec<Vector>)], first: usize, tolerance: f64) {
    for point in points {
        let heights = faces[first..].iter().enumerate().map(|(index, (face, _))| (face.height(&point), index));
        if let Some((_, index)) = heights.filter(|(height, _)| *height > tolerance).max_by(|a, b| a.0.total_cmp(&b.0)) {
            faces[first + index].1.push(point);
        }
    }
}

fn extremes(points: &[Vector]) -> [Vector; 2] {
    let first = points.first().copied().unwrap_or_default();
    points.iter().fold([first; 2], |[low, high], point| [low.min(*point), high.max(*point)])
}

pub(super) fn signed_volume(points: &[Vector], faces: &[[u32; 3]]) -> f64 {
    let Some(origin) = points.first() else { return 0.0 };
    let sixth = |face: &[u32; 3]| {
        let [a, b, c] = face.map(|index| points[index as usize] - *origin);
        a.dot(b.cross(c)) / 6.0
    };
    faces.iter().map(sixth).sum()
}
