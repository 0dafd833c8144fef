//! Image resampling with the same bytes as Pillow: two passes in fixed point, with a wider filter for downsampling.

use super::picture::View;
use super::profile::Filter;

/// Fractional bits of a weight. They leave 8 bits for the colour and 2 for overshoot.
const PRECISION: u32 = 32 - 8 - 2;
/// One half in fixed point, for rounding.
const HALF: i32 = 1 << (PRECISION - 1);

/// The neighbours and weights of each pixel of a resampled row or column.
///
/// In Pillow the number of neighbours differs between pixels. Here all pixels have the largest number, with some
/// weights of zero, because a loop of constant length is twice as fast.
#[derive(Debug)]
pub(crate) struct Taps {
    count: usize,
    /// First neighbour of each pixel.
    firsts: Vec<usize>,
    /// `count` weights for each pixel.
    weights: Vec<i32>,
}

impl Taps {
    /// Resampling from `from` pixels to `to` pixels.
    pub(crate) fn new(from: usize, to: usize, filter: Filter) -> Self {
        let (kernel, support): (fn(f64) -> f64, f64) = match filter {
            Filter::Bilinear => (triangle, 1.0),
            Filter::Lanczos => (lanczos, 3.0),
        };
        let scale = from as f64 / to as f64;
        let widening = scale.max(1.0);
        let support = support * widening;
        let met = |x: usize| {
            let centre = (x as f64 + 0.5) * scale;
            // Truncation towards zero of a negative number equals a clamp at zero.
            let first = (centre - support + 0.5).max(0.0) as usize;
            let last = ((centre + support + 0.5) as usize).min(from);
            (centre, first, last)
        };
        let count = (0..to).map(met).map(|(_, first, last)| last.saturating_sub(first)).max().unwrap_or(0);
        let (mut firsts, mut weights) = (Vec::with_capacity(to), vec![0; to * count]);
        let mut shares = Vec::with_capacity(count);
        for (x, weights) in (0..to).zip(weights.chunks_exact_mut(count.max(1))) {
            let (centre, first, last) = met(x);
            shares.clear();
            shares.extend((first..last).map(|i| kernel((i as f64 - centre + 0.5) / widening)));
            let sum: f64 = shares.iter().sum();
            let one = f64::from(1_u32 << PRECISION);
            let start = first.min(from - count);
            for (weight, share) in weights[first - start..].iter_mut().zip(&shares) {
                // Pillow also rounds half away from zero.
                *weight = (share / sum * one).round() as i32;
            }
            firsts.push(start);
        }
        Self { count, firsts, weights }
    }

    /// Resample along the rows of an image, into an empty buffer.
    pub(crate) fn across(&self, picture: View<'_>, out: &mut Vec<u8>) {
        match self.count {
            2 => self.across_by::<2>(picture, out),
            3 => self.across_by::<3>(picture, out),
            4 => self.across_by::<4>(picture, out),
            _ => self.pairs(picture, out, blend),
        }
    }

    /// The same with a constant number of neighbours.
    fn across_by<const COUNT: usize>(&self, picture: View<'_>, out: &mut Vec<u8>) {
        self.pairs(picture, out, |pixels, weights| match (pixels.first_chunk(), weights.first_chunk()) {
            (Some(pixels), Some(weights)) => blend::<[[u64; 3]; COUNT], [i32; COUNT]>(pixels, weights),
            _ => [0; 3],
        });
    }

    /// Resample two rows at a time. A colour times a weight has 31 bits including its sign, so one 64-bit
    /// multiplication computes two products.
    fn pairs(&self, picture: View<'_>, out: &mut Vec<u8>, blend: impl Fn(&[[u64; 3]], &[i32]) -> [u64; 3]) {
        let (from, to) = (3 * picture.width, 3 * self.firsts.len());
        out.resize(to * picture.height, 0);
        let mut both = vec![[0; 3]; picture.width];
        let mut discarded = vec![0; to];
        for (rows, outs) in picture.rgb.chunks(2 * from).zip(out.chunks_mut(2 * to)) {
            let (upper, lower) = rows.split_at(from);
            let (upper_out, lower_out) = outs.split_at_mut(to);
            // With an odd number of rows, the last row is processed alone.
            let (lower, lower_out) = if lower.is_empty() { (upper, &mut *discarded) } else { (lower, lower_out) };
            let pixels = upper.as_chunks::<3>().0.iter().zip(lower.as_chunks::<3>().0);
            for (both, (upper, lower)) in both.iter_mut().zip(pixels) {
                *both = [0, 1, 2].map(|c| u64::from(upper[c]) | u64::from(lower[c]) << 32);
            }
            let outs = upper_out.as_chunks_mut::<3>().0.iter_mut().zip(lower_out.as_chunks_mut::<3>().0);
            let taps = self.firsts.iter().zip(self.weights.chunks_exact(self.count));
            for ((first, weights), (upper, lower)) in taps.zip(outs) {
                let sums = blend(&both[*first..], weights);
                *upper = sums.map(|sum| ROUNDED[(sum >> PRECISION) as usize % ROUNDED.len()]);
                *lower = sums.map(|sum| ROUNDED[(sum >> (32 + PRECISION)) as usize]);
            }
        }
    }

    /// Resample along the columns of an image, into an empty buffer.
    pub(crate) fn down(&self, picture: View<'_>, out: &mut Vec<u8>) {
        let stride = 3 * picture.width;
        out.reserve(stride * self.firsts.len());
        let mut sums = vec![HALF; stride];
        for (first, weights) in self.firsts.iter().zip(self.weights.chunks_exact(self.count)) {
            sums.fill(HALF);
            for (row, weight) in picture.rgb.chunks_exact(stride).skip(*first).zip(weights) {
                sums.iter_mut().zip(row).for_each(|(sum, byte)| *sum += i32::from(*byte) * weight);
            }
            out.extend(sums.iter().map(|sum| (sum >> PRECISION).clamp(0, 255) as u8));
        }
    }
}

/// Initial value of each 32-bit sum: one half for rounding, and an offset, so that a negative sum does not borrow from
/// its neighbour.
const START: u64 = HALF as u64 + ((BELOW as u64) << PRECISION);
/// Offset of the sums, in colour values. It allows for overshoot below 0 and above 255.
const BELOW: usize = 256;

/// The colour for each value of the upper ten bits of a sum.
static ROUNDED: [u8; 1 << (32 - PRECISION)] = {
    let mut colours = [0; 1 << (32 - PRECISION)];
    let mut i = BELOW;
    while i < colours.len() {
        colours[i] = if i - BELOW < 255 { (i - BELOW) as u8 } else { 255 };
        i += 1;
    }
    colours
};

/// The sums of two rows for each colour, one in each half of 64 bits.
#[inline(always)]
fn blend<P, W>(pixels: &P, weights: &W) -> [u64; 3]
where
    P: AsRef<[[u64; 3]]> + ?Sized,
    W: AsRef<[i32]> + ?Sized,
{
    let mut sums = [START | START << 32; 3];
    for (pixel, weight) in pixels.as_ref().iter().zip(weights.as_ref()) {
        // Arithmetic modulo 2^64, in which a negative weight is its complement.
        let weight = i64::from(*weight) as u64;
        for (sum, both) in sums.iter_mut().zip(pixel) {
            *sum = sum.wrapping_add(both.wrapping_mul(weight));
        }
    }
    sums
}

fn triangle(x: f64) -> f64 {
    (1.0 - x.abs()).max(0.0)
}

fn lanczos(x: f64) -> f64 {
    let sinc = |x: f64| if x == 0.0 { 1.0 } else { (x * std::f64::consts::PI).sin() / (x * std::f64::consts::PI) };
    if x.abs() < 3.0 { sinc(x) * sinc(x / 3.0) } else { 0.0 }
}
