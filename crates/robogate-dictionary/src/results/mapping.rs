//! Which column of a table is what.

use std::collections::BTreeMap;

use serde::Deserialize;

use crate::DictionaryError;

/// Which column of a table is what. What is not said is looked for under the name of the role itself
/// (`success`, `collision`, ...); each column that is then left over is a parameter.
///
/// As TOML:
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
///     [failure_modes]
///     dropped = "grip_loss"
///     [about]
///     policy = "pi0-2026-11"
///     "#,
///     "mapping.toml",
/// )?;
/// # Ok::<(), robogate_dictionary::DictionaryError>(())
/// ```
#[derive(Debug, Clone, Default, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Mapping {
    /// true/false, 1/0, or the words success, fail, failure, failed, error, invalid.
    pub success: Option<String>,
    /// How it failed: grasp_miss, grip_loss, collision, timeout, or a word of `failure_modes`.
    pub failure_mode: Option<String>,
    /// Time until the task was done or given up, in seconds.
    pub cycle_time_s: Option<String>,
    /// Whether the robot touched what it should not have.
    pub collision: Option<String>,
    /// Whether the object was dropped.
    pub drop: Option<String>,
    /// Whether the gripper closed without the object.
    pub grasp_miss: Option<String>,
    /// What broke under the policy: anything but empty, false or 0 makes the episode invalid.
    pub error: Option<String>,
    /// The environment's seed; kept as the parameter `source_seed`.
    pub seed: Option<String>,
    /// The case of the suite.
    pub case: Option<String>,
    /// The category of the case.
    pub category: Option<String>,
    /// The group of the case.
    pub group: Option<String>,
    /// Parameters: their names here and the columns they are in. Absent: every column left over.
    pub parameters: Option<BTreeMap<String, String>>,
    /// Columns that are no parameters.
    #[serde(default)]
    pub ignore: Vec<String>,
    /// Words of the failure mode's column, and which of our four modes each is.
    #[serde(default)]
    pub failure_modes: BTreeMap<String, String>,
    /// What the file does not say about where it comes from.
    #[serde(default)]
    pub about: About,
}

/// Who was judged, in what.
#[derive(Debug, Clone, Default, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct About {
    /// The policy.
    pub policy: Option<String>,
    /// The robot.
    pub robot: Option<String>,
    /// The simulator, or `real`.
    pub simulator: Option<String>,
}

/// What a column can be.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Role {
    Success,
    FailureMode,
    CycleTime,
    Collision,
    Drop,
    GraspMiss,
    Error,
    Seed,
    Case,
    Category,
    Group,
}

impl Role {
    pub(super) const ALL: [Self; 11] = [
        Self::Success,
        Self::FailureMode,
        Self::CycleTime,
        Self::Collision,
        Self::Drop,
        Self::GraspMiss,
        Self::Error,
        Self::Seed,
        Self::Case,
        Self::Category,
        Self::Group,
    ];

    /// Its key in a mapping, and the column it is looked for in where none is named.
    pub(super) fn word(self) -> &'static str {
        match self {
            Self::Success => "success",
            Self::FailureMode => "failure_mode",
            Self::CycleTime => "cycle_time_s",
            Self::Collision => "collision",
            Self::Drop => "drop",
            Self::GraspMiss => "grasp_miss",
            Self::Error => "error",
            Self::Seed => "seed",
            Self::Case => "case",
            Self::Category => "category",
            Self::Group => "group",
        }
    }
}

impl Mapping {
    /// Reads a mapping from TOML; `origin` names it in errors.
    pub fn from_toml(text: &str, origin: &str) -> Result<Self, DictionaryError> {
        let mapping: Self = toml::from_str(text)
            .map_err(|e| DictionaryError::Mapping { origin: origin.to_owned(), reason: e.to_string() })?;
        for ours in mapping.failure_modes.values() {
            super::outcome::mode(ours).ok_or_else(|| DictionaryError::Mapping {
                origin: origin.to_owned(),
                reason: format!(
                    "`{ours}` in [failure_modes] is no mode\nhint: the modes are grasp_miss, grip_loss, collision, timeout"
                ),
            })?;
        }
        Ok(mapping)
    }

    /// Adds pairs as on a command line: `success=ok,parameter.mass_kg=mass`.
    pub fn add(&mut self, pairs: &str, origin: &str) -> Result<(), DictionaryError> {
        let wrong = |reason: String| DictionaryError::Mapping { origin: origin.to_owned(), reason };
        for pair in pairs.split(',').map(str::trim) {
            let Some((key, column)) = pair.split_once('=').filter(|(_, column)| !column.is_empty()) else {
                return Err(wrong(format!("`{pair}` is not KEY=COLUMN\nhint: as in success=ok,cycle_time_s=duration")));
            };
            if let Some(parameter) = key.strip_prefix("parameter.") {
                self.parameters.get_or_insert_default().insert(parameter.to_owned(), column.to_owned());
                continue;
            }
            let Some(role) = Role::ALL.into_iter().find(|role| role.word() == key) else {
                let known: Vec<&str> = Role::ALL.into_iter().map(Role::word).collect();
                return Err(wrong(format!(
                    "`{key}` is nothing that a column can be\nhint: it is one of {}, or parameter.NAME",
                    known.join(", ")
                )));
            };
            *self.place(role) = Some(column.to_owned());
        }
        Ok(())
    }

    /// Whether nothing is said.
    pub fn is_empty(&self) -> bool {
        *self == Self::default()
    }

    /// The column that the user named for this role.
    pub(super) fn named(&self, role: Role) -> Option<&str> {
        let column = match role {
            Role::Success => &self.success,
            Role::FailureMode => &self.failure_mode,
            Role::CycleTime => &self.cycle_time_s,
            Role::Collision => &self.collision,
            Role::Drop => &self.drop,
            Role::GraspMiss => &self.grasp_miss,
            Role::Error => &self.error,
            Role::Seed => &self.seed,
            Role::Case => &self.case,
            Role::Category => &self.category,
            Role::Group => &self.group,
        };
        column.as_deref()
    }

    /// The column of this role.
    pub(super) fn column(&self, role: Role) -> &str {
        self.named(role).unwrap_or(role.word())
    }

    fn place(&mut self, role: Role) -> &mut Option<String> {
        match role {
            Role::Success => &mut self.success,
            Role::FailureMode => &mut self.failure_mode,
            Role::CycleTime => &mut self.cycle_time_s,
            Role::Collision => &mut self.collision,
            Role::Drop => &mut self.drop,
            Role::GraspMiss => &mut self.grasp_miss,
            Role::Error => &mut self.error,
            Role::Seed => &mut self.seed,
            Role::Case => &mut self.case,
            Role::Category => &mut self.category,
            Role::Group => &mut self.group,
        }
    }

    /// This mapping, and for what it does not say that of the format.
    pub(super) fn over(&self, of_format: &Self) -> Self {
        let mut mapping = self.clone();
        for role in Role::ALL {
            if mapping.named(role).is_none() {
                *mapping.place(role) = of_format.named(role).map(ToOwned::to_owned);
            }
        }
        if mapping.parameters.is_none() {
            mapping.parameters.clone_from(&of_format.parameters);
        }
        mapping.ignore.extend(of_format.ignore.iter().cloned());
        mapping
    }
}
