//! Culling: the bodies that may be visible in a tile of the image.

use nalgebra::Vector3;

use crate::body::{Body, NEAREST};

/// Width and height of a tile, in pixels.
pub(crate) const TILE: usize = 8;

/// The camera in single precision, as the caster uses it.
#[derive(Debug, Clone, Copy)]
pub(crate) struct View {
    pub(crate) eye: Vector3<f32>,
    pub(crate) right: Vector3<f32>,
    pub(crate) down: Vector3<f32>,
    pub(crate) forward: Vector3<f32>,
    /// Focal length in pixels.
    pub(crate) focal: f32,
    pub(crate) width: usize,
    pub(crate) height: usize,
}

impl View {
    /// Tangents of the viewing angles at a position in the image (pixels).
    pub(crate) fn tangents(&self, u: f32, v: f32) -> [f32; 2] {
        [(u - 0.5 * self.width as f32) / self.focal, (v - 0.5 * self.height as f32) / self.focal]
    }
}

/// One bit for each tile and body, nearest bodies first.
pub(crate) struct Tiles {
    /// Bodies sorted by their smallest depth, and that depth.
    pub(crate) order: Vec<(u32, f32)>,
    words: usize,
    across: usize,
    bits: Vec<u64>,
}

impl Tiles {
    /// Computes the tiles. With `all`, no body is culled.
    pub(crate) fn new(bodies: &[Body<'_>], view: &View, all: bool) -> Self {
        let seen = |p: &Vector3<f32>| {
            let p = p - view.eye;
            Vector3::new(p.dot(&view.right), p.dot(&view.down), p.dot(&view.forward))
        };
        let hulls: Vec<_> = bodies
            .iter()
            .map(|body| {
                let (a, b, radius) = body.hull();
                (seen(&a), seen(&b), radius)
            })
            .collect();
        let mut order: Vec<(u32, f32)> = Vec::with_capacity(bodies.len());
        for (i, (a, b, radius)) in hulls.iter().enumerate() {
            if a.z.max(b.z) + radius > NEAREST {
                order.push((i as u32, a.z.min(b.z) - radius));
            }
        }
        order.sort_by(|a, b| a.1.total_cmp(&b.1));
        let (across, down) = (view.width.div_ceil(TILE), view.height.div_ceil(TILE));
        let words = order.len().div_ceil(64).max(1);
        let mut bits = vec![0_u64; across * down * words];
        for (k, (body, near)) in order.iter().enumerate() {
            let (a, b, radius) = &hulls[*body as usize];
            let [columns, rows] = [(0, across, view.width), (1, down, view.height)].map(|(axis, tiles, pixels)| {
                if all || *near < NEAREST {
                    return 0..tiles;
                }
                let far = a.z.max(b.z) + radius;
                let low = a[axis].min(b[axis]) - radius;
                let high = a[axis].max(b[axis]) + radius;
                let least = low / if low < 0.0 { *near } else { far };
                let most = high / if high > 0.0 { *near } else { far };
                let tile = |x: f32| ((x * view.focal + 0.5 * pixels as f32) / TILE as f32).clamp(0.0, tiles as f32);
                tile(least) as usize..(tile(most) as usize + 1).min(tiles)
            });
            // Largest distance of the body from the eye.
            let distance = a.norm().max(b.norm()) + radius;
            for row in rows {
                for column in columns.clone() {
                    let [u, v] = [column, row].map(|i| (i as f32 + 0.5) * TILE as f32);
                    let [x, y] = view.tangents(u, v);
                    let middle = Vector3::new(x, y, 1.0).normalize();
                    // Half the tile's diagonal, seen from the eye at distance 1 or farther along its ray, is at most
                    // this wide.
                    let spread = TILE as f32 * std::f32::consts::FRAC_1_SQRT_2 / view.focal * distance;
                    if all || line_to_segment(&middle, a, b) <= radius + spread {
                        bits[(row * across + column) * words + k / 64] |= 1 << (k % 64);
                    }
                }
            }
        }
        Self { order, words, across, bits }
    }

    /// The bits of the tile with the pixel in this column and row.
    pub(crate) fn at(&self, column: usize, row: usize) -> &[u64] {
        let first = (row / TILE * self.across + column / TILE) * self.words;
        &self.bits[first..first + self.words]
    }
}

/// Distance between a segment and the line through the origin along the unit vector `direction`.
fn line_to_segment(direction: &Vector3<f32>, a: &Vector3<f32>, b: &Vector3<f32>) -> f32 {
    let across = |p: &Vector3<f32>| p - direction * p.dot(direction);
    let (a, b) = (across(a), across(b));
    let along = b - a;
    let share = (-a.dot(&along) / along.norm_squared().max(1e-12)).clamp(0.0, 1.0);
    (a + along * share).norm()
}
