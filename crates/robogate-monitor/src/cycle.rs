//! One cycle of a robot, as it reports it.

use std::collections::BTreeMap;
use std::fmt;

use robogate_stats::format::is_deceptive;
use schemars::JsonSchema;
use serde::de::{Error, MapAccess, Visitor};
use serde::{Deserialize, Deserializer, Serialize};

use crate::events;
use crate::modes::OTHER_MODE;

/// Maximum length of an id, robot, recipe, failure mode or parameter name, in bytes.
pub const LONGEST_NAME: usize = 128;
/// Maximum number of parameters, and of events, of one cycle.
pub const MOST_PARAMETERS: usize = 64;

/// One cycle, as the robot or the cell's controller reports it: one JSON object.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(try_from = "Written")]
#[schemars(!try_from, deny_unknown_fields)]
pub struct Cycle {
    /// Identifies this cycle among all robots. A cycle with a known id is not counted again.
    pub id: String,
    /// The robot.
    pub robot: String,
    /// The work of the robot: product, program, gripper. Cycles are compared within one recipe only.
    pub recipe: String,
    /// The end of the cycle on the sender's clock, in seconds since 1970-01-01 UTC.
    pub time_s: f64,
    /// Whether the task succeeded.
    pub success: bool,
    /// The failure mode. Every word is accepted, because the task names its modes (`jammed`, `timeout`). Absent for a
    /// success.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub failure_mode: Option<String>,
    /// Whether events happened in this cycle, by name (`{"spill": false}`), in a successful or a failed cycle. An event
    /// that the cell cannot detect is absent.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub events: BTreeMap<String, bool>,
    /// The duration of the cycle, in seconds.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub cycle_time_s: Option<f64>,
    /// Measured parameters of this cycle, by the names of the parameter space (`mass_kg`, `friction`).
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub parameters: BTreeMap<String, ParameterValue>,
}

/// The value of a reported parameter.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(untagged, expecting = "a parameter is neither a number nor a word")]
pub enum ParameterValue {
    /// A number, in the unit of the parameter's name.
    Number(f64),
    /// A category.
    Word(String),
}

/// An error in a cycle.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum CycleError {
    /// A name that is empty, too long, or contains control characters or controls of the text direction.
    #[error(
        "`{field}` must have 1 to {LONGEST_NAME} bytes and no control characters or controls of the text direction"
    )]
    Name {
        /// The field.
        field: &'static str,
    },
    /// A number outside its range.
    #[error("`{field}` is {value:?}, but must be {range}")]
    Number {
        /// The field.
        field: String,
        /// The given value.
        value: f64,
        /// The expected range.
        range: &'static str,
    },
    /// A success with a failure mode.
    #[error("`failure_mode` is `{mode}` although `success` is true")]
    SuccessfulFailure {
        /// The given mode.
        mode: String,
    },
    /// Too many events.
    #[error("{0} events. Expected at most {MOST_PARAMETERS}")]
    Events(usize),
    /// Too many parameters.
    #[error("{0} parameters. Expected at most {MOST_PARAMETERS}")]
    Parameters(usize),
}

/// Whether a text is a valid id, robot, recipe, failure mode or parameter name.
pub(crate) fn is_name(name: &str) -> bool {
    !name.is_empty() && name.len() <= LONGEST_NAME && !name.contains(is_deceptive)
}

/// A cycle as it is read: with events, or with the fields that the first cycle records had for two of them.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Written {
    id: String,
    robot: String,
    recipe: String,
    time_s: f64,
    success: bool,
    #[serde(default)]
    failure_mode: Option<String>,
    #[serde(default)]
    events: BTreeMap<String, bool>,
    /// The former field of this event.
    #[serde(default)]
    drop: Option<bool>,
    /// The former field of this event.
    #[serde(default)]
    collision: Option<bool>,
    #[serde(default)]
    cycle_time_s: Option<f64>,
    #[serde(default, deserialize_with = "unique")]
    parameters: BTreeMap<String, ParameterValue>,
}

/// Parameters, of which none is given twice.
fn unique<'de, D: Deserializer<'de>>(deserializer: D) -> Result<BTreeMap<String, ParameterValue>, D::Error> {
    struct Parameters;
    impl<'de> Visitor<'de> for Parameters {
        type Value = BTreeMap<String, ParameterValue>;

        fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
            f.write_str("parameters with their values")
        }

        fn visit_map<A: MapAccess<'de>>(self, mut entries: A) -> Result<Self::Value, A::Error> {
            let mut found = BTreeMap::new();
            while let Some((name, value)) = entries.next_entry::<String, ParameterValue>()? {
                if found.contains_key(&name) {
                    return Err(A::Error::custom(format!("the parameter `{}` is given twice", name.escape_debug())));
                }
                found.insert(name, value);
            }
            Ok(found)
        }
    }
    deserializer.deserialize_map(Parameters)
}

impl TryFrom<Written> for Cycle {
    type Error = String;

    fn try_from(written: Written) -> Result<Self, String> {
        let mut events = written.events;
        events::merge(&mut events, [written.drop, written.collision])
            .map_err(|name| format!("`{name}` is given twice: as a field and in `events`"))?;
        Ok(Self {
            id: written.id,
            robot: written.robot,
            recipe: written.recipe,
            time_s: written.time_s,
            success: written.success,
            failure_mode: written.failure_mode,
            events,
            cycle_time_s: written.cycle_time_s,
            parameters: written.parameters,
        })
    }
}

impl Cycle {
    /// Checks all fields.
    ///
    /// # Errors
    /// The first problem, with the expected value.
    pub fn check(&self) -> Result<(), CycleError> {
        for (field, name) in [("id", &self.id), ("robot", &self.robot), ("recipe", &self.recipe)] {
            if !is_name(name) {
                return Err(CycleError::Name { field });
            }
        }
        let number = |field: &str, value: f64, most: f64, range| {
            let good = value.is_finite() && value >= 0.0 && value <= most;
            if good { Ok(()) } else { Err(CycleError::Number { field: field.to_owned(), value, range }) }
        };
        // 253402300800 is the end of the year 9999. Milliseconds that are sent as seconds lie beyond it.
        number(
            "time_s",
            self.time_s,
            253_402_300_800.0,
            "seconds since 1970, from 0 to 253402300800: divide milliseconds by 1000",
        )?;
        if let Some(time) = self.cycle_time_s {
            number("cycle_time_s", time, 1e6, "seconds from 0 to 1000000")?;
        }
        if let Some(mode) = &self.failure_mode {
            if self.success {
                return Err(CycleError::SuccessfulFailure { mode: mode.clone() });
            }
            if !is_name(mode) {
                return Err(CycleError::Name { field: "failure_mode" });
            }
        }
        if self.events.len() > MOST_PARAMETERS {
            return Err(CycleError::Events(self.events.len()));
        }
        if !self.events.keys().all(|name| is_name(name)) {
            return Err(CycleError::Name { field: "events" });
        }
        if self.parameters.len() > MOST_PARAMETERS {
            return Err(CycleError::Parameters(self.parameters.len()));
        }
        for (name, value) in &self.parameters {
            match value {
                _ if !is_name(name) => return Err(CycleError::Name { field: "parameters" }),
                ParameterValue::Number(x) if !x.is_finite() => {
                    return Err(CycleError::Number { field: name.clone(), value: *x, range: "finite" });
                }
                ParameterValue::Word(word) if !is_name(word) => return Err(CycleError::Name { field: "parameters" }),
                _ => {}
            }
        }
        Ok(())
    }

    /// The failure mode, or [`OTHER_MODE`] if the sender reports none. `None` for a success.
    pub fn mode(&self) -> Option<&str> {
        (!self.success).then(|| self.failure_mode.as_deref().unwrap_or(OTHER_MODE))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn cycle(json: &str) -> Result<Cycle, String> {
        let cycle: Cycle = serde_json::from_str(json).map_err(|e| e.to_string())?;
        cycle.check().map_err(|e| e.to_string())?;
        Ok(cycle)
    }

    #[test]
    fn five_fields_are_required() {
        let least = r#"{"id":"a","robot":"r","recipe":"x","time_s":1.5,"success":true}"#;
        assert_eq!(cycle(least).unwrap().mode(), None);
        assert!(cycle(r#"{"id":"a","robot":"r","recipe":"x","success":true}"#).unwrap_err().contains("time_s"));
        assert!(cycle(&least.replace("time_s\"", "times\"")).is_err());
    }

    #[test]
    fn malformed_cycles_name_the_problem() {
        let with = |more: &str| {
            cycle(&format!(r#"{{"id":"a","robot":"r","recipe":"x","time_s":1,"success":true{more}}}"#)).unwrap_err()
        };
        assert!(with(r#","failure_mode":"timeout""#).contains("although `success` is true"));
        assert!(with(r#","cycle_time_s":-1"#).contains("`cycle_time_s` is -1.0"));
        let milliseconds = r#"{"id":"a","robot":"r","recipe":"x","time_s":1795254000000,"success":true}"#;
        assert!(cycle(milliseconds).unwrap_err().contains("seconds since 1970"));
        assert!(with(r#","parameters":{"m":1,"m":2}"#).contains("the parameter `m` is given twice"));
        assert!(with(r#","parameters":{"m":[1]}"#).contains("a parameter is neither a number nor a word"));
        assert!(cycle(r#"{"id":"","robot":"r","recipe":"x","time_s":1,"success":true}"#).unwrap_err().contains("`id`"));
    }

    #[test]
    fn events_have_names() {
        let with =
            |more: &str| cycle(&format!(r#"{{"id":"a","robot":"r","recipe":"x","time_s":1,"success":true{more}}}"#));
        let new = with(r#","events":{"drop":true,"spill":false}"#).unwrap();
        assert_eq!(new.events, [("drop".to_owned(), true), ("spill".to_owned(), false)].into());
        let former = with(r#","drop":true,"collision":false"#).unwrap();
        assert_eq!(former.events, [("collision".to_owned(), false), ("drop".to_owned(), true)].into());
        assert_eq!(serde_json::from_str::<Cycle>(&serde_json::to_string(&former).unwrap()).unwrap(), former);
        assert!(with(r#","drop":true,"events":{"drop":false}"#).unwrap_err().contains("`drop` is given twice"));
        assert!(with(r#","events":{"":true}"#).unwrap_err().contains("`events`"));
    }

    #[test]
    fn all_words_are_failure_modes() {
        let failed = |mode: &str| {
            let json = format!(r#"{{"id":"a","robot":"r","recipe":"x","time_s":1,"success":false{mode}}}"#);
            cycle(&json).unwrap()
        };
        assert_eq!(failed(r#","failure_mode":"spilled""#).mode(), Some("spilled"));
        assert_eq!(failed("").mode(), Some(OTHER_MODE));
    }
}
