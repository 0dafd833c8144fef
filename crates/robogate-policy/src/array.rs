//! NumPy-style arrays, as all policy servers use them.

use std::fmt;

use serde::{Deserialize, Serialize};

/// Type of the elements. Little-endian, as on all machines that run policy servers.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum Dtype {
    /// Boolean, one byte: 0 or 1.
    #[serde(rename = "|b1")]
    Bool,
    /// Unsigned integer, 8 bits.
    #[serde(rename = "|u1")]
    U8,
    /// Signed integer, 8 bits.
    #[serde(rename = "|i1")]
    I8,
    /// Unsigned integer, 16 bits.
    #[serde(rename = "<u2")]
    U16,
    /// Signed integer, 16 bits.
    #[serde(rename = "<i2")]
    I16,
    /// Unsigned integer, 32 bits.
    #[serde(rename = "<u4")]
    U32,
    /// Signed integer, 32 bits.
    #[serde(rename = "<i4")]
    I32,
    /// Unsigned integer, 64 bits.
    #[serde(rename = "<u8")]
    U64,
    /// Signed integer, 64 bits.
    #[serde(rename = "<i8")]
    I64,
    /// Half-precision float.
    #[serde(rename = "<f2")]
    F16,
    /// Single-precision float.
    #[serde(rename = "<f4")]
    F32,
    /// Double-precision float.
    #[serde(rename = "<f8")]
    F64,
}

impl Dtype {
    const ALL: [(Self, &str, usize); 12] = [
        (Self::Bool, "|b1", 1),
        (Self::U8, "|u1", 1),
        (Self::I8, "|i1", 1),
        (Self::U16, "<u2", 2),
        (Self::I16, "<i2", 2),
        (Self::U32, "<u4", 4),
        (Self::I32, "<i4", 4),
        (Self::U64, "<u8", 8),
        (Self::I64, "<i8", 8),
        (Self::F16, "<f2", 2),
        (Self::F32, "<f4", 4),
        (Self::F64, "<f8", 8),
    ];

    /// Find a type by its NumPy name, such as `<f4`.
    pub fn by_name(name: &str) -> Option<Self> {
        Self::ALL.iter().find(|(_, known, _)| *known == name).map(|(dtype, ..)| *dtype)
    }

    /// Find a type by its NumPy name, or by the word for it, such as `float32`.
    pub(crate) fn read(name: &str) -> Result<Self, String> {
        let digits = name.trim_start_matches(|c: char| !c.is_ascii_digit());
        let kind = match name.strip_suffix(digits) {
            Some("float") => Some('f'),
            Some("int") => Some('i'),
            Some("uint") => Some('u'),
            _ => None,
        };
        let bytes = digits.parse::<usize>().map_or(0, |bits| bits / 8);
        let by_word = |(_, known, size): &&(Self, &str, usize)| {
            *size == bytes && kind.is_some_and(|kind| known.get(1..).is_some_and(|rest| rest.starts_with(kind)))
        };
        let found = Self::by_name(name).or_else(|| Self::ALL.iter().find(by_word).map(|(dtype, ..)| *dtype));
        found.ok_or_else(|| {
            let known: Vec<&str> = Self::ALL.iter().map(|(_, known, _)| *known).collect();
            format!("unsupported array type `{name}`. Expected one of: {}", known.join(", "))
        })
    }

    /// The NumPy name.
    pub fn name(self) -> &'static str {
        Self::ALL.iter().find(|(dtype, ..)| *dtype == self).map_or("", |(_, name, _)| name)
    }

    /// Size of an element in bytes.
    pub fn size(self) -> usize {
        Self::ALL.iter().find(|(dtype, ..)| *dtype == self).map_or(1, |(.., size)| *size)
    }
}

/// An array with any number of axes.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Array {
    dtype: Dtype,
    shape: Vec<usize>,
    data: Vec<u8>,
}

/// An error: the number of bytes does not match shape and type of an array.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{bytes} bytes do not match an array of shape {shape:?} and type {dtype}")]
pub struct InvalidArray {
    shape: Vec<usize>,
    dtype: &'static str,
    bytes: usize,
}

impl Array {
    /// Create an array from its raw bytes, in C order.
    pub fn new(dtype: Dtype, shape: Vec<usize>, data: Vec<u8>) -> Result<Self, InvalidArray> {
        let bytes = shape.iter().try_fold(dtype.size(), |product, n| product.checked_mul(*n));
        if bytes != Some(data.len()) {
            return Err(InvalidArray { shape, dtype: dtype.name(), bytes: data.len() });
        }
        Ok(Self { dtype, shape, data })
    }

    /// Create a vector. `dtype` is a single- or double-precision float. Any other type becomes double precision.
    pub fn vector(numbers: &[f64], dtype: Dtype) -> Self {
        let (dtype, data) = match dtype {
            Dtype::F32 => (dtype, numbers.iter().flat_map(|n| (*n as f32).to_le_bytes()).collect()),
            _ => (Dtype::F64, numbers.iter().flat_map(|n| n.to_le_bytes()).collect()),
        };
        Self { dtype, shape: vec![numbers.len()], data }
    }

    /// Create an array whose rows are vectors of the same length. `dtype` as for [`Self::vector`].
    pub(crate) fn stacked<'a>(
        rows: impl ExactSizeIterator<Item = &'a [f64]> + Clone,
        dtype: Dtype,
    ) -> Result<Self, InvalidArray> {
        let shape = vec![rows.len(), rows.clone().next().map_or(0, <[f64]>::len)];
        let numbers: Vec<f64> = rows.flatten().copied().collect();
        let flat = Self::vector(&numbers, dtype);
        Self::new(flat.dtype, shape, flat.data)
    }

    /// The same elements with another shape of the same size.
    #[cfg(test)]
    #[must_use]
    pub(crate) fn reshaped(self, shape: Vec<usize>) -> Self {
        debug_assert_eq!(shape.iter().product::<usize>(), self.shape.iter().product::<usize>());
        Self { shape, ..self }
    }

    /// Type of the elements.
    pub fn dtype(&self) -> Dtype {
        self.dtype
    }

    /// Number of elements along each axis.
    pub fn shape(&self) -> &[usize] {
        &self.shape
    }

    /// The raw bytes, in C order.
    pub fn data(&self) -> &[u8] {
        &self.data
    }

    pub(crate) fn into_data(self) -> Vec<u8> {
        self.data
    }

    /// The elements in C order, as double-precision floats.
    pub fn numbers(&self) -> Vec<f64> {
        fn each<const N: usize>(data: &[u8], read: impl Fn([u8; N]) -> f64) -> Vec<f64> {
            data.as_chunks().0.iter().map(|bytes| read(*bytes)).collect()
        }
        let data = &self.data;
        match self.dtype {
            Dtype::Bool | Dtype::U8 => data.iter().map(|n| f64::from(*n)).collect(),
            Dtype::I8 => each(data, |b| f64::from(i8::from_le_bytes(b))),
            Dtype::U16 => each(data, |b| f64::from(u16::from_le_bytes(b))),
            Dtype::I16 => each(data, |b| f64::from(i16::from_le_bytes(b))),
            Dtype::U32 => each(data, |b| f64::from(u32::from_le_bytes(b))),
            Dtype::I32 => each(data, |b| f64::from(i32::from_le_bytes(b))),
            Dtype::U64 => each(data, |b| u64::from_le_bytes(b) as f64),
            Dtype::I64 => each(data, |b| i64::from_le_bytes(b) as f64),
            Dtype::F16 => each(data, |b| half(u16::from_le_bytes(b))),
            Dtype::F32 => each(data, |b| f64::from(f32::from_le_bytes(b))),
            Dtype::F64 => each(data, f64::from_le_bytes),
        }
    }
}

impl fmt::Display for Array {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:?} {}", self.shape, self.dtype.name())
    }
}

/// IEEE 754 binary16.
fn half(bits: u16) -> f64 {
    let sign = if bits >> 15 == 0 { 1.0 } else { -1.0 };
    let (exponent, fraction) = ((bits >> 10) & 0x1f, f64::from(bits & 0x3ff));
    sign * match exponent {
        0 => fraction * 2f64.powi(-24),
        0x1f if fraction > 0.0 => f64::NAN,
        0x1f => f64::INFINITY,
        _ => (1.0 + fraction / 1024.0) * 2f64.powi(i32::from(exponent) - 15),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn types_are_read_from_names_and_words() {
        for (name, dtype) in
            [("<f4", Dtype::F32), ("float16", Dtype::F16), ("float64", Dtype::F64), ("uint8", Dtype::U8)]
        {
            assert_eq!(Dtype::read(name), Ok(dtype));
        }
        for name in [">f8", "bfloat16", "float", "float128", "torch.float32", "|O8", ""] {
            let error = Dtype::read(name).unwrap_err();
            assert!(error.contains(&format!("`{name}`. Expected one of: |b1, |u1")), "{error}");
        }
    }

    #[test]
    fn half_precision_follows_ieee_754() {
        // IEEE 754-2008, binary16: one, minus two, the largest, the smallest subnormal.
        for (bits, value) in [(0x3c00, 1.0), (0xc000, -2.0), (0x7bff, 65504.0), (0x0001, 5.960_464_477_539_063e-8)] {
            assert_eq!(half(bits), value);
        }
        assert!(half(0x7e00).is_nan());
    }

    #[test]
    fn wrong_byte_counts_are_errors() {
        assert!(Array::new(Dtype::F32, vec![2, 3], vec![0; 24]).is_ok());
        for shape in [vec![2, 2], vec![usize::MAX, 2], vec![usize::MAX, usize::MAX, 4]] {
            assert!(Array::new(Dtype::F32, shape, vec![0; 24]).is_err());
        }
    }
}
