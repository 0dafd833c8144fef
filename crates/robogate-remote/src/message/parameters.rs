//! Parameter values in messages.

use std::collections::BTreeMap;
use std::sync::Arc;

use robogate_core::{Assignment, Value};
use serde::{Deserialize, Serialize};

/// The value of a parameter.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum ParameterValue {
    /// An integer.
    Integer(i64),
    /// A floating-point number.
    Float(f64),
    /// A category.
    Text(String),
}

/// Convert an assignment to its form on the wire.
pub(crate) fn to_wire(assignment: &Assignment) -> BTreeMap<String, ParameterValue> {
    let wire = |value: &Value| match value {
        Value::Integer(n) => ParameterValue::Integer(*n),
        Value::Number(x) => ParameterValue::Float(*x),
        Value::Category(text) => ParameterValue::Text(text.to_string()),
    };
    assignment.iter().map(|(name, value)| (name.to_owned(), wire(value))).collect()
}

/// Read parameters from a message. Names that `like` contains keep its order.
pub(crate) fn from_wire(parameters: &BTreeMap<String, ParameterValue>, like: &Assignment) -> Assignment {
    let value = |wire: &ParameterValue| match wire {
        ParameterValue::Integer(n) => Value::Integer(*n),
        ParameterValue::Float(x) => Value::Number(*x),
        ParameterValue::Text(text) => Value::Category(text.as_str().into()),
    };
    let known = like.iter().filter_map(|(name, _)| parameters.get_key_value(name));
    let other = parameters.iter().filter(|(name, _)| like.get(name).is_none());
    known.chain(other).map(|(name, wire)| (Arc::from(name.as_str()), value(wire))).collect()
}
