//! The mapping from table columns to roles, flags and parameters.

use std::collections::BTreeMap;
use std::fmt;

use robogate_core::{FailureMode, Word};
use serde::Deserialize;
use serde::de::{Deserializer, Error, MapAccess, Visitor};

use super::role::Role;
use crate::DictionaryError;
use crate::published::FLAGS;

/// A mapping from table columns to roles, flags and parameters.
///
/// A role that the mapping does not name uses the column with the name of the role (`success`, `cycle_time_s`). Every
/// remaining column becomes a parameter. The TOML form:
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
    /// Columns that are not parameters.
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
}

impl Mapping {
    /// Reads a mapping from TOML. `origin` names it in errors.
    pub fn from_toml(text: &str, origin: &str) -> Result<Self, DictionaryError> {
        toml::from_str(text).map_err(|e| DictionaryError::Mapping { origin: origin.to_owned(), reason: e.to_string() })
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
                    "Unknown role `{key}`. Expected one of {roles}, flag.MODE or parameter.NAME"
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
            "ignore" => Self::Ignore,
            "failure_modes" => Self::FailureModes,
            "about" => Self::About,
            key => match (Role::of_key(key), flagged(key)) {
                (Some(role), _) => Self::Role(role),
                (None, Some(mode)) => Self::Flag(mode),
                (None, None) => {
                    let roles = Role::ALL.map(Role::as_str).join(", ");
                    return Err(D::Error::custom(format!(
                        "Unknown role `{key}`. Expected one of {roles}, ignore, [flags], [parameters], [failure_modes] or \
                         [about]"
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
