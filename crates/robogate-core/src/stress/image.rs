//! Changes of an image.

use super::jpeg;
use crate::{Image, Stream};

/// How an image is changed. The values without effect are those of [`Changes::default`].
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Changes {
    pub(super) noise: f64,
    pub(super) blur_px: f64,
    pub(super) brightness: f64,
    pub(super) contrast: f64,
    pub(super) warmth: f64,
    pub(super) jpeg_loss: f64,
    pub(super) occlusion: f64,
    pub(super) crop: f64,
    pub(super) rotation_deg: f64,
}

impl Default for Changes {
    fn default() -> Self {
        Self {
            noise: 0.0,
            blur_px: 0.0,
            brightness: 0.0,
            contrast: 1.0,
            warmth: 0.0,
            jpeg_loss: 0.0,
            occlusion: 0.0,
            crop: 0.0,
            rotation_deg: 0.0,
        }
    }
}

impl Changes {
    /// Changes an image. `place` is where the occlusion is, as shares of the free width and height. `stream` is for the noise.
    pub(super) fn apply(&self, image: &mut Image, place: [f64; 2], stream: &mut Stream) {
        if image.width == 0 || image.height == 0 || image.rgb.len() != 3 * image.width * image.height {
            return;
        }
        if self.crop > 0.0 || self.rotation_deg.abs() > 0.0 {
            self.turn(image);
        }
        if self.blur_px > 0.0 {
            blur(image, self.blur_px as f32);
        }
        self.tint(image);
        if self.noise > 0.0 {
            noise(image, self.noise, stream);
        }
        if self.occlusion > 0.0 {
            self.cover(image, place);
        }
        if self.jpeg_loss >= 0.5 {
            jpeg::compress(image, (100.0 - self.jpeg_loss).round().clamp(1.0, 100.0) as u32);
        }
    }

    /// Crop and rotation, by bilinear interpolation. Beyond the border the image goes on with its last pixels.
    fn turn(&self, image: &mut Image) {
        let (width, height) = (image.width, image.height);
        let (sin, cos) = self.rotation_deg.to_radians().sin_cos();
        let scale = 1.0 - 2.0 * self.crop;
        let (cx, cy) = (0.5 * (width as f64 - 1.0), 0.5 * (height as f64 - 1.0));
        let old = std::mem::take(&mut image.rgb);
        let mut new = Vec::with_capacity(old.len());
        for y in 0..height {
            for x in 0..width {
                let (dx, dy) = (scale * (x as f64 - cx), scale * (y as f64 - cy));
                let sx = (cx + cos * dx - sin * dy).clamp(0.0, width as f64 - 1.0);
                let sy = (cy + sin * dx + cos * dy).clamp(0.0, height as f64 - 1.0);
                let (x0, y0) = (sx as usize, sy as usize);
                let (x1, y1) = ((x0 + 1).min(width - 1), (y0 + 1).min(height - 1));
                let (fx, fy) = ((sx - x0 as f64) as f32, (sy - y0 as f64) as f32);
                for c in 0..3 {
                    let at = |x: usize, y: usize| f32::from(old[3 * (y * width + x) + c]);
                    let top = at(x0, y0) + fx * (at(x1, y0) - at(x0, y0));
                    let low = at(x0, y1) + fx * (at(x1, y1) - at(x0, y1));
                    new.push(level(top + fy * (low - top)));
                }
            }
        }
        image.rgb = new;
    }

    fn tint(&self, image: &mut Image) {
        let neutral = self.brightness == 0.0 && self.contrast == 1.0 && self.warmth == 0.0;
        if neutral {
            return;
        }
        let table = |shift: f64| -> Vec<u8> {
            let new = |old: u8| self.contrast * (f64::from(old) - 127.5) + 127.5 + self.brightness + shift;
            (0..=u8::MAX).map(|old| level(new(old) as f32)).collect()
        };
        let tables = [table(self.warmth), table(0.0), table(-self.warmth)];
        for pixel in image.rgb.chunks_exact_mut(3) {
            pixel.iter_mut().zip(&tables).for_each(|(value, table)| *value = table[usize::from(*value)]);
        }
    }

    /// A grey square of this share of the area.
    fn cover(&self, image: &mut Image, [px, py]: [f64; 2]) {
        let (width, height) = (image.width, image.height);
        let area = self.occlusion * (width * height) as f64;
        let wide = (area.sqrt().round() as usize).min(width);
        let high = ((area / wide.max(1) as f64).round() as usize).min(height);
        let (left, top) = ((px * (width - wide) as f64) as usize, (py * (height - high) as f64) as usize);
        for y in top..top + high {
            image.rgb[3 * (y * width + left)..3 * (y * width + left + wide)].fill(128);
        }
    }
}

/// The nearest level of a colour value.
pub(super) fn level(value: f32) -> u8 {
    // The cast saturates.
    (value + 0.5) as u8
}

/// Noise whose distribution is the sum of four uniform numbers, which is near a normal distribution and fast.
fn noise(image: &mut Image, deviation: f64, stream: &mut Stream) {
    /// Mean and standard deviation of the sum of four bytes.
    const MEAN: f64 = 510.0;
    const DEVIATION: f64 = 147.801_443_384_1;
    let scale = (deviation / DEVIATION) as f32;
    let mut state = stream.bits();
    for pair in image.rgb.chunks_mut(2) {
        let eight = split_mix(&mut state).to_le_bytes();
        for (value, four) in pair.iter_mut().zip(eight.chunks_exact(4)) {
            let sum: u16 = four.iter().map(|byte| u16::from(*byte)).sum();
            *value = level(f32::from(*value) + scale * (f32::from(sum) - MEAN as f32));
        }
    }
}

/// SplitMix64 (Steele, Lea and Flood 2014, doi:10.1145/2660193.2660195).
fn split_mix(state: &mut u64) -> u64 {
    *state = state.wrapping_add(0x9e37_79b9_7f4a_7c15);
    let mut z = *state;
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

/// A blur with this standard deviation in pixels: two moving averages along each axis.
fn blur(image: &mut Image, deviation: f32) {
    let (width, height) = (image.width, image.height);
    let half = half_width(deviation);
    let mut values: Vec<f32> = image.rgb.iter().map(|value| f32::from(*value)).collect();
    let mut line = vec![[0.0_f32; 3]; width.max(height)];
    let mut passes = |starts: usize, start: usize, step: usize, length: usize| {
        for own in 0..starts {
            let at = |i: usize| own * start + i * step;
            for _ in 0..2 {
                for (i, pixel) in line[..length].iter_mut().enumerate() {
                    pixel.copy_from_slice(&values[at(i)..at(i) + 3]);
                }
                average(&line[..length], half, |i, pixel| values[at(i)..at(i) + 3].copy_from_slice(&pixel));
            }
        }
    };
    passes(height, 3 * width, 3, width);
    passes(width, 3, 3 * width, height);
    image.rgb.iter_mut().zip(&values).for_each(|(old, new)| *old = level(*new));
}

/// Half of the width of a moving average, without the pixel in the middle, that has this standard deviation after two passes.
fn half_width(deviation: f32) -> f32 {
    let variance = 0.5 * deviation * deviation;
    // The variance of n pixels at each side is n (n + 1) / 3. Two more that count in part give the rest.
    let n = (0.5 * ((1.0 + 12.0 * variance).sqrt() - 1.0)).floor();
    let (inner, outer) = (n * (n + 1.0) * (2.0 * n + 1.0) / 3.0, (n + 1.0) * (n + 1.0));
    n + ((variance * (2.0 * n + 1.0) - inner) / (2.0 * (outer - variance))).clamp(0.0, 1.0)
}

/// The moving average over `2 half + 1` pixels, whose outermost ones count in part. Beyond the ends the last pixel is repeated.
fn average(line: &[[f32; 3]], half: f32, mut put: impl FnMut(usize, [f32; 3])) {
    let whole = half as usize;
    let part = half - whole as f32;
    let last = line.len() - 1;
    let at = |i: isize| line[(i.max(0) as usize).min(last)];
    let mut sum = [0.0_f32; 3];
    for i in -(whole as isize)..=whole as isize {
        let pixel = at(i);
        (0..3).for_each(|c| sum[c] += pixel[c]);
    }
    let scale = 1.0 / (2.0 * half + 1.0);
    for i in 0..line.len() as isize {
        let (before, after) = (at(i - whole as isize - 1), at(i + whole as isize + 1));
        let first = at(i - whole as isize);
        let mean: [f32; 3] = std::array::from_fn(|c| scale * (sum[c] + part * (before[c] + after[c])));
        put(i as usize, mean);
        (0..3).for_each(|c| sum[c] += after[c] - first[c]);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Seed;

    fn picture() -> Image {
        let (width, height) = (96, 64);
        let at = |x: usize, y: usize| {
            [(2 * x) as u8, (3 * y) as u8, if (x / 16 + y / 16).is_multiple_of(2) { 40 } else { 200 }]
        };
        let rgb = (0..height).flat_map(|y| (0..width).flat_map(move |x| at(x, y))).collect();
        Image { camera: "front".to_owned(), width, height, rgb }
    }

    fn changed(changes: &Changes) -> Image {
        let mut image = picture();
        changes.apply(&mut image, [0.5, 0.5], &mut Seed::campaign(7).stream("noise"));
        image
    }

    /// Root mean square difference of the colour values.
    fn distance(a: &Image, b: &Image) -> f64 {
        let squares = a.rgb.iter().zip(&b.rgb).map(|(a, b)| (f64::from(*a) - f64::from(*b)).powi(2));
        (squares.sum::<f64>() / a.rgb.len() as f64).sqrt()
    }

    #[test]
    fn nominal_values_change_nothing() {
        assert_eq!(changed(&Changes::default()), picture());
    }

    #[test]
    fn noise_has_the_deviation() {
        let flat = Image { rgb: vec![128; 3 * 96 * 64], ..picture() };
        let mut noisy = flat.clone();
        noise(&mut noisy, 12.0, &mut Seed::campaign(7).stream("noise"));
        let mean = noisy.rgb.iter().map(|value| f64::from(*value)).sum::<f64>() / noisy.rgb.len() as f64;
        assert!((distance(&noisy, &flat) - 12.0).abs() < 0.3 && (mean - 128.0).abs() < 0.3, "{mean}");
    }

    #[test]
    fn blur_of_a_point_has_the_deviation() {
        let (width, height) = (101, 61);
        for deviation in [0.5_f64, 1.7, 4.0] {
            let mut line = vec![[0.0_f32; 3]; width];
            line[width / 2] = [1.0; 3];
            for _ in 0..2 {
                let old = line.clone();
                average(&old, half_width(deviation as f32), |i, pixel| line[i] = pixel);
            }
            let moment = |k: i32| -> f64 {
                let terms = line.iter().enumerate();
                terms.map(|(i, pixel)| (i as f64 - (width / 2) as f64).powi(k) * f64::from(pixel[0])).sum()
            };
            assert!((moment(0) - 1.0).abs() < 1e-5 && moment(1).abs() < 1e-4, "{deviation}");
            assert!((moment(2).sqrt() - deviation).abs() < 1e-3, "{deviation}: {}", moment(2).sqrt());
        }
        let flat = Image { camera: String::new(), width, height, rgb: vec![77; 3 * width * height] };
        let mut blurred = flat.clone();
        blur(&mut blurred, 6.0);
        assert_eq!(blurred, flat);
    }

    #[test]
    fn light_and_colour_are_as_declared() {
        let bright = changed(&Changes { brightness: 20.0, ..Changes::default() });
        assert_eq!((bright.rgb[0], bright.rgb[2]), (20, 60));
        let flat = changed(&Changes { contrast: 0.5, ..Changes::default() });
        assert_eq!((flat.rgb[0], flat.rgb[2]), (64, 84));
        let warm = changed(&Changes { warmth: 30.0, ..Changes::default() });
        assert_eq!((warm.rgb[0], warm.rgb[1], warm.rgb[2]), (30, 0, 10));
    }

    #[test]
    fn occlusion_covers_the_share() {
        let covered = changed(&Changes { occlusion: 0.25, ..Changes::default() });
        let grey = covered.rgb.chunks_exact(3).filter(|pixel| *pixel == [128; 3]).count();
        assert!((grey as f64 / (96.0 * 64.0) - 0.25).abs() < 0.01, "{grey}");
    }

    #[test]
    fn half_a_turn_twice_is_no_turn() {
        let turn = Changes { rotation_deg: 180.0, ..Changes::default() };
        let mut image = picture();
        for _ in 0..2 {
            turn.turn(&mut image);
        }
        assert!(distance(&image, &picture()) < 0.1);
        let small = changed(&Changes { rotation_deg: 5.0, ..Changes::default() });
        assert!(distance(&small, &picture()) > 5.0);
    }

    #[test]
    fn crop_enlarges_the_middle() {
        let cropped = changed(&Changes { crop: 0.25, ..Changes::default() });
        // Half of the width is left, from a quarter on.
        let first = f64::from(cropped.rgb[0]);
        assert!((first - 2.0 * 24.0).abs() < 2.0, "{first}");
    }

    #[test]
    fn jpeg_loses_more_at_lower_quality() {
        let loss = |jpeg_loss: f64| distance(&changed(&Changes { jpeg_loss, ..Changes::default() }), &picture());
        let losses = [5.0, 50.0, 90.0, 99.0].map(loss);
        assert!(losses[0] > 0.0 && losses.is_sorted(), "{losses:?}");
        // The best quality rounds to whole coefficients. The light is not subsampled.
        let grey = Image { rgb: (0..3 * 96 * 64).map(|i| (i / 3 % 251) as u8).collect(), ..picture() };
        let mut best = grey.clone();
        jpeg::compress(&mut best, 100);
        assert!(distance(&best, &grey) < 1.0);
    }
}
