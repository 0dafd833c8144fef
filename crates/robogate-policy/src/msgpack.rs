//! Values and arrays in msgpack. Policy servers write NumPy arrays as maps, in three variants: that of openpi with keys of
//! bytes or of text, and that of the Python package msgpack-numpy.

use rmpv::ValueRef;
use robogate_core::budget::Budget;

use super::array::{Array, Dtype};
use super::error::PolicyError;

/// Maximum nesting depth of a reply. Real ones have four levels.
const MAX_DEPTH: usize = 32;

/// Type of the keys of an encoded array.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Keys {
    /// Bytes: openpi and RoboArena. With string keys their servers do not recognise the array.
    Binary,
    /// Strings: vla-eval.
    Text,
}

/// An array as a map with four entries: a marker, raw bytes, type and shape.
pub(crate) fn array(array: &Array, keys: Keys) -> ValueRef<'_> {
    let key = |name: &'static str| match keys {
        Keys::Binary => ValueRef::Binary(name.as_bytes()),
        Keys::Text => ValueRef::from(name),
    };
    let shape = ValueRef::Array(array.shape().iter().map(|n| ValueRef::from(*n)).collect());
    let dtype = ValueRef::from(array.dtype().name());
    ValueRef::Map(vec![
        (key("__ndarray__"), ValueRef::Boolean(true)),
        (key("data"), ValueRef::Binary(array.data())),
        (key("dtype"), dtype),
        (key("shape"), shape),
    ])
}

/// An array as the Python package msgpack-numpy writes it, with `ones` additional leading axes of size 1. Its decoder
/// requires keys of bytes.
pub(crate) fn numpy(array: &Array, ones: usize) -> ValueRef<'_> {
    let shape = std::iter::repeat_n(&1, ones).chain(array.shape()).map(|n| ValueRef::from(*n)).collect();
    let entries = [
        ("nd", ValueRef::Boolean(true)),
        ("type", ValueRef::from(array.dtype().name())),
        ("kind", ValueRef::Binary(b"")),
        ("shape", ValueRef::Array(shape)),
        ("data", ValueRef::Binary(array.data())),
    ];
    ValueRef::Map(entries.into_iter().map(|(key, value)| (ValueRef::Binary(key.as_bytes()), value)).collect())
}

/// Named arrays as entries of a map.
pub(crate) fn arrays(arrays: &[(String, Array)], keys: Keys) -> impl Iterator<Item = (&str, ValueRef<'_>)> {
    arrays.iter().map(move |(key, value)| (key.as_str(), array(value, keys)))
}

/// A map with string keys.
pub(crate) fn map<'a>(entries: impl IntoIterator<Item = (&'a str, ValueRef<'a>)>) -> ValueRef<'a> {
    ValueRef::Map(entries.into_iter().map(|(key, value)| (ValueRef::from(key), value)).collect())
}

/// Encode a value.
pub(crate) fn encode(value: &ValueRef<'_>) -> Vec<u8> {
    let mut bytes = Vec::new();
    encode_into(&mut bytes, value);
    bytes
}

/// Append the encoding of a value.
pub(crate) fn encode_into(bytes: &mut Vec<u8>, value: &ValueRef<'_>) {
    // Writing into a vector cannot fail.
    let _ = rmpv::encode::write_value_ref(bytes, value);
}

/// Decode a value that takes up all bytes.
pub(crate) fn decode<'a>(what: &'static str, bytes: &'a [u8]) -> Result<ValueRef<'a>, PolicyError> {
    check(bytes).map_err(|why| PolicyError::invalid_reply(what, why))?;
    let mut rest = bytes;
    let value = rmpv::decode::read_value_ref_with_max_depth(&mut rest, MAX_DEPTH)
        .map_err(|e| PolicyError::invalid_reply(what, format!("not valid msgpack: {e}")))?;
    if rest.is_empty() {
        return Ok(value);
    }
    Err(PolicyError::invalid_reply(what, format!("not valid msgpack: {} bytes after the end", rest.len())))
}

/// Check the number of values. One of a single byte needs up to 80 bytes once it is decoded.
///
/// Values follow each other without gaps, also those in lists and maps, so no nesting has to be followed. Bytes that are not
/// msgpack may pass: the decoder rejects them.
fn check(bytes: &[u8]) -> Result<(), String> {
    let (mut rest, mut values) = (bytes, 0_usize);
    while let Some((&marker, after)) = rest.split_first() {
        values += 1;
        if values > Budget::REPLY.values {
            return Err(format!("it has more than {} values, which is too many", Budget::REPLY.values));
        }
        let length = |digits: usize| -> usize {
            after.get(..digits).unwrap_or_default().iter().fold(0, |sum, byte| sum << 8 | usize::from(*byte))
        };
        let skipped = match marker {
            0xa0..=0xbf => usize::from(marker & 0x1f),
            0xc4 | 0xd9 => 1 + length(1),
            0xc5 | 0xda => 2 + length(2),
            0xc6 | 0xdb => 4 + length(4),
            0xc7 => 2 + length(1),
            0xc8 => 3 + length(2),
            0xc9 => 5 + length(4),
            0xcc | 0xd0 => 1,
            0xcd | 0xd1 | 0xd4 | 0xdc | 0xde => 2,
            0xd5 => 3,
            0xca | 0xce | 0xd2 | 0xdd | 0xdf => 4,
            0xd6 => 5,
            0xcb | 0xcf | 0xd3 => 8,
            0xd7 => 9,
            0xd8 => 17,
            _ => 0,
        };
        let Some(next) = after.get(skipped..) else { return Ok(()) };
        rest = next;
    }
    Ok(())
}

/// The value of a key in a map whose keys are strings or bytes.
pub(crate) fn get<'v, 'a>(map: &'v ValueRef<'a>, key: &str) -> Option<&'v ValueRef<'a>> {
    entries(map)?.iter().find(|(k, _)| name(k) == Some(key)).map(|(_, value)| value)
}

/// The entries of a map.
pub(crate) fn entries<'v, 'a>(value: &'v ValueRef<'a>) -> Option<&'v [(ValueRef<'a>, ValueRef<'a>)]> {
    if let ValueRef::Map(entries) = value { Some(entries) } else { None }
}

/// The text of a string, or of bytes that are UTF-8.
pub(crate) fn name<'a>(value: &ValueRef<'a>) -> Option<&'a str> {
    match value {
        ValueRef::String(text) => text.into_str(),
        ValueRef::Binary(bytes) => std::str::from_utf8(bytes).ok(),
        _ => None,
    }
}

/// Read an array from its map, with keys of either type.
pub(crate) fn read_array(what: &'static str, value: &ValueRef<'_>) -> Result<Array, PolicyError> {
    read_marked(what, value, "__ndarray__", "dtype")
}

/// Read an array that the Python package msgpack-numpy wrote.
pub(crate) fn read_numpy(what: &'static str, value: &ValueRef<'_>) -> Result<Array, PolicyError> {
    read_marked(what, value, "nd", "type")
}

/// Read an array from a map with these keys for the marker and for the type of the elements.
fn read_marked(what: &'static str, value: &ValueRef<'_>, marker: &str, type_key: &str) -> Result<Array, PolicyError> {
    let missing =
        |key: &str| PolicyError::invalid_reply(what, format!("not an array: `{key}` is missing or has the wrong type"));
    let Some(ValueRef::Boolean(true)) = get(value, marker) else { return Err(missing(marker)) };
    let Some(ValueRef::Binary(data)) = get(value, "data") else { return Err(missing("data")) };
    let dtype = get(value, type_key).and_then(name).ok_or_else(|| missing(type_key))?;
    let dtype = Dtype::read(dtype).map_err(|why| PolicyError::invalid_reply(what, why))?;
    let Some(ValueRef::Array(shape)) = get(value, "shape") else { return Err(missing("shape")) };
    let shape = shape.iter().map(|n| usize::try_from(n.as_u64()?).ok()).collect::<Option<Vec<_>>>();
    Array::new(dtype, shape.ok_or_else(|| missing("shape"))?, data.to_vec())
        .map_err(|e| PolicyError::invalid_reply(what, e))
}

/// Convert a value to JSON. Bytes and extension types become placeholders.
pub(crate) fn to_json(value: &ValueRef<'_>) -> serde_json::Value {
    use serde_json::Value as Json;
    match value {
        ValueRef::Nil => Json::Null,
        ValueRef::Boolean(b) => Json::from(*b),
        ValueRef::Integer(n) => n.as_i64().map(Json::from).or_else(|| n.as_u64().map(Json::from)).unwrap_or(Json::Null),
        ValueRef::F32(n) => Json::from(*n),
        ValueRef::F64(n) => Json::from(*n),
        ValueRef::Array(items) => items.iter().map(to_json).collect(),
        ValueRef::Map(entries) => Json::Object(
            entries.iter().filter_map(|(key, value)| Some((name(key)?.to_owned(), to_json(value)))).collect(),
        ),
        other => name(other).map_or_else(|| Json::from("(bytes)"), Json::from),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::websocket::MAX_REPLY;

    /// A reply of the largest size in which each byte is a value.
    #[test]
    fn many_small_values_are_rejected() {
        let maps = |marker: u8| {
            let mut bytes = vec![0xdd];
            bytes.extend((MAX_REPLY as u32 - 5).to_be_bytes());
            bytes.resize(MAX_REPLY, marker);
            bytes
        };
        for marker in [0xc0, 0x80, 0x90, 0x01, 0xa0] {
            let (result, peak) = robogate_testing::peak_memory(|| decode("reply", &maps(marker)).map(drop));
            assert!(result.unwrap_err().to_string().contains("too many"), "{marker:#x}");
            assert!(peak < 2 * MAX_REPLY, "{peak}");
        }
    }

    #[test]
    fn values_are_counted_without_their_content() {
        let array = Array::vector(&[0.5; 4_000], Dtype::F64);
        let encoded = encode(&map([("actions", super::array(&array, Keys::Text)), ("a", ValueRef::from(7_000_000))]));
        assert_eq!(check(&encoded), Ok(()));
        assert_eq!(read_array("reply", get(&decode("reply", &encoded).unwrap(), "actions").unwrap()).unwrap(), array);
    }

    #[test]
    fn deep_nesting_is_an_error() {
        for bytes in [vec![0x91; 1_000], [0x81, 0xa0].repeat(1_000)] {
            assert!(decode("reply", &bytes).is_err());
        }
    }

    #[test]
    fn claimed_lengths_reserve_nothing() {
        for marker in [0xc6, 0xdb, 0xdd, 0xdf, 0xc9] {
            let bytes = [&[marker][..], &[0xff; 4], &[0; 3]].concat();
            let (result, peak) = robogate_testing::peak_memory(|| decode("reply", &bytes).map(drop));
            assert!(result.is_err());
            assert!(peak < 10_000, "{marker:#x}: {peak}");
        }
    }
}
