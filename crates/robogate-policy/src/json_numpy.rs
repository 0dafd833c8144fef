//! Arrays in JSON as the Python package json-numpy writes them: raw bytes in base64, type and shape.

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use serde_json::Value as Json;

use super::array::{Array, Dtype};
use super::error::ServerError;

/// Appends an array with so many axes of one before its own, spaced as Python's `json` does.
pub(crate) fn write(json: &mut String, array: &Array, ones: usize) {
    json.push_str("{\"__numpy__\": \"");
    STANDARD.encode_string(array.data(), json);
    let shape =
        std::iter::repeat_n(&1, ones).chain(array.shape()).map(ToString::to_string).collect::<Vec<_>>().join(", ");
    json.push_str(&format!("\", \"dtype\": \"{}\", \"shape\": [{shape}]}}", array.dtype().name()));
}

/// Appends a text.
pub(crate) fn write_text(json: &mut String, text: &str) {
    json.push_str(&Json::from(text).to_string());
}

/// The array that a JSON value is.
pub(crate) fn read(what: &'static str, json: &Json) -> Result<Array, ServerError> {
    let wrong = |why: String| ServerError::undecodable(what, why);
    let field = |key: &str| json.get(key).ok_or_else(|| wrong(format!("no array: its `{key}` is missing")));
    let text = |key: &str| field(key)?.as_str().ok_or_else(|| wrong(format!("no array: its `{key}` is no text")));
    let data =
        STANDARD.decode(text("__numpy__")?).map_err(|e| wrong(format!("no array: its bytes are no base64: {e}")))?;
    let dtype = text("dtype")?;
    let dtype = Dtype::by_name(dtype).ok_or_else(|| wrong(format!("arrays of type `{dtype}` are not understood")))?;
    let shape = field("shape")?
        .as_array()
        .and_then(|axes| axes.iter().map(|n| usize::try_from(n.as_u64()?).ok()).collect::<Option<Vec<_>>>())
        .ok_or_else(|| wrong("no array: its `shape` is no list of sizes".to_owned()))?;
    Array::new(dtype, shape, data).map_err(|e| wrong(e.to_string()))
}
