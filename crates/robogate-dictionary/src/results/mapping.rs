//! The mapping from table columns to roles, flags and parameters.

use std::collections::BTreeMap;
use std::fmt;

use robogate_core::budget::Budget;
use robogate_core::{FailureMode, Word};
use serde::Deserialize;
use serde::de::{Deserializer, Error, MapAccess, Visitor};

use super::names;
use super::role::Role;
use crate::published::FLAGS;
use crate::{DictionaryError, RowSampling, Stopping};

/// A mapping from table columns to roles, flags and parameters.
///
/// A role that the mapping does not name uses the column with the name of the role (`success`, `cycle_time_s`), also in
/// another spelling (`Success`, `is_success`). Remaining columns are measures if their name says so (`reward`,
/// `episode_length`), unused if it names an identifier (`video_path`), and otherwise parameters. The TOML form:
///
/// ```
/// let mapping = robogate_dictionary::results::Mapping::from_toml(
///     r#"
///     success = "ok"
///     cycle_time_s = "duration"
///     error = "exception"
///     ignore = ["video"]
///     [parameters]
///     mass_kg = "mass"
///     [flags]
///     jammed = "jam_detected"
///     [failure_modes]
///     "stuck in the chute" = "jammed"
///     [about]
///     task = "sorting"
///     policy = "pi0-2026-11"
///     "#,
///     "mapping.toml",
/// )?;
/// assert_eq!(mapping.flags.len(), 1);
/// # Ok::<(), robogate_dictionary::DictionaryError>(())
/// ```
///
/// The flag names of the published JSON are also accepted as keys, for mappings of version 0.1.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Mapping {
    /// The columns of roles, unless a column has the role's name.
    pub roles: BTreeMap<Role, String>,
    /// Failure modes with a true/false column: the mode and its column.
    pub flags: BTreeMap<FailureMode, String>,
    /// Parameters: their names and columns. If absent, every remaining column is a parameter.
    pub parameters: Option<BTreeMap<String, String>>,
    /// Measures: their names and columns. Columns whose names say reward, return, length or time are measures by
    /// themselves.
    pub measures: BTreeMap<String, String>,
    /// Columns that are not used.
    pub ignore: Vec<String>,
    /// Failure modes for values of the failure-mode column. Any other value is a failure mode by itself.
    pub failure_modes: BTreeMap<String, FailureMode>,
    /// The origin of the file, if the file does not state it.
    pub about: About,
}

/// The task, policy, robot and environment of the results.
#[derive(Debug, Clone, Default, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct About {
    /// The task's name.
    pub task: Option<Word>,
    /// The policy.
    pub policy: Option<String>,
    /// The robot.
    pub robot: Option<String>,
    /// The simulator, or `real`.
    pub simulator: Option<String>,
    /// How the scenarios were chosen.
    pub sampling: Option<RowSampling>,
    /// How the number of episodes was chosen.
    pub stopping: Option<Stopping>,
}

impl Mapping {
    /// Reads a mapping from TOML. `origin` names it in errors.
    pub fn from_toml(text: &str, origin: &str) -> Result<Self, DictionaryError> {
        Budget::FILE
            .toml(text)
            .map_err(|e| DictionaryError::Mapping { origin: origin.to_owned(), reason: e.to_string() })
    }

    /// Adds pairs in the command-line form: `success=ok,flag.jammed=jam,parameter.mass_kg=mass`.
    pub fn add(&mut self, pairs: &str, origin: &str) -> Result<(), DictionaryError> {
        let wrong = |reason: String| DictionaryError::Mapping { origin: origin.to_owned(), reason };
        for pair in pairs.split(',').map(str::trim) {
            let Some((key, column)) = pair.split_once('=').filter(|(_, column)| !column.is_empty()) else {
                return Err(wrong(format!("`{pair}` is not a pair. Expected KEY=COLUMN, as in success=ok")));
            };
            if let Some(parameter) = key.strip_prefix("parameter.") {
                self.parameters.get_or_insert_default().insert(parameter.to_owned(), column.to_owned());
            } else if let Some(measure) = key.strip_prefix("measure.") {
                self.measures.insert(measure.to_owned(), column.to_owned());
            } else if key == "ignore" {
                self.ignore.push(column.to_owned());
            } else if let Some(mode) = key.strip_prefix("flag.") {
                let mode = FailureMode::new(mode).map_err(|why| wrong(format!("`{key}`: {why}")))?;
                self.flags.insert(mode, column.to_owned());
            } else if let Some(mode) = flagged(key) {
                self.flags.insert(mode, column.to_owned());
            } else if let Some(role) = Role::of_key(key) {
                self.roles.insert(role, column.to_owned());
            } else {
                let roles = Role::ALL.map(Role::as_str).join(", ");
                return Err(wrong(format!(
                    "Unknown role `{key}`. Expected one of {roles}, ignore, flag.MODE, measure.NAME or \
                     parameter.NAME"
                )));
            }
        }
        Ok(())
    }

    /// Whether the mapping is empty.
    pub fn is_empty(&self) -> bool {
        *self == Self::default()
    }

    /// Whether the mapping names no column.
    pub(super) fn names_no_column(&self) -> bool {
        Self { about: About::default(), ..self.clone() }.is_empty()
    }

    /// The column of this role.
    pub(super) fn column(&self, role: Role) -> &str {
        self.roles.get(&role).map_or(role.as_str(), String::as_str)
    }

    /// Whether the mapping uses this column as a parameter.
    pub(super) fn names_parameter(&self, column: &str) -> bool {
        self.parameters.iter().flat_map(BTreeMap::values).any(|named| named == column)
    }

    /// Whether the mapping uses this column as a measure.
    pub(super) fn names_measure(&self, column: &str) -> bool {
        self.measures.values().any(|named| named == column)
    }

    /// Whether the mapping leaves this column out.
    pub(super) fn ignores(&self, column: &str) -> bool {
        self.ignore.iter().any(|ignored| ignored == column)
    }

    /// Whether the mapping names this column for anything.
    pub(super) fn names(&self, column: &str) -> bool {
        let mut named =
            self.roles.values().chain(self.flags.values()).chain(self.measures.values()).chain(&self.ignore);
        self.names_parameter(column) || named.any(|named| named == column)
    }

    /// This mapping, with the columns of roles that it does not name found among the names of the file.
    pub(super) fn found_in(mut self, columns: &[String]) -> Self {
        let free: Vec<String> = columns.iter().filter(|name| !self.names(name)).cloned().collect();
        for role in Role::ALL {
            if !self.roles.contains_key(&role)
                && let Some(column) = names::column_of(role, &free)
                && column != role.as_str()
            {
                self.roles.insert(role, column.to_owned());
            }
        }
        // Cycle records of the monitor name their parameters like those of the cell.
        let has = |field: &&str| columns.iter().any(|column| column == field);
        if self.parameters.is_none() && ["id", "robot", "recipe", "time_s", "success"].iter().all(has) {
            let parameters =
                columns.iter().filter_map(|c| Some((c.strip_prefix("parameters.")?.to_owned(), c.clone())));
            self.parameters = Some(parameters.collect());
        }
        self
    }

    /// This mapping, completed with that of the format.
    pub(super) fn over(&self, of_format: &Self) -> Self {
        let mut mapping = self.clone();
        for (role, column) in &of_format.roles {
            mapping.roles.entry(*role).or_insert_with(|| column.clone());
        }
        if mapping.parameters.is_none() {
            mapping.parameters.clone_from(&of_format.parameters);
        }
        mapping.ignore.extend(of_format.ignore.iter().cloned());
        mapping
    }
}

/// The failure mode of a flag of the published files, by the flag's name.
fn flagged(key: &str) -> Option<FailureMode> {
    FLAGS.iter().find(|flag| flag.column == key).map(|flag| flag.mode)
}

/// A key of a mapping file.
enum Key {
    Role(Role),
    Flag(FailureMode),
    Flags,
    Parameters,
    Measures,
    Ignore,
    FailureModes,
    About,
}

impl<'de> Deserialize<'de> for Key {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let key = String::deserialize(deserializer)?;
        Ok(match key.as_str() {
            "flags" => Self::Flags,
            "parameters" => Self::Parameters,
            "measures" => Self::Measures,
            "ignore" => Self::Ignore,
            "failure_modes" => Self::FailureModes,
            "about" => Self::About,
            key => match (Role::of_key(key), flagged(key)) {
                (Some(role), _) => Self::Role(role),
                (None, Some(mode)) => Self::Flag(mode),
                (None, None) => {
                    let roles = Role::ALL.map(Role::as_str).join(", ");
                    return Err(D::Error::custom(format!(
                        "Unknown role `{key}`. Expected one of {roles}, ignore, [flags], [parameters], [measures], [failure_modes] \
                         or [about]"
                    )));
                }
            },
        })
    }
}

impl<'de> Deserialize<'de> for Mapping {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_map(MappingVisitor)
    }
}

struct MappingVisitor;

impl<'de> Visitor<'de> for MappingVisitor {
    type Value = Mapping;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a mapping of columns")
    }

    fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<Mapping, A::Error> {
        let mut mapping = Mapping::default();
        let mut flags: Vec<(FailureMode, String)> = Vec::new();
        while let Some(key) = map.next_key()? {
            match key {
                Key::Role(role) => drop(mapping.roles.insert(role, map.next_value()?)),
                Key::Flag(mode) => flags.push((mode, map.next_value()?)),
                Key::Flags => flags.extend(map.next_value::<BTreeMap<_, _>>()?),
                Key::Parameters => mapping.parameters = Some(map.next_value()?),
                Key::Measures => mapping.measures = map.next_value()?,
                Key::Ignore => mapping.ignore = map.next_value()?,
                Key::FailureModes => mapping.failure_modes = map.next_value()?,
                Key::About => mapping.about = map.next_value()?,
            }
        }
        for (mode, column) in flags {
            if let Some(other) = mapping.flags.insert(mode, column.clone()) {
                return Err(A::Error::custom(format!(
                    "the failure mode `{mode}` has two columns, `{other}` and `{column}`. Expected one column per failure mode"
                )));
            }
        }
        Ok(mapping)
    }
}
