//! The encoding `DELTA_BINARY_PACKED` of Parquet, as far as its lengths must be known before the library reads a page.
//!
//! Source: <https://github.com/apache/parquet-format/blob/master/Encodings.md#delta-encoding-delta_binary_packed--5>. The header states
//! the size of a block, the miniblocks of a block, the number of values and the first value. A block has the smallest
//! difference, the width in bits of each miniblock, and the packed differences.

use ::parquet::errors::{ParquetError, Result};

use crate::pages::general;

/// Largest size of a block, in values. Writers use 128.
const MOST_BLOCK: u64 = 1 << 16;

/// The header of encoded numbers.
pub(crate) struct Header {
    block: usize,
    miniblocks: usize,
    count: usize,
    first: i64,
}

pub(crate) fn short() -> ParquetError {
    general("a page ends inside its header".to_owned())
}

impl Header {
    /// Reads a header, of at most `most` values, and returns it with the bytes after it.
    pub(crate) fn read(mut bytes: &[u8], most: usize) -> Result<(Self, &[u8])> {
        let [block, miniblocks, count, first] = [(); 4].map(|()| varint(&mut bytes));
        let (block, miniblocks, count) = (block?, miniblocks?, count?);
        if count > most as u64 {
            return Err(general(format!("a page of {most} values declares {count} encoded values")));
        }
        let sound = (1..=MOST_BLOCK).contains(&block)
            && (1..=block).contains(&miniblocks)
            && block % miniblocks == 0
            && (block / miniblocks).is_multiple_of(32);
        if !sound {
            return Err(general(format!("a page has blocks of {block} values in {miniblocks} parts")));
        }
        let header = Self {
            block: block as usize,
            miniblocks: miniblocks as usize,
            count: count as usize,
            first: zigzag(first?),
        };
        Ok((header, bytes))
    }
}

/// The sum of encoded lengths, none of which may be negative, and the bytes after them. There are at most `most`.
pub(crate) fn sum(bytes: &[u8], most: usize) -> Result<(u64, &[u8])> {
    let negative = || general("a page has a text of negative length".to_owned());
    let (header, mut bytes) = Header::read(bytes, most)?;
    if header.count == 0 {
        return Ok((0, bytes));
    }
    let mut value = header.first;
    let mut sum = u64::try_from(value).map_err(|_| negative())?;
    let mut left = header.count - 1;
    let size = header.block / header.miniblocks;
    while left > 0 {
        let smallest = zigzag(varint(&mut bytes)?);
        let (widths, rest) = bytes.split_at_checked(header.miniblocks).ok_or_else(short)?;
        bytes = rest;
        for width in widths {
            if left == 0 {
                break;
            }
            let width = usize::from(*width);
            if width > 64 {
                return Err(general(format!("a page has numbers of {width} bits")));
            }
            let (packed, rest) = bytes.split_at_checked(size * width / 8).ok_or_else(short)?;
            bytes = rest;
            for i in 0..size.min(left) {
                value = value.wrapping_add(smallest).wrapping_add(bits(packed, i * width, width).cast_signed());
                sum = sum.saturating_add(u64::try_from(value).map_err(|_| negative())?);
            }
            left -= size.min(left);
        }
    }
    Ok((sum, bytes))
}

/// The number of `width` bits from bit `from` on, least significant bit first.
fn bits(packed: &[u8], from: usize, width: usize) -> u64 {
    let bit = |at: usize| packed.get(at / 8).is_some_and(|byte| byte >> (at % 8) & 1 == 1);
    (0..width).fold(0, |number, i| number | u64::from(bit(from + i)) << i)
}

fn varint(bytes: &mut &[u8]) -> Result<u64> {
    let mut number = 0;
    for shift in (0..64).step_by(7) {
        let (byte, rest) = bytes.split_first().ok_or_else(short)?;
        *bytes = rest;
        number |= u64::from(byte & 0x7f) << shift;
        if byte & 0x80 == 0 {
            break;
        }
    }
    Ok(number)
}

fn zigzag(number: u64) -> i64 {
    (number >> 1).cast_signed() ^ -(number & 1).cast_signed()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn examples_of_the_specification_are_summed() {
        // 1, 2, 3, 4, 5: differences of 1, whose packed part has no bits.
        let ramp = [128, 1, 4, 5, 2, 2, 0, 0, 0, 0, 99];
        let (total, rest) = sum(&ramp, 5).unwrap();
        assert_eq!((total, rest), (15, &[99][..]));
        // 7, 5, 3, 1, 2, 3, 4, 5: the smallest difference is -2, and the others are 0 or 3 above it, in two bits.
        let mut valley = vec![128, 1, 4, 8, 14, 3, 2, 0, 0, 0, 0b1100_0000, 0b0011_1111];
        valley.resize(10 + 8, 0);
        assert_eq!(sum(&valley, 8).unwrap().0, 30);
    }

    #[test]
    fn false_headers_are_errors() {
        let error = |bytes: &[u8], most| sum(bytes, most).unwrap_err().to_string();
        assert!(error(&[128, 1, 4, 5, 2], 4).contains("declares 5 encoded values"));
        assert!(error(&[128, 1, 0, 5, 2], 5).contains("in 0 parts"));
        assert!(error(&[128, 1, 4, 5, 1], 5).contains("negative length"));
        assert!(error(&[128, 1, 4, 5, 2, 2, 65, 0, 0, 0], 5).contains("65 bits"));
        assert!(error(&[128, 1, 4, 5, 2, 2, 8, 0, 0, 0], 5).contains("ends inside"));
        assert!(error(&[128, 1, 4], 5).contains("ends inside"));
    }
}
