//! Pictures as the models were shown them: cropped, resized, padded, turned.

use robogate_core::Image;

use super::profile::{Camera, Filter, Fit};

/// Rows of red, green and blue, from the top left.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Picture {
    /// Pixels in a row.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// `3 x width x height` bytes.
    pub rgb: Vec<u8>,
}

impl Picture {
    /// What a camera shows, as the profile wants it; `None` where the image is not as large as it says.
    pub(crate) fn taken(image: &Image, camera: &Camera) -> Option<Self> {
        let Image { width, height, rgb, .. } = image;
        if *width == 0 || *height == 0 || width.checked_mul(*height)?.checked_mul(3)? != rgb.len() {
            return None;
        }
        let mut picture = Self { width: *width, height: *height, rgb: rgb.clone() };
        // Official clients turn the picture before anything else.
        if camera.turned {
            picture.turn();
        }
        if camera.crop < 1.0 {
            picture = picture.cropped(camera.crop);
        }
        let (width, height) = (camera.width, camera.height);
        Some(if (picture.width, picture.height) == (width, height) {
            picture
        } else {
            match camera.fit {
                Fit::Stretch => picture.resized(width, height, camera.filter),
                Fit::Pad => picture.padded(width, height, camera.filter),
            }
        })
    }

    /// By 180 degrees.
    fn turn(&mut self) {
        self.rgb.as_chunks_mut::<3>().0.reverse();
    }

    /// The middle, with `share` of each side.
    fn cropped(&self, share: f64) -> Self {
        let cut = |side: usize| ((side as f64 * share).round() as usize).clamp(1, side);
        let (width, height) = (cut(self.width), cut(self.height));
        let (x, y) = ((self.width - width) / 2, (self.height - height) / 2);
        let rows = self.rgb.chunks_exact(3 * self.width).skip(y).take(height);
        let rgb = rows.flat_map(|row| row[3 * x..3 * (x + width)].iter().copied()).collect();
        Self { width, height, rgb }
    }

    /// Made to fit without distortion, with black about it (openpi-client's `resize_with_pad`).
    fn padded(&self, width: usize, height: usize, filter: Filter) -> Self {
        let ratio = (self.width as f64 / width as f64).max(self.height as f64 / height as f64);
        let fitted = |side: usize, limit: usize| ((side as f64 / ratio) as usize).clamp(1, limit);
        let inner = self.resized(fitted(self.width, width), fitted(self.height, height), filter);
        let (left, top) = ((width - inner.width) / 2, (height - inner.height) / 2);
        let mut rgb = vec![0; 3 * width * height];
        let rows = rgb.chunks_exact_mut(3 * width).skip(top).zip(inner.rgb.chunks_exact(3 * inner.width));
        rows.for_each(|(row, inner_row)| row[3 * left..3 * (left + inner.width)].copy_from_slice(inner_row));
        Self { width, height, rgb }
    }

    /// Resampled as Pillow does it, to the bit: two passes in fixed point, the filter widened where the picture
    /// shrinks.
    fn resized(&self, width: usize, height: usize, filter: Filter) -> Self {
        let mut wide = if width == self.width { self.rgb.clone() } else { Vec::with_capacity(3 * width * self.height) };
        if width != self.width {
            let taps = taps(self.width, width, filter);
            for row in self.rgb.chunks_exact(3 * self.width) {
                let (pixels, _) = row.as_chunks::<3>();
                for (first, weights) in &taps {
                    let mut sum = [HALF; 3];
                    for ([r, g, b], weight) in pixels[*first..].iter().zip(weights) {
                        sum[0] += i32::from(*r) * weight;
                        sum[1] += i32::from(*g) * weight;
                        sum[2] += i32::from(*b) * weight;
                    }
                    wide.extend(sum.map(rounded));
                }
            }
        }
        if height == self.height {
            return Self { width, height, rgb: wide };
        }
        let stride = 3 * width;
        let mut rgb = Vec::with_capacity(stride * height);
        let mut sums = vec![HALF; stride];
        for (first, weights) in taps(self.height, height, filter) {
            sums.fill(HALF);
            for (row, weight) in wide.chunks_exact(stride).skip(first).zip(&weights) {
                sums.iter_mut().zip(row).for_each(|(sum, byte)| *sum += i32::from(*byte) * weight);
            }
            rgb.extend(sums.iter().map(|sum| rounded(*sum)));
        }
        Self { width, height, rgb }
    }

    /// One plane for each colour, one after the other.
    pub(crate) fn planes(&self) -> Vec<u8> {
        let (pixels, _) = self.rgb.as_chunks::<3>();
        (0..3).flat_map(|colour| pixels.iter().map(move |pixel| pixel[colour])).collect()
    }
}

/// Bits after the point of a weight: 8 bits of colour and 2 of overshoot fit beside them.
const PRECISION: u32 = 32 - 8 - 2;
/// One half, for rounding.
const HALF: i32 = 1 << (PRECISION - 1);

fn rounded(sum: i32) -> u8 {
    (sum >> PRECISION).clamp(0, 255) as u8
}

/// For each pixel of a side the first one that it is made from, and the weights.
fn taps(from: usize, to: usize, filter: Filter) -> Vec<(usize, Vec<i32>)> {
    let (kernel, support): (fn(f64) -> f64, f64) = match filter {
        Filter::Bilinear => (triangle, 1.0),
        Filter::Lanczos => (lanczos, 3.0),
    };
    let scale = from as f64 / to as f64;
    let widening = scale.max(1.0);
    let support = support * widening;
    (0..to)
        .map(|x| {
            let centre = (x as f64 + 0.5) * scale;
            // Truncation towards zero below zero is what a clamp at zero gives.
            let first = (centre - support + 0.5).max(0.0) as usize;
            let last = ((centre + support + 0.5) as usize).min(from);
            let weights: Vec<f64> = (first..last).map(|i| kernel((i as f64 - centre + 0.5) / widening)).collect();
            let sum: f64 = weights.iter().sum();
            let one = f64::from(1_u32 << PRECISION);
            // Half away from zero, as the original rounds.
            (first, weights.iter().map(|w| (w / sum * one).round() as i32).collect())
        })
        .collect()
}

fn triangle(x: f64) -> f64 {
    (1.0 - x.abs()).max(0.0)
}

fn lanczos(x: f64) -> f64 {
    let sinc = |x: f64| if x == 0.0 { 1.0 } else { (x * std::f64::consts::PI).sin() / (x * std::f64::consts::PI) };
    if x.abs() < 3.0 { sinc(x) * sinc(x / 3.0) } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The picture that `tests/pillow.py` resizes.
    fn picture() -> Picture {
        let (width, height) = (13, 9);
        let rgb = (0..3 * width * height).map(|i| (i * i * 7 + i * 31) as u8).collect();
        Picture { width, height, rgb }
    }

    /// FNV-1a, as in `tests/pillow.py`.
    fn hash(bytes: &[u8]) -> u64 {
        bytes.iter().fold(0xcbf2_9ce4_8422_2325, |h, b| (h ^ u64::from(*b)).wrapping_mul(0x100_0000_01b3))
    }

    #[test]
    fn pictures_are_resized_as_pillow_resizes_them_to_the_bit() {
        let expected: Vec<(usize, usize, &str, u64)> = include_str!("../../tests/pillow.txt")
            .lines()
            .filter(|line| !line.starts_with('#'))
            .map(|line| {
                let words: Vec<&str> = line.split_whitespace().collect();
                (words[1].parse().unwrap(), words[2].parse().unwrap(), words[0], words[3].parse().unwrap())
            })
            .collect();
        assert_eq!(expected.len(), 8);
        for (width, height, what, want) in expected {
            let got = match what {
                "bilinear" => picture().resized(width, height, Filter::Bilinear),
                "lanczos" => picture().resized(width, height, Filter::Lanczos),
                _ => picture().padded(width, height, Filter::Bilinear),
            };
            assert_eq!(hash(&got.rgb), want, "{what} {width}x{height}");
        }
    }

    #[test]
    fn turning_twice_changes_nothing_and_once_brings_the_last_pixel_first() {
        let original = picture();
        let mut turned = original.clone();
        turned.turn();
        assert_eq!(turned.rgb[..3], original.rgb[original.rgb.len() - 3..]);
        turned.turn();
        assert_eq!(turned, original);
    }

    #[test]
    fn a_crop_keeps_the_middle() {
        let cropped = picture().cropped(0.5);
        assert_eq!((cropped.width, cropped.height), (7, 5));
        let original = picture();
        assert_eq!(cropped.rgb[..3], original.rgb[3 * (2 * 13 + 3)..3 * (2 * 13 + 3) + 3]);
    }
}
