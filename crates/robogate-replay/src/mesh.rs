//! Triangle meshes with fewer triangles.

use std::collections::{BTreeMap, BTreeSet};

/// The unit of corners, in metres.
const UNIT_M: f64 = 1e-4;

/// Numbers of cells along the diagonal of a mesh, from fine to coarse. In one cell all corners become one.
pub(crate) const DETAILS: [u32; 7] = [u32::MAX, 512, 256, 128, 64, 32, 16];

/// A triangle mesh whose corners are stored once, in units of 0.1 mm.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub(crate) struct IndexedMesh {
    pub(crate) corners: Vec<[i32; 3]>,
    /// Three corners of each triangle.
    pub(crate) faces: Vec<[usize; 3]>,
}

impl IndexedMesh {
    pub(crate) fn of(triangles: &[[[f32; 3]; 3]]) -> Self {
        let mut mesh = Self::default();
        let mut known: BTreeMap<[i32; 3], usize> = BTreeMap::new();
        for triangle in triangles {
            mesh.faces.push(triangle.map(|corner| {
                let corner = corner.map(|x| (f64::from(x) / UNIT_M).round() as i32);
                *known.entry(corner).or_insert_with(|| {
                    mesh.corners.push(corner);
                    mesh.corners.len() - 1
                })
            }));
        }
        mesh
    }

    /// The bytes of the corners and faces, before compression.
    pub(crate) fn bytes(&self) -> usize {
        12 * self.corners.len() + 12 * self.faces.len()
    }

    /// The smallest and the largest coordinate along each axis.
    pub(crate) fn bounds(&self) -> [[i32; 2]; 3] {
        [0, 1, 2].map(|axis| {
            let values = || self.corners.iter().map(|corner| corner[axis]);
            [values().min().unwrap_or_default(), values().max().unwrap_or_default()]
        })
    }

    /// The mesh with so many cells along its diagonal: the corners of a cell become their mean, and triangles without an
    /// area disappear (vertex clustering, Rossignac and Borrel 1993).
    pub(crate) fn with_detail(&self, cells: u32) -> Self {
        let bounds = self.bounds();
        let diagonal = bounds.iter().map(|[low, high]| f64::from(high - low).powi(2)).sum::<f64>().sqrt();
        let cell = diagonal / f64::from(cells);
        if cell <= 1.0 {
            return self.clone();
        }
        let mut sums: Vec<([i64; 3], i64)> = Vec::new();
        let mut known: BTreeMap<[i64; 3], usize> = BTreeMap::new();
        let places: Vec<usize> =
            self.corners.iter().map(|corner| self.place(corner, cell, &mut known, &mut sums)).collect();
        let corners = sums.iter().map(|(sum, count)| sum.map(|x| (x as f64 / *count as f64).round() as i32)).collect();
        let mut faces = Vec::new();
        let mut seen = BTreeSet::new();
        for face in &self.faces {
            let face = face.map(|at| places[at]);
            let mut sorted = face;
            sorted.sort_unstable();
            if sorted[0] != sorted[1] && sorted[1] != sorted[2] && seen.insert(sorted) {
                faces.push(face);
            }
        }
        Self { corners, faces }
    }

    /// Adds a corner to its cell, and returns the number of the cell.
    fn place(
        &self,
        corner: &[i32; 3],
        cell: f64,
        known: &mut BTreeMap<[i64; 3], usize>,
        sums: &mut Vec<([i64; 3], i64)>,
    ) -> usize {
        let key = corner.map(|x| (f64::from(x) / cell).floor() as i64);
        let at = *known.entry(key).or_insert_with(|| {
            sums.push(([0; 3], 0));
            sums.len() - 1
        });
        let (sum, count) = &mut sums[at];
        sum.iter_mut().zip(corner).for_each(|(sum, x)| *sum += i64::from(*x));
        *count += 1;
        at
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A unit square in the plane z = 0 with so many cells along each side.
    fn square(cells: u16) -> Vec<[[f32; 3]; 3]> {
        let at = |i: u16, j: u16| [f32::from(i) / f32::from(cells), f32::from(j) / f32::from(cells), 0.0];
        (0..cells)
            .flat_map(|i| (0..cells).map(move |j| (i, j)))
            .flat_map(|(i, j)| [[at(i, j), at(i + 1, j), at(i + 1, j + 1)], [at(i, j), at(i + 1, j + 1), at(i, j + 1)]])
            .collect()
    }

    #[test]
    fn corners_are_stored_once() {
        let mesh = IndexedMesh::of(&square(10));
        assert_eq!((mesh.corners.len(), mesh.faces.len()), (121, 200));
        assert_eq!(mesh.with_detail(u32::MAX), mesh);
    }

    #[test]
    fn a_coarse_square_has_the_same_extent_and_area() {
        let fine = IndexedMesh::of(&square(100));
        let coarse = fine.with_detail(16);
        assert!(coarse.faces.len() < fine.faces.len() / 20, "{} faces", coarse.faces.len());
        let area = |mesh: &IndexedMesh| -> f64 {
            let twice = mesh.faces.iter().map(|face| {
                let [a, b, c] = face.map(|at| mesh.corners[at].map(f64::from));
                (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
            });
            0.5 * twice.sum::<f64>() * UNIT_M * UNIT_M
        };
        // Cells at the border move their corners inwards by up to half a cell.
        assert!((area(&fine) - 1.0).abs() < 1e-9 && (0.88..=1.0).contains(&area(&coarse)), "{}", area(&coarse));
    }
}
