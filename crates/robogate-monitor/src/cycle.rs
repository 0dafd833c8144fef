//! One cycle of a robot, as it reports it.

use std::collections::BTreeMap;

use robogate_core::FailureMode;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Longest id, robot, recipe, failure mode or parameter name, in bytes.
pub const LONGEST_NAME: usize = 128;
/// Most parameters of one cycle.
pub const MOST_PARAMETERS: usize = 64;
/// Kinds of failure that the mix is watched over: the paper's four modes, and whatever else.
pub const MODES: [&str; 5] = ["grasp_miss", "grip_loss", "collision", "timeout", "other"];

/// One cycle, as the robot (or the cell's controller) reports it: one JSON object.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Cycle {
    /// Names this cycle among all robots. A cycle whose id is known already is not counted again.
    pub id: String,
    /// The robot.
    pub robot: String,
    /// What the robot was doing: product, program, gripper. Cycles are compared within one recipe only.
    pub recipe: String,
    /// When the cycle ended by the sender's clock, in seconds since 1970-01-01 UTC.
    pub time_s: f64,
    /// Whether the task was done.
    pub success: bool,
    /// How it failed: `grasp_miss`, `grip_loss`, `collision`, `timeout` or another word. Not with a success.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub failure_mode: Option<String>,
    /// Whether the object was dropped; absent where nothing tells.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub drop: Option<bool>,
    /// Whether the robot collided; absent where nothing tells.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub collision: Option<bool>,
    /// How long the cycle took, in seconds.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub cycle_time_s: Option<f64>,
    /// What the cell knows of this cycle, by the names of the parameter space (`mass_kg`, `friction`, `shape`, ...).
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub parameters: BTreeMap<String, ParameterValue>,
}

/// The value of a reported parameter.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(untagged)]
pub enum ParameterValue {
    /// A number, in the unit that the parameter's name ends with.
    Number(f64),
    /// A word.
    Word(String),
}

/// Why a cycle is malformed.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum CycleError {
    /// A name that is empty, too long or holds control characters.
    #[error("`{field}` must have 1 to {LONGEST_NAME} bytes and no control characters")]
    Name {
        /// The field.
        field: &'static str,
    },
    /// A number out of its range.
    #[error("`{field}` is {value}, but must be {range}")]
    Number {
        /// The field.
        field: String,
        /// What was sent.
        value: f64,
        /// What it must be.
        range: &'static str,
    },
    /// A success that names how it failed.
    #[error("`failure_mode` is `{mode}` although `success` is true")]
    SuccessfulFailure {
        /// The mode sent.
        mode: String,
    },
    /// Too many parameters.
    #[error("{0} parameters, but at most {MOST_PARAMETERS} are taken")]
    Parameters(usize),
}

impl Cycle {
    /// Refuses what cannot be a cycle.
    ///
    /// # Errors
    /// The first field that is wrong, and what it must be.
    pub fn check(&self) -> Result<(), CycleError> {
        let good = |name: &str| !name.is_empty() && name.len() <= LONGEST_NAME && !name.chars().any(char::is_control);
        for (field, name) in [("id", &self.id), ("robot", &self.robot), ("recipe", &self.recipe)] {
            if !good(name) {
                return Err(CycleError::Name { field });
            }
        }
        let number = |field: &str, value: f64, most: f64, range| {
            let good = value.is_finite() && value >= 0.0 && value <= most;
            if good { Ok(()) } else { Err(CycleError::Number { field: field.to_owned(), value, range }) }
        };
        // 253402300800 is the end of the year 9999; milliseconds sent as seconds lie beyond it.
        number("time_s", self.time_s, 253_402_300_800.0, "seconds since 1970, from 0 to 253402300800")?;
        if let Some(time) = self.cycle_time_s {
            number("cycle_time_s", time, 1e6, "seconds from 0 to 1000000")?;
        }
        if let Some(mode) = &self.failure_mode {
            if self.success {
                return Err(CycleError::SuccessfulFailure { mode: mode.clone() });
            }
            if !good(mode) {
                return Err(CycleError::Name { field: "failure_mode" });
            }
        }
        if self.parameters.len() > MOST_PARAMETERS {
            return Err(CycleError::Parameters(self.parameters.len()));
        }
        for (name, value) in &self.parameters {
            match value {
                _ if !good(name) => return Err(CycleError::Name { field: "parameters" }),
                ParameterValue::Number(x) if !x.is_finite() => {
                    return Err(CycleError::Number { field: name.clone(), value: *x, range: "finite" });
                }
                ParameterValue::Word(word) if !good(word) => return Err(CycleError::Name { field: "parameters" }),
                _ => {}
            }
        }
        Ok(())
    }

    /// The place of its failure mode in [`MODES`]; `None` for a success.
    pub fn mode(&self) -> Option<u8> {
        let word = self.failure_mode.as_deref();
        (!self.success).then(|| {
            let known = FailureMode::ALL.iter().position(|mode| Some(mode.word()) == word);
            known.unwrap_or(FailureMode::ALL.len()) as u8
        })
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
    fn a_cycle_needs_five_fields_and_takes_no_unknown_one() {
        let least = r#"{"id":"a","robot":"r","recipe":"x","time_s":1.5,"success":true}"#;
        assert_eq!(cycle(least).unwrap().mode(), None);
        assert!(cycle(r#"{"id":"a","robot":"r","recipe":"x","success":true}"#).unwrap_err().contains("time_s"));
        assert!(cycle(&least.replace("time_s\"", "times\"")).is_err());
    }

    #[test]
    fn a_malformed_cycle_is_told_what_is_wrong() {
        let with = |more: &str| {
            cycle(&format!(r#"{{"id":"a","robot":"r","recipe":"x","time_s":1,"success":true{more}}}"#)).unwrap_err()
        };
        assert!(with(r#","failure_mode":"timeout""#).contains("although `success` is true"));
        assert!(with(r#","cycle_time_s":-1"#).contains("`cycle_time_s` is -1"));
        let milliseconds = r#"{"id":"a","robot":"r","recipe":"x","time_s":1795254000000,"success":true}"#;
        assert!(cycle(milliseconds).unwrap_err().contains("seconds since 1970"));
        assert!(cycle(r#"{"id":"","robot":"r","recipe":"x","time_s":1,"success":true}"#).unwrap_err().contains("`id`"));
    }

    #[test]
    fn modes_are_the_papers_four_and_other() {
        assert!(FailureMode::ALL.iter().zip(MODES).all(|(mode, word)| mode.word() == word));
        let failed = |mode: &str| {
            let json = format!(r#"{{"id":"a","robot":"r","recipe":"x","time_s":1,"success":false{mode}}}"#);
            cycle(&json).unwrap().mode()
        };
        assert_eq!(failed(r#","failure_mode":"collision""#), Some(2));
        assert_eq!(failed(r#","failure_mode":"spilled""#), Some(4));
        assert_eq!(failed(""), Some(4));
    }
}
