//! Arrays in JSON, in the format of the Python package json-numpy: raw bytes in base64, type and shape.

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use serde_json::Value as Json;

use super::array::{Array, Dtype};
use super::error::PolicyError;

/// Append an array with `ones` leading axes of size 1, with the spacing of Python's `json`.
pub(crate) fn write(json: &mut String, array: &Array, ones: usize) {
    json.push_str("{\"__numpy__\": \"");
    STANDARD.encode_string(array.data(), json);
    let shape =
        std::iter::repeat_n(&1, ones).chain(array.shape()).map(ToString::to_string).collect::<Vec<_>>().join(", ");
    json.push_str(&format!("\", \"dtype\": \"{}\", \"shape\": [{shape}]}}", array.dtype().name()));
}

/// Append a string.
pub(crate) fn write_text(json: &mut String, text: &str) {
    json.push_str(&Json::from(text).to_string());
}

/// Read an array.
pub(crate) fn read(what: &'static str, json: &Json) -> Result<Array, PolicyError> {
    let wrong = |why: String| PolicyError::invalid_reply(what, why);
    let field = |key: &str| json.get(key).ok_or_else(|| wrong(format!("not an array: `{key}` is missing")));
    let text = |key: &str| field(key)?.as_str().ok_or_else(|| wrong(format!("not an array: `{key}` is not a string")));
    let data = STANDARD
        .decode(text("__numpy__")?)
        .map_err(|e| wrong(format!("not an array: the data are not valid base64: {e}")))?;
    let dtype = text("dtype")?;
    let dtype = Dtype::by_name(dtype).ok_or_else(|| wrong(format!("unsupported array type `{dtype}`")))?;
    let shape = field("shape")?
        .as_array()
        .and_then(|axes| axes.iter().map(|n| usize::try_from(n.as_u64()?).ok()).collect::<Option<Vec<_>>>())
        .ok_or_else(|| wrong("not an array: `shape` is not a list of sizes".to_owned()))?;
    Array::new(dtype, shape, data).map_err(|e| wrong(e.to_string()))
}
