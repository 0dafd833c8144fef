//! Packs numbers: quantised differences as variable-length integers, compressed by DEFLATE, as base64 text.
//!
//! A number is quantised to an integer. Series are stored as first or second differences, because motion is smooth.
//! Differences are mapped to unsigned integers (0, -1, 1, -2, ... become 0, 1, 2, 3, ...) and stored in groups of seven
//! bits, the lowest first, with the highest bit of a byte set if another group follows.

use base64ct::{Base64, Encoding};
use miniz_oxide::deflate::compress_to_vec;

/// The strongest level of compression that is not exhaustive.
const LEVEL: u8 = 9;

/// The level for columns of numbers, which may be long and compress little.
const FLOAT_LEVEL: u8 = 6;

/// A stream of integers.
#[derive(Debug, Default)]
pub(crate) struct Packer(Vec<u8>);

impl Packer {
    /// Adds one integer.
    pub(crate) fn integer(&mut self, value: i64) {
        let mut rest = ((value << 1) ^ (value >> 63)).cast_unsigned();
        loop {
            let low = (rest & 0x7f) as u8;
            rest >>= 7;
            if rest == 0 {
                self.0.push(low);
                return;
            }
            self.0.push(low | 0x80);
        }
    }

    /// Adds a series as first differences.
    pub(crate) fn steps(&mut self, values: impl IntoIterator<Item = i64>) {
        let mut last = 0;
        for value in values {
            self.integer(value - last);
            last = value;
        }
    }

    /// Adds a series as second differences.
    pub(crate) fn smooth(&mut self, values: impl IntoIterator<Item = i64>) {
        let (mut last, mut slope) = (0, 0);
        for value in values {
            let step = value - last;
            self.integer(step - slope);
            (last, slope) = (value, step);
        }
    }

    /// The compressed stream as text.
    pub(crate) fn finish(self) -> String {
        packed(&self.0)
    }
}

/// Quantises a number to multiples of `unit`. A number that is not finite becomes 0.
pub(crate) fn quantised(value: f64, unit: f64) -> i64 {
    // The conversion saturates, and no length, force or time of an episode is near the limit.
    (value / unit).round().clamp(-1e15, 1e15) as i64
}

/// Packs integers for a page.
pub fn packed_integers(values: impl IntoIterator<Item = u64>) -> String {
    let mut packer = Packer::default();
    values.into_iter().for_each(|value| packer.integer(i64::try_from(value).unwrap_or(i64::MAX)));
    packer.finish()
}

/// Packs numbers for a page, with all their bits: the first byte of each (little-endian), then the second ones, and so
/// on. The bytes of one kind are alike, so they compress better together.
pub fn packed_floats(values: &[f32]) -> String {
    let bytes: Vec<[u8; 4]> = values.iter().map(|value| value.to_le_bytes()).collect();
    let planes: Vec<u8> = (0..4).flat_map(|plane| bytes.iter().map(move |bytes| bytes[plane])).collect();
    Base64::encode_string(&compress_to_vec(&planes, FLOAT_LEVEL))
}

/// Compresses bytes (raw DEFLATE) and encodes them as base64.
pub(crate) fn packed(bytes: &[u8]) -> String {
    Base64::encode_string(&compress_to_vec(bytes, LEVEL))
}

#[cfg(test)]
mod tests {
    use miniz_oxide::inflate::decompress_to_vec;

    use super::*;

    #[test]
    fn integers_have_few_bytes() {
        let mut packer = Packer::default();
        [0, -1, 1, 63, -64, 64].into_iter().for_each(|value| packer.integer(value));
        assert_eq!(packer.0, [0, 1, 2, 126, 127, 0x80, 1]);
    }

    #[test]
    fn smooth_series_become_zeros() {
        let mut packer = Packer::default();
        packer.smooth((0..5).map(|i| 7 * i));
        assert_eq!(packer.0, [0, 14, 0, 0, 0]);
    }

    #[test]
    fn compression_is_lossless() {
        let bytes: Vec<u8> = (0..1000_u32).map(|i| (i * i % 251) as u8).collect();
        assert_eq!(decompress_to_vec(&compress_to_vec(&bytes, LEVEL)).unwrap(), bytes);
    }
}
