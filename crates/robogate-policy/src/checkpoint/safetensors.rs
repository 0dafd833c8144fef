//! Tensors of safetensors files: eight bytes with the length of a header (little endian), the header in JSON, and the bytes of the tensors
//! (<https://github.com/huggingface/safetensors>).

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{self, BufReader, Read};
use std::path::Path;

use robogate_core::budget::Budget;
use serde::{Deserialize, Serialize};
use serde_json::Value;
use sha2::{Digest, Sha256};

use super::hex;

/// The largest header: ten thousand tensors have about 2 MB.
const HEADER: Budget = Budget { bytes: 32 << 20, values: 1 << 21, depth: 8 };
/// Tensors with at most so many numbers are recorded with them, such as means and ranges of a normaliser.
const SMALL: usize = 64;

/// Tensors by their name.
pub(super) type Tensors = BTreeMap<String, Tensor>;

/// One tensor.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Tensor {
    /// The type of its numbers, as the format names it: `F32`.
    pub(super) dtype: String,
    pub(super) shape: Vec<u64>,
    /// SHA-256 (hex) of its bytes.
    pub(super) sha256: String,
    /// Its numbers, if they are few and of a known type.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub(super) numbers: Vec<f64>,
}

#[derive(Deserialize)]
struct Entry {
    dtype: String,
    shape: Vec<u64>,
    data_offsets: [u64; 2],
}

/// The tensors of a file. `None` if it is not such a file, or has more than `most`: its bytes are compared then.
pub(super) fn read(path: &Path, most: usize) -> io::Result<Option<Tensors>> {
    let mut file = BufReader::with_capacity(1 << 20, File::open(path)?);
    let size = file.get_ref().metadata()?.len();
    let mut length = [0; 8];
    if size < 8 {
        return Ok(None);
    }
    file.read_exact(&mut length)?;
    let length = u64::from_le_bytes(length);
    if length > (size - 8).min(HEADER.bytes as u64) {
        return Ok(None);
    }
    let mut header = vec![0; length as usize];
    file.read_exact(&mut header)?;
    let Some(entries) = entries(&header, size - 8 - length) else { return Ok(None) };
    if entries.len() > most {
        return Ok(None);
    }
    let mut found = Tensors::new();
    for (name, entry) in entries {
        let tensor = tensor(&mut file, entry)?;
        found.insert(name, tensor);
    }
    Ok(Some(found))
}

/// The entries of a header in the order of their tensors, which lie one after the other up to the end of the file, as the format requires.
fn entries(header: &[u8], size: u64) -> Option<Vec<(String, Entry)>> {
    let fields: BTreeMap<String, Value> = HEADER.json(header).ok()?;
    let entries = fields.into_iter().filter(|(name, _)| name != "__metadata__");
    let mut entries: Vec<(String, Entry)> =
        entries.map(|(name, entry)| Some((name, serde_json::from_value(entry).ok()?))).collect::<Option<_>>()?;
    entries.sort_by_key(|(_, entry)| entry.data_offsets);
    let mut at = 0;
    for (_, entry) in &entries {
        let [start, end] = entry.data_offsets;
        if start != at || end < start {
            return None;
        }
        at = end;
    }
    (at == size).then_some(entries)
}

fn tensor(file: &mut impl Read, entry: Entry) -> io::Result<Tensor> {
    let mut left = entry.data_offsets[1] - entry.data_offsets[0];
    let width = width(&entry.dtype);
    let is_small =
        width.is_some_and(|width| left > 0 && left <= (SMALL * width) as u64 && left.is_multiple_of(width as u64));
    let (mut hash, mut kept) = (Sha256::new(), Vec::new());
    let mut buffer = vec![0; 1 << 16];
    while left > 0 {
        let n = left.min(buffer.len() as u64) as usize;
        file.read_exact(&mut buffer[..n])?;
        hash.update(&buffer[..n]);
        if is_small {
            kept.extend_from_slice(&buffer[..n]);
        }
        left -= n as u64;
    }
    let numbers = kept.chunks_exact(width.unwrap_or(1)).map(|bytes| number(&entry.dtype, bytes)).collect();
    Ok(Tensor { dtype: entry.dtype, shape: entry.shape, sha256: hex(hash), numbers })
}

/// Bytes of a number.
fn width(dtype: &str) -> Option<usize> {
    Some(match dtype {
        "F64" | "I64" => 8,
        "F32" | "I32" => 4,
        "F16" | "BF16" => 2,
        "BOOL" | "U8" => 1,
        _ => return None,
    })
}

/// A number from its bytes, little endian. 0 for one that is not finite, which the hash still tells apart.
fn number(dtype: &str, bytes: &[u8]) -> f64 {
    let long = |bytes: &[u8]| bytes.try_into().map_or(0, u64::from_le_bytes);
    let short = |bytes: &[u8]| bytes.try_into().map_or(0, u32::from_le_bytes);
    let half = |bytes: &[u8]| bytes.try_into().map_or(0, u16::from_le_bytes);
    let found = match dtype {
        "F64" => f64::from_bits(long(bytes)),
        "I64" => long(bytes).cast_signed() as f64,
        "F32" => f64::from(f32::from_bits(short(bytes))),
        "I32" => f64::from(short(bytes).cast_signed()),
        "BF16" => f64::from(f32::from_bits(u32::from(half(bytes)) << 16)),
        "F16" => from_half(half(bytes)),
        _ => bytes.first().copied().map_or(0.0, f64::from),
    };
    if found.is_finite() { found } else { 0.0 }
}

/// A number of IEEE 754 half precision.
fn from_half(bits: u16) -> f64 {
    let sign = if bits >> 15 == 1 { -1.0 } else { 1.0 };
    let (exponent, fraction) = (i32::from(bits >> 10 & 0x1f), f64::from(bits & 0x3ff) / 1024.0);
    match exponent {
        0 => sign * fraction * 2.0_f64.powi(-14),
        31 => f64::NAN,
        exponent => sign * (1.0 + fraction) * 2.0_f64.powi(exponent - 15),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_read_from_their_bytes() {
        assert_eq!(number("F32", &1.5_f32.to_le_bytes()), 1.5);
        assert_eq!(number("F64", &(-0.1_f64).to_le_bytes()), -0.1);
        assert_eq!(number("I64", &(-3_i64).to_le_bytes()), -3.0);
        assert_eq!(number("I32", &7_i32.to_le_bytes()), 7.0);
        // 0x3e00 and 0xc248 are 1.5 and -3.140625, 1 is the smallest number, and 0x3fc0 is 1.5 in bfloat16.
        for (bits, wanted) in [(0x3e00, 1.5), (0xc248, -3.140_625), (1, 2.0_f64.powi(-24)), (0x7c00, 0.0)] {
            assert_eq!(number("F16", &u16::to_le_bytes(bits)), wanted);
        }
        assert_eq!(number("BF16", &0x3fc0_u16.to_le_bytes()), 1.5);
    }

    #[test]
    fn broken_headers_are_no_tensors() {
        let good = br#"{"a":{"dtype":"F32","shape":[2],"data_offsets":[0,8]}}"#;
        assert_eq!(entries(good, 8).map(|entries| entries.len()), Some(1));
        for size in [0, 7, 9] {
            assert!(entries(good, size).is_none());
        }
        for header in [
            "",
            "[]",
            r#"{"a":1}"#,
            r#"{"a":{"dtype":"F32","shape":[2],"data_offsets":[4,8]}}"#,
            r#"{"a":{"dtype":"F32","shape":[2],"data_offsets":[8,0]}}"#,
            r#"{"a":{"dtype":"F32","shape":[2],"data_offsets":[0,8]},"b":{"dtype":"F32","shape":[2],"data_offsets":[0,8]}}"#,
        ] {
            assert!(entries(header.as_bytes(), 8).is_none(), "{header}");
        }
    }
}
