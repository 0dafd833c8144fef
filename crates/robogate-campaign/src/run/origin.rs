//! Which setups may continue a recorded run.

use std::path::Path;

use robogate_core::ParameterSpace;
use robogate_dictionary::{Platform, Provenance};
use serde_json::Value;

use super::RunError;

pub(crate) fn known_version(path: &Path, found: u32, expected: u32) -> Result<(), RunError> {
    if found != expected {
        return Err(RunError::OtherVersion { path: path.to_owned(), found, expected });
    }
    Ok(())
}

/// Rejects a setup that differs from the one of the recorded run.
pub(crate) fn same_origin(recorded: &Provenance, present: &Provenance) -> Result<(), RunError> {
    let text = |value: &Option<String>| value.clone().unwrap_or_else(|| "unknown".to_owned());
    let of = |p: &Provenance| {
        [
            ("tool", p.tool.name.clone()),
            ("tool version", p.tool.version.clone()),
            ("dictionary schema", p.schema_version.to_string()),
            ("engine", p.engine.name.clone()),
            ("engine version", text(&p.engine.version)),
            ("engine build", text(&p.engine.build_sha256)),
            ("robot", p.robot.name.clone()),
            ("robot files", text(&p.robot.sha256)),
            ("policy", p.policy.clone()),
        ]
    };
    for ((what, recorded), (_, present)) in of(recorded).into_iter().zip(of(present)) {
        if recorded != present {
            return Err(RunError::Mismatch { what: what.to_owned(), recorded, present });
        }
    }
    // Not every C library tells its version. Properties that are not recorded are not compared.
    let known = |p: &Provenance| {
        let platform = p.platform.as_ref().map_or_else(|| vec![("platform", text(&None))], Platform::properties);
        let build = p.build.as_ref().map(|build| ("source files of robogate", build.source_sha256.clone()));
        platform.into_iter().chain(build).collect::<Vec<_>>()
    };
    let properties = known(present);
    for (what, recorded) in known(recorded) {
        let found = properties.iter().find(|(name, _)| *name == what);
        let present = found.map_or_else(|| text(&None), |(_, value)| value.clone());
        if recorded != present {
            return Err(RunError::Mismatch { what: what.to_owned(), recorded, present });
        }
    }
    let task = |p: &Provenance| serde_json::to_value(&*p.task).unwrap_or_default();
    let world = |p: &Provenance| serde_json::to_value(&p.world).unwrap_or_default();
    let worlds = [("world", world(recorded), world(present)), ("task", task(recorded), task(present))];
    for (name, recorded, present) in worlds {
        if let Some((what, recorded, present)) = difference(name.to_owned(), &recorded, &present) {
            return Err(RunError::Mismatch { what, recorded, present });
        }
    }
    if recorded.space != present.space {
        let name = |space: &ParameterSpace| format!("`{}`", space.name());
        let (recorded, present) = (name(&recorded.space), name(&present.space));
        return Err(RunError::Mismatch { what: "parameter space".to_owned(), recorded, present });
    }
    Ok(())
}

/// The first difference between two settings: its name and both values.
pub(super) fn difference(name: String, recorded: &Value, present: &Value) -> Option<(String, String, String)> {
    match (recorded, present) {
        (Value::Object(a), Value::Object(b)) => a.keys().chain(b.keys()).find_map(|key| {
            let of = |object: &serde_json::Map<String, Value>| object.get(key).cloned().unwrap_or_default();
            difference(format!("{name}.{key}"), &of(a), &of(b))
        }),
        _ if recorded == present => None,
        _ => Some((name, recorded.to_string(), present.to_string())),
    }
}
