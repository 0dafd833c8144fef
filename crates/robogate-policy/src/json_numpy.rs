//! Arrays in JSON: in the format of the Python package json-numpy (raw bytes in base64, type and shape), or as plain
//! lists of numbers.

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use robogate_core::budget::{Budget, JsonError};
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

/// Decode JSON from a server, within a budget. `NaN` and infinity, which Python writes as numbers, become texts.
pub(crate) fn parse(what: &'static str, text: &[u8]) -> Result<Json, PolicyError> {
    let mut parsed = Budget::REPLY.json(text);
    if let Err(JsonError::Syntax(_)) = parsed
        && let Some(json) = quoted(text).and_then(|text| Budget::REPLY.json(&text).ok())
    {
        parsed = Ok(json);
    }
    parsed.map_err(|error| match error {
        JsonError::Syntax(error) => {
            PolicyError::invalid_reply(what, format!("not valid JSON: {error}, in {}", excerpt(text)))
        }
        JsonError::OverBudget(limit) => PolicyError::invalid_reply(what, limit),
    })
}

/// Numbers that Python writes although JSON has none of them. The longest first.
const NOT_FINITE: [(&str, f64); 3] = [("-Infinity", f64::NEG_INFINITY), ("Infinity", f64::INFINITY), ("NaN", f64::NAN)];

/// Put numbers that are not finite into quotes. `None` if there are none.
fn quoted(text: &[u8]) -> Option<Vec<u8>> {
    let (mut out, mut rest, mut found) = (Vec::with_capacity(text.len() + 64), text, false);
    while let Some(first) = rest.first() {
        let word = NOT_FINITE.iter().find(|(word, _)| rest.starts_with(word.as_bytes()));
        let length = match (word, first) {
            (Some((word, _)), _) => word.len(),
            (None, b'"') => string_length(rest),
            _ => 1,
        };
        let (piece, after) = rest.split_at(length);
        out.extend(word.map(|_| b'"'));
        out.extend_from_slice(piece);
        out.extend(word.map(|_| b'"'));
        found |= word.is_some();
        rest = after;
    }
    found.then_some(out)
}

/// Number of bytes of the JSON string at the start of a text, with both quotes. The length of the text if it does not end.
fn string_length(text: &[u8]) -> usize {
    let mut escaped = false;
    let end = text.iter().skip(1).position(|byte| {
        let ends = *byte == b'"' && !escaped;
        escaped = *byte == b'\\' && !escaped;
        ends
    });
    end.map_or(text.len(), |at| at + 2)
}

/// The start of a reply, for an error.
pub(crate) fn excerpt(text: &[u8]) -> String {
    const KEPT: usize = 80;
    if text.is_empty() {
        return "an empty reply".to_owned();
    }
    let text = String::from_utf8_lossy(&text[..text.len().min(4 * KEPT)]);
    let mut start: String = text.chars().map(|c| if c.is_control() { ' ' } else { c }).take(KEPT).collect();
    if start.len() < text.len() {
        start.push_str(" ...");
    }
    format!("`{start}`")
}

/// Read an array.
pub(crate) fn read(what: &'static str, json: &Json) -> Result<Array, PolicyError> {
    let wrong = |why: String| PolicyError::invalid_reply(what, why);
    if json.is_array() || json.is_number() {
        let (mut shape, mut numbers) = (Vec::new(), Vec::new());
        flatten(json, 0, &mut shape, &mut numbers).map_err(|why| wrong(format!("not an array: {why}")))?;
        let data = numbers.iter().flat_map(|number| number.to_le_bytes()).collect();
        return Array::new(Dtype::F64, shape, data).map_err(|e| wrong(e.to_string()));
    }
    if json.get("__numpy__").is_none() {
        return Err(wrong(format!(
            "not an array: expected a list of numbers, or a map with `__numpy__`, `dtype` and `shape`, got {}",
            excerpt(json.to_string().as_bytes())
        )));
    }
    let field = |key: &str| json.get(key).ok_or_else(|| wrong(format!("not an array: `{key}` is missing")));
    let text = |key: &str| field(key)?.as_str().ok_or_else(|| wrong(format!("not an array: `{key}` is not a string")));
    let data = STANDARD
        .decode(text("__numpy__")?)
        .map_err(|e| wrong(format!("not an array: the data are not valid base64: {e}")))?;
    let dtype = text("dtype")?;
    let dtype = Dtype::read(dtype).map_err(wrong)?;
    let shape = field("shape")?
        .as_array()
        .and_then(|axes| axes.iter().map(|n| usize::try_from(n.as_u64()?).ok()).collect::<Option<Vec<_>>>())
        .ok_or_else(|| wrong("not an array: `shape` is not a list of sizes".to_owned()))?;
    Array::new(dtype, shape, data).map_err(|e| wrong(e.to_string()))
}

/// Appends the numbers of nested lists, which must form an array of one shape.
fn flatten(json: &Json, depth: usize, shape: &mut Vec<usize>, numbers: &mut Vec<f64>) -> Result<(), String> {
    let Json::Array(items) = json else {
        let number = match json {
            // Several encoders write `null` for a number that is not finite.
            Json::Null => Some(f64::NAN),
            Json::String(text) => NOT_FINITE.iter().find(|(word, _)| text == word).map(|(_, number)| *number),
            _ => json.as_f64(),
        };
        let number = number.ok_or_else(|| {
            let shown: String = json.to_string().chars().take(60).collect();
            format!("expected a number, got {shown}")
        })?;
        if depth < shape.len() {
            return Err("the lists have different depths".to_owned());
        }
        numbers.push(number);
        return Ok(());
    };
    match shape.get(depth) {
        Some(length) if *length != items.len() => {
            return Err(format!("the lists have different lengths: {length} and {}", items.len()));
        }
        Some(_) => {}
        // After a number, deeper lists are an error.
        None if !numbers.is_empty() => return Err("the lists have different depths".to_owned()),
        None => shape.push(items.len()),
    }
    items.iter().try_for_each(|item| flatten(item, depth + 1, shape, numbers))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn json_bombs_are_rejected() {
        for (text, part) in [
            (format!("[{}0]", "{\"\":0},".repeat(1_000_000)), "too many values"),
            (format!("[{}0]", "[],".repeat(2_000_000)), "too many values"),
            (format!("[{}0]", "0,".repeat(4_000_000)), "too many values"),
            ("[".repeat(8_000_000), "nested too deeply"),
        ] {
            let (result, peak) = robogate_testing::peak_memory(|| parse("reply", text.as_bytes()));
            let error = result.unwrap_err().to_string();
            assert!(error.contains(part), "{error}");
            assert!(peak < 10_000, "{peak}");
        }
        // The largest list that is accepted.
        let text = format!("[{}0]", "0,".repeat(Budget::REPLY.values - 3));
        let (result, peak) = robogate_testing::peak_memory(|| parse("reply", text.as_bytes()));
        assert!(result.is_ok());
        assert!(peak < 2 * robogate_core::budget::BYTES_PER_VALUE * Budget::REPLY.values, "{peak}");
    }

    #[test]
    fn plain_lists_are_arrays() {
        let read = |text: &str| read("reply", &serde_json::from_str(text).unwrap());
        let array = read("[[1, 2.5, 3], [4, 5, 6]]").unwrap();
        assert_eq!((array.shape(), array.numbers()), (&[2, 3][..], vec![1.0, 2.5, 3.0, 4.0, 5.0, 6.0]));
        assert_eq!(read("[0.5, -1]").unwrap().shape(), [2]);
        for wrong in ["[[1], [2, 3]]", "[1, [2]]", "[[1], 2]", "[\"a\"]", "[[], [1]]"] {
            assert!(read(wrong).is_err(), "{wrong}");
        }
        let error = super::read("reply", &serde_json::json!({"data": [1.0]})).unwrap_err().to_string();
        assert!(error.contains("a map with `__numpy__`, `dtype` and `shape`, got `{\"data\":[1.0]}`"), "{error}");
    }

    #[test]
    fn numbers_that_are_not_finite_are_read() {
        for (text, shown) in [
            ("[0.5, NaN, 1]", "NaN"),
            ("[0.5, Infinity, 1]", "inf"),
            ("[0.5, -Infinity, 1]", "-inf"),
            ("[0.5, null, 1]", "NaN"),
            ("[0.5, \"NaN\", 1]", "NaN"),
        ] {
            let numbers = read("reply", &parse("reply", text.as_bytes()).unwrap()).unwrap().numbers();
            assert_eq!((numbers[0], numbers[1].to_string().as_str(), numbers[2]), (0.5, shown, 1.0), "{text}");
        }
        // Texts are not changed.
        let text = r#"{"NaN \" NaN": "-Infinity", "x": NaN}"#;
        assert_eq!(
            parse("reply", text.as_bytes()).unwrap(),
            serde_json::json!({"NaN \" NaN": "-Infinity", "x": "NaN"})
        );
        for wrong in ["[NaNa]", "[Na]", "NaN NaN", "[\"NaN]", "<html>"] {
            let error = parse("reply", wrong.as_bytes()).unwrap_err().to_string();
            assert!(error.starts_with("invalid reply: reply: not valid JSON: ") && error.contains(wrong), "{error}");
        }
    }
}
