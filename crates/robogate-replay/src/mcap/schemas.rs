//! JSON Schemas of the messages. Names that begin with `foxglove.` and their fields are those of
//! <https://docs.foxglove.dev/docs/sdk/schemas>; a schema lists the fields that are written.

use serde_json::{Value, json};

/// The name of a schema with its text.
type Schema = (&'static str, String);

fn object(fields: &[(&str, Value)]) -> Value {
    let properties: serde_json::Map<String, Value> =
        fields.iter().map(|(name, schema)| ((*name).to_owned(), schema.clone())).collect();
    json!({ "type": "object", "properties": properties })
}

fn list(of: Value) -> Value {
    json!({ "type": "array", "items": of })
}

fn number() -> Value {
    json!({ "type": "number" })
}

fn integer() -> Value {
    json!({ "type": "integer" })
}

fn text() -> Value {
    json!({ "type": "string" })
}

fn numbers(names: &[&str]) -> Value {
    let fields: Vec<(&str, Value)> = names.iter().map(|name| (*name, number())).collect();
    object(&fields)
}

/// A time or a duration.
fn time() -> Value {
    object(&[("sec", integer()), ("nsec", integer())])
}

fn vector() -> Value {
    numbers(&["x", "y", "z"])
}

fn rotation() -> Value {
    numbers(&["x", "y", "z", "w"])
}

fn pose() -> Value {
    object(&[("position", vector()), ("orientation", rotation())])
}

fn color() -> Value {
    numbers(&["r", "g", "b", "a"])
}

/// Poses of frames.
pub(super) fn frame_transforms() -> Schema {
    let transform = object(&[
        ("timestamp", time()),
        ("parent_frame_id", text()),
        ("child_frame_id", text()),
        ("translation", vector()),
        ("rotation", rotation()),
    ]);
    ("foxglove.FrameTransforms", object(&[("transforms", list(transform))]).to_string())
}

/// Shapes of a 3-D view.
pub(super) fn scene_update() -> Schema {
    let solid = object(&[("pose", pose()), ("size", vector()), ("color", color())]);
    let cylinder = object(&[
        ("pose", pose()),
        ("size", vector()),
        ("bottom_scale", number()),
        ("top_scale", number()),
        ("color", color()),
    ]);
    let arrow = object(&[
        ("pose", pose()),
        ("shaft_length", number()),
        ("shaft_diameter", number()),
        ("head_length", number()),
        ("head_diameter", number()),
        ("color", color()),
    ]);
    let triangles = object(&[
        ("pose", pose()),
        ("points", list(vector())),
        ("color", color()),
        ("colors", list(color())),
        ("indices", list(integer())),
    ]);
    let entity = object(&[
        ("timestamp", time()),
        ("frame_id", text()),
        ("id", text()),
        ("lifetime", time()),
        ("frame_locked", json!({ "type": "boolean" })),
        ("metadata", list(object(&[("key", text()), ("value", text())]))),
        ("arrows", list(arrow)),
        ("cubes", list(solid.clone())),
        ("spheres", list(solid)),
        ("cylinders", list(cylinder)),
        ("triangles", list(triangles)),
    ]);
    let deletion = object(&[("timestamp", time()), ("type", integer()), ("id", text())]);
    ("foxglove.SceneUpdate", object(&[("deletions", list(deletion)), ("entities", list(entity))]).to_string())
}

/// States or targets of joints.
pub(super) fn joint_states() -> Schema {
    let joint = object(&[("name", text()), ("position", number()), ("velocity", number())]);
    ("foxglove.JointStates", object(&[("timestamp", time()), ("joints", list(joint))]).to_string())
}

/// An encoded image.
pub(super) fn compressed_image() -> Schema {
    let data = json!({ "type": "string", "contentEncoding": "base64" });
    let fields = [("timestamp", time()), ("frame_id", text()), ("data", data), ("format", text())];
    ("foxglove.CompressedImage", object(&fields).to_string())
}

/// A line of a log.
pub(super) fn log() -> Schema {
    let fields = [
        ("timestamp", time()),
        ("level", integer()),
        ("message", text()),
        ("name", text()),
        ("file", text()),
        ("line", integer()),
    ];
    ("foxglove.Log", object(&fields).to_string())
}

/// The action of a policy.
pub(super) fn command() -> Schema {
    let fields =
        [("timestamp", time()), ("kind", text()), ("values", list(number())), ("gripper", number()), ("phase", text())];
    ("robogate.Command", object(&fields).to_string())
}

/// Contact points with their normal forces.
pub(super) fn contacts() -> Schema {
    let contact = object(&[("between", text()), ("position", vector()), ("force_n", vector())]);
    let fields = [("timestamp", time()), ("total_force_n", number()), ("contacts", list(contact))];
    ("robogate.Contacts", object(&fields).to_string())
}

/// The observed vectors by name.
pub(super) fn observation<'a>(names: impl Iterator<Item = &'a str>) -> Schema {
    let mut fields = vec![("timestamp", time())];
    fields.extend(names.map(|name| (name, list(number()))));
    ("robogate.Observation", object(&fields).to_string())
}

/// The measures by name.
pub(super) fn measures<'a>(names: impl Iterator<Item = &'a str>) -> Schema {
    let mut fields = vec![("timestamp", time())];
    fields.extend(names.map(|name| (name, number())));
    ("robogate.Measures", object(&fields).to_string())
}
