//! Arrays as `.npy` files in memory (numpy's format 1.0 to 3.0): how GR00T's servers send them.

use super::array::{Array, Dtype};

const MAGIC: &[u8] = b"\x93NUMPY";

/// The bytes of the file that `numpy.save` writes, of an array with so many axes of one before its own.
pub(crate) fn write(array: &Array, ones: usize) -> Vec<u8> {
    let axes = std::iter::repeat_n(&1, ones).chain(array.shape());
    let axes: Vec<String> = axes.map(ToString::to_string).collect();
    let shape = match axes.as_slice() {
        [one] => format!("({one},)"),
        many => format!("({})", many.join(", ")),
    };
    let header = format!("{{'descr': '{}', 'fortran_order': False, 'shape': {shape}, }}", array.dtype().name());
    // Numpy leaves room for the first axis to grow and rounds up to 64 bytes: 128 in all for arrays of a few axes.
    let room = (MAGIC.len() + 4 + header.len() + 1).next_multiple_of(64).max(128) - MAGIC.len() - 4;
    let mut bytes = Vec::with_capacity(MAGIC.len() + 4 + room + array.data().len());
    bytes.extend_from_slice(MAGIC);
    bytes.extend_from_slice(&[1, 0]);
    bytes.extend_from_slice(&u16::try_from(room).unwrap_or(u16::MAX).to_le_bytes());
    bytes.extend_from_slice(format!("{header:<width$}\n", width = room - 1).as_bytes());
    bytes.extend_from_slice(array.data());
    bytes
}

/// The array in such a file.
pub(crate) fn read(bytes: &[u8]) -> Result<Array, String> {
    let after_magic = bytes.strip_prefix(MAGIC).ok_or("no .npy file: its first bytes are others")?;
    let (length, rest) = match after_magic {
        [1, _, a, b, rest @ ..] => (usize::from(u16::from_le_bytes([*a, *b])), rest),
        [2 | 3, _, a, b, c, d, rest @ ..] => (u32::from_le_bytes([*a, *b, *c, *d]) as usize, rest),
        _ => return Err("a .npy file of an unknown version".to_owned()),
    };
    let (header, data) = rest.split_at_checked(length).ok_or("a .npy file that ends in its header")?;
    let header = std::str::from_utf8(header).map_err(|_| "a .npy header that is no text")?;
    let (dtype, fortran, shape) = parse(header).ok_or_else(|| {
        let start: String = header.chars().take(120).collect();
        format!("a .npy header that is not understood: {start}")
    })?;
    let dtype = Dtype::by_name(dtype).ok_or_else(|| format!("arrays of type `{dtype}` are not understood"))?;
    if fortran && shape.iter().filter(|n| **n > 1).count() > 1 {
        return Err("an array in Fortran order".to_owned());
    }
    Array::new(dtype, shape, data.to_vec()).map_err(|e| e.to_string())
}

/// Type, order and shape from a header: a Python dictionary of these three, in any order.
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
    fn a_file_reads_back_as_it_was_written() {
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
    fn what_is_no_file_is_refused_in_words() {
        let good = write(&Array::vector(&[1.0, 2.0], Dtype::F64), 0);
        let at = good.windows(3).position(|bytes| bytes == b"<f8").unwrap();
        let mut objects = good.clone();
        objects[at..at + 3].copy_from_slice(b"|O8");
        for (bytes, words) in [
            (b"PK\x03\x04".to_vec(), "first bytes"),
            (good[..40].to_vec(), "ends in its header"),
            (good[..good.len() - 1].to_vec(), "cannot have 15 bytes"),
            (objects, "`|O8`"),
        ] {
            let error = read(&bytes).unwrap_err();
            assert!(error.contains(words), "{error}");
        }
    }
}
