//! Values and arrays in msgpack. Policy servers write NumPy arrays as maps, in two variants.

use rmpv::ValueRef;

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
    let mut rest = bytes;
    let value = rmpv::decode::read_value_ref_with_max_depth(&mut rest, MAX_DEPTH)
        .map_err(|e| PolicyError::invalid_reply(what, format!("not valid msgpack: {e}")))?;
    if rest.is_empty() {
        return Ok(value);
    }
    Err(PolicyError::invalid_reply(what, format!("not valid msgpack: {} bytes after the end", rest.len())))
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
    let missing =
        |key: &str| PolicyError::invalid_reply(what, format!("not an array: `{key}` is missing or has the wrong type"));
    let Some(ValueRef::Boolean(true)) = get(value, "__ndarray__") else { return Err(missing("__ndarray__")) };
    let Some(ValueRef::Binary(data)) = get(value, "data") else { return Err(missing("data")) };
    let dtype = get(value, "dtype").and_then(name).ok_or_else(|| missing("dtype"))?;
    let dtype = Dtype::by_name(dtype)
        .ok_or_else(|| PolicyError::invalid_reply(what, format!("unsupported array type `{dtype}`")))?;
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
