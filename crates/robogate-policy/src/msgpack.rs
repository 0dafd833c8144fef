//! Arrays in msgpack: the two ways in which policy servers write numpy arrays as maps.

use rmpv::ValueRef;

use super::array::{Array, Dtype};
use super::error::ServerError;

/// How deep an answer may be nested. Real ones have four levels.
const MAX_DEPTH: usize = 32;

/// How the keys of an array's map are written.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Keys {
    /// As bytes: openpi and RoboArena. With text the server takes the array for a map.
    Binary,
    /// As text: vla-eval.
    Text,
}

/// An array as a map of four: a mark, raw bytes, type and shape.
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

/// Arrays by their keys, as entries of a map.
pub(crate) fn arrays(arrays: &[(String, Array)], keys: Keys) -> impl Iterator<Item = (&str, ValueRef<'_>)> {
    arrays.iter().map(move |(key, value)| (key.as_str(), array(value, keys)))
}

/// A map with text keys.
pub(crate) fn map<'a>(entries: impl IntoIterator<Item = (&'a str, ValueRef<'a>)>) -> ValueRef<'a> {
    ValueRef::Map(entries.into_iter().map(|(key, value)| (ValueRef::from(key), value)).collect())
}

/// The bytes of a value.
pub(crate) fn encode(value: &ValueRef<'_>) -> Vec<u8> {
    let mut bytes = Vec::new();
    encode_into(&mut bytes, value);
    bytes
}

/// Appends the bytes of a value.
pub(crate) fn encode_into(bytes: &mut Vec<u8>, value: &ValueRef<'_>) {
    // Writing into a vector cannot fail.
    let _ = rmpv::encode::write_value_ref(bytes, value);
}

/// The value that all of these bytes are.
pub(crate) fn decode<'a>(what: &'static str, bytes: &'a [u8]) -> Result<ValueRef<'a>, ServerError> {
    let mut rest = bytes;
    let value = rmpv::decode::read_value_ref_with_max_depth(&mut rest, MAX_DEPTH)
        .map_err(|e| ServerError::undecodable(what, format!("no msgpack: {e}")))?;
    if rest.is_empty() {
        return Ok(value);
    }
    Err(ServerError::undecodable(what, format!("no msgpack: {} bytes after the end", rest.len())))
}

/// An entry of a map, whose keys may be text or bytes.
pub(crate) fn get<'v, 'a>(map: &'v ValueRef<'a>, key: &str) -> Option<&'v ValueRef<'a>> {
    entries(map)?.iter().find(|(k, _)| name(k) == Some(key)).map(|(_, value)| value)
}

/// The entries of a map.
pub(crate) fn entries<'v, 'a>(value: &'v ValueRef<'a>) -> Option<&'v [(ValueRef<'a>, ValueRef<'a>)]> {
    if let ValueRef::Map(entries) = value { Some(entries) } else { None }
}

/// Text, or bytes that are text.
pub(crate) fn name<'a>(value: &ValueRef<'a>) -> Option<&'a str> {
    match value {
        ValueRef::String(text) => text.into_str(),
        ValueRef::Binary(bytes) => std::str::from_utf8(bytes).ok(),
        _ => None,
    }
}

/// The array that a map of four is, whatever its keys are written as.
pub(crate) fn read_array(what: &'static str, value: &ValueRef<'_>) -> Result<Array, ServerError> {
    let missing =
        |key: &str| ServerError::undecodable(what, format!("no array: its `{key}` is missing or of another type"));
    let Some(ValueRef::Boolean(true)) = get(value, "__ndarray__") else { return Err(missing("__ndarray__")) };
    let Some(ValueRef::Binary(data)) = get(value, "data") else { return Err(missing("data")) };
    let dtype = get(value, "dtype").and_then(name).ok_or_else(|| missing("dtype"))?;
    let dtype = Dtype::by_name(dtype)
        .ok_or_else(|| ServerError::undecodable(what, format!("arrays of type `{dtype}` are not understood")))?;
    let Some(ValueRef::Array(shape)) = get(value, "shape") else { return Err(missing("shape")) };
    let shape = shape.iter().map(|n| usize::try_from(n.as_u64()?).ok()).collect::<Option<Vec<_>>>();
    Array::new(dtype, shape.ok_or_else(|| missing("shape"))?, data.to_vec())
        .map_err(|e| ServerError::undecodable(what, e))
}

/// What a server says of itself, as JSON: bytes and foreign types as a word in their place.
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
