//! In-memory `.npy` files (NumPy format 1.0 to 3.0), as GR00T servers send them.

use super::array::{Array, Dtype};

const MAGIC: &[u8] = b"\x93NUMPY";

/// Write the file that `numpy.save` writes for an array with `ones` additional leading axes of size 1.
pub(crate) fn write(array: &Array, ones: usize) -> Vec<u8> {
    let axes = std::iter::repeat_n(&1, ones).chain(array.shape());
    let axes: Vec<String> = axes.map(ToString::to_string).collect();
    let shape = match axes.as_slice() {
        [one] => format!("({one},)"),
        many => format!("({})", many.join(", ")),
    };
    let header = format!("{{'descr': '{}', 'fortran_order': False, 'shape': {shape}, }}", array.dtype().name());
    // NumPy reserves space for the first axis to grow and rounds up to 64 bytes: 128 in total for arrays with few axes.
    let room = (MAGIC.len() + 4 + header.len() + 1).next_multiple_of(64).max(128) - MAGIC.len() - 4;
    let mut bytes = Vec::with_capacity(MAGIC.len() + 4 + room + array.data().len());
    bytes.extend_from_slice(MAGIC);
    bytes.extend_from_slice(&[1, 0]);
    bytes.extend_from_slice(&u16::try_from(room).unwrap_or(u16::MAX).to_le_bytes());
    bytes.extend_from_slice(format!("{header:<width$}\n", width = room - 1).as_bytes());
    bytes.extend_from_slice(array.data());
    bytes
}

/// Read the array of a file.
pub(crate) fn read(bytes: &[u8]) -> Result<Array, String> {
    let after_magic = bytes.strip_prefix(MAGIC).ok_or("not a .npy file: wrong first bytes")?;
    let (length, rest) = match after_magic {
        [1, _, a, b, rest @ ..] => (usize::from(u16::from_le_bytes([*a, *b])), rest),
        [2 | 3, _, a, b, c, d, rest @ ..] => (u32::from_le_bytes([*a, *b, *c, *d]) as usize, rest),
        _ => return Err("unknown version of the .npy format".to_owned()),
    };
    let (header, data) = rest.split_at_checked(length).ok_or("the .npy file ends inside its header")?;
    let header = std::str::from_utf8(header).map_err(|_| "the .npy header is not UTF-8")?;
    let (dtype, fortran, shape) = parse(header).ok_or_else(|| {
        let start: String = header.chars().take(120).collect();
        format!("invalid .npy header: {start}")
    })?;
    let dtype = Dtype::read(dtype)?;
    if fortran && shape.iter().filter(|n| **n > 1).count() > 1 {
        return Err("unsupported array in Fortran order".to_owned());
    }
    Array::new(dtype, shape, data.to_vec()).map_err(|e| e.to_string())
}

/// Parse type, order and shape from a header: a Python dictionary with these three keys, in any order.
fn parse(header: &str) -> Option<(&str, bool, Vec<usize>)> {
    let mut rest = header.trim().strip_prefix('{')?.strip_suffix('}')?.trim();
    let (mut dtype, mut fortran, mut shape) = (None, None, None);
    while !rest.is_empty() {
        let (key, value) = rest.strip_prefix('\'')?.split_once('\'')?;
        let value = value.trim_start().strip_prefix(':')?.trim_start();
        rest = match key {
            "descr" => {
                let (name, after) = value.strip_prefix('\'')?.split_once('\'')?;
                dtype = Some(name);
                after
            }
            "fortran_order" => {
                let (word, after) = value.split_at(value.find([',', ' ']).unwrap_or(value.len()));
                fortran = Some(match word {
                    "True" => true,
                    "False" => false,
                    _ => return None,
                });
                after
            }
            "shape" => {
                let (numbers, after) = value.strip_prefix('(')?.split_once(')')?;
                let numbers = numbers.split(',').map(str::trim).filter(|n| !n.is_empty());
                shape = Some(numbers.map(|n| n.parse().ok()).collect::<Option<Vec<_>>>()?);
                after
            }
            _ => return None,
        };
        rest = rest.trim_start();
        rest = rest.strip_prefix(',').unwrap_or(rest).trim_start();
    }
    Some((dtype?, fortran?, shape?))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn files_round_trip() {
        for shape in [vec![], vec![6], vec![2, 3], vec![1, 1, 2, 3]] {
            let size: usize = shape.iter().product();
            let array = Array::new(Dtype::F32, shape, (0..4 * size).map(|i| i as u8).collect()).unwrap();
            let bytes = write(&array, 0);
            assert_eq!((bytes.len() - array.data().len()) % 64, 0);
            assert_eq!(read(&bytes).unwrap(), array);
            let batched = read(&write(&array, 2)).unwrap();
            assert_eq!(batched.shape(), [[1, 1].as_slice(), array.shape()].concat());
            assert_eq!(batched.data(), array.data());
        }
    }

    #[test]
    fn invalid_files_are_errors() {
        let good = write(&Array::vector(&[1.0, 2.0], Dtype::F64), 0);
        let at = good.windows(3).position(|bytes| bytes == b"<f8").unwrap();
        let mut objects = good.clone();
        objects[at..at + 3].copy_from_slice(b"|O8");
        for (bytes, part) in [
            (b"PK\x03\x04".to_vec(), "wrong first bytes"),
            (good[..40].to_vec(), "ends inside its header"),
            (good[..good.len() - 1].to_vec(), "15 bytes do not match"),
            (objects, "`|O8`"),
        ] {
            let error = read(&bytes).unwrap_err();
            assert!(error.contains(part), "{error}");
        }
    }
}
