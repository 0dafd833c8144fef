//! The loss of a JPEG compression (ITU-T T.81): colour conversion, subsampling 4:2:0, cosine transform, quantisation, and back. The
//! entropy coding loses nothing and is left out.

use std::f32::consts::PI;

use super::image::level;
use crate::Image;

/// The tables of Annex K of ITU-T T.81, in rows, for luminance and chrominance.
const LUMINANCE: [u8; 64] = [
    16, 11, 10, 16, 24, 40, 51, 61, 12, 12, 14, 19, 26, 58, 60, 55, 14, 13, 16, 24, 40, 57, 69, 56, 14, 17, 22, 29, 51,
    87, 80, 62, 18, 22, 37, 56, 68, 109, 103, 77, 24, 35, 55, 64, 81, 104, 113, 92, 49, 64, 78, 87, 103, 121, 120, 101,
    72, 92, 95, 98, 112, 100, 103, 99,
];
const CHROMINANCE: [u8; 64] = [
    17, 18, 24, 47, 99, 99, 99, 99, 18, 21, 26, 66, 99, 99, 99, 99, 24, 26, 56, 99, 99, 99, 99, 99, 47, 66, 99, 99, 99,
    99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99,
    99, 99, 99, 99, 99, 99,
];

/// A table for a quality from 1 to 100, scaled as in the library of the Independent JPEG Group.
fn scaled(table: &[u8; 64], quality: u32) -> [f32; 64] {
    let scale = if quality < 50 { 5000 / quality } else { 200 - 2 * quality };
    table.map(|entry| ((u32::from(entry) * scale + 50) / 100).clamp(1, 255) as f32)
}

/// Compresses and decompresses an image with this quality, 1 to 100.
pub(super) fn compress(image: &mut Image, quality: u32) {
    let (width, height) = (image.width, image.height);
    let (half_width, half_height) = (width.div_ceil(2), height.div_ceil(2));
    let mut light = Vec::with_capacity(width * height);
    let mut colours = [vec![0.0_f32; half_width * half_height], vec![0.0_f32; half_width * half_height]];
    let mut counts = vec![0.0_f32; half_width * half_height];
    for (i, pixel) in image.rgb.chunks_exact(3).enumerate() {
        let [r, g, b] = [0, 1, 2].map(|c| f32::from(pixel[c]));
        light.push(0.299 * r + 0.587 * g + 0.114 * b - 128.0);
        let at = (i / width / 2) * half_width + (i % width) / 2;
        colours[0][at] += -0.168_736 * r - 0.331_264 * g + 0.5 * b;
        colours[1][at] += 0.5 * r - 0.418_688 * g - 0.081_312 * b;
        counts[at] += 1.0;
    }
    for plane in &mut colours {
        plane.iter_mut().zip(&counts).for_each(|(sum, count)| *sum /= count);
    }
    let transform = Transform::new();
    transform.lose(&mut light, width, height, &scaled(&LUMINANCE, quality));
    let table = scaled(&CHROMINANCE, quality);
    for plane in &mut colours {
        transform.lose(plane, half_width, half_height, &table);
    }
    for (i, pixel) in image.rgb.chunks_exact_mut(3).enumerate() {
        let at = (i / width / 2) * half_width + (i % width) / 2;
        let (y, blue, red) = (light[i] + 128.0, colours[0][at], colours[1][at]);
        pixel[0] = level(y + 1.402 * red);
        pixel[1] = level(y - 0.344_136 * blue - 0.714_136 * red);
        pixel[2] = level(y + 1.772 * blue);
    }
}

/// The discrete cosine transform of 8 x 8 blocks, as a matrix with orthonormal rows.
struct Transform([[f32; 8]; 8]);

impl Transform {
    fn new() -> Self {
        Self(std::array::from_fn(|k| {
            let norm = if k == 0 { 0.125_f32.sqrt() } else { 0.5 };
            std::array::from_fn(|n| norm * ((2 * n + 1) as f32 * k as f32 * PI / 16.0).cos())
        }))
    }

    /// Rounds the coefficients of each block to multiples of the table. The border is extended by its last values.
    fn lose(&self, plane: &mut [f32], width: usize, height: usize, table: &[f32; 64]) {
        let Self(rows) = self;
        for top in (0..height).step_by(8) {
            for left in (0..width).step_by(8) {
                let at = |y: usize, x: usize| (top + y).min(height - 1) * width + (left + x).min(width - 1);
                let block: [[f32; 8]; 8] = std::array::from_fn(|y| std::array::from_fn(|x| plane[at(y, x)]));
                let mut coefficients = product(&product(rows, &block), &transposed(rows));
                for (i, value) in coefficients.as_flattened_mut().iter_mut().enumerate() {
                    *value = (*value / table[i]).round() * table[i];
                }
                let block = product(&product(&transposed(rows), &coefficients), rows);
                for y in 0..8.min(height - top) {
                    for x in 0..8.min(width - left) {
                        plane[(top + y) * width + left + x] = block[y][x];
                    }
                }
            }
        }
    }
}

fn product(a: &[[f32; 8]; 8], b: &[[f32; 8]; 8]) -> [[f32; 8]; 8] {
    let mut out = [[0.0; 8]; 8];
    for (out, a) in out.iter_mut().zip(a) {
        for (factor, b) in a.iter().zip(b) {
            (0..8).for_each(|x| out[x] += factor * b[x]);
        }
    }
    out
}

fn transposed(a: &[[f32; 8]; 8]) -> [[f32; 8]; 8] {
    std::array::from_fn(|y| std::array::from_fn(|x| a[x][y]))
}
