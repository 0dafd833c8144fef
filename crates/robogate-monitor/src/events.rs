//! Events of a cycle that have detectors of their own, whether the cycle succeeds or fails.

use std::collections::BTreeMap;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Maximum number of monitored events.
pub const MOST_EVENTS: usize = 8;

/// Events that the first cycle records had as fields, each with its usual causes. They are monitored unless the settings
/// list other events.
const FIRST: [(&str, &str); 2] = [
    ("drop", "gripping force, worn pads, heavier or smoother parts"),
    ("collision", "fixtures, obstacles and the calibration of the arm"),
];

/// The settings of one monitored event.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct EventSettings {
    /// Share of the event's rate in the false alarms.
    pub share: f64,
    /// What to inspect when the event becomes more frequent.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub causes: Option<String>,
}

/// The events that are monitored by default.
pub fn default_events() -> BTreeMap<String, EventSettings> {
    let settings = |causes: &str| EventSettings { share: 0.075, causes: Some(causes.to_owned()) };
    FIRST.into_iter().map(|(name, causes)| (name.to_owned(), settings(causes))).collect()
}

/// Adds the values of former fields to named events: `fields` in the order of [`FIRST`]. Returns the name of an event
/// that has two values.
pub(crate) fn merge<T>(events: &mut BTreeMap<String, T>, fields: [Option<T>; 2]) -> Result<(), &'static str> {
    for ((name, _), value) in FIRST.into_iter().zip(fields) {
        let Some(value) = value else { continue };
        if events.insert(name.to_owned(), value).is_some() {
            return Err(name);
        }
    }
    Ok(())
}
