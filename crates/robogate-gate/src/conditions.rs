//! What a success depends on besides the policy: settings of the task, engine, robot, environment, latency.
//!
//! Two runs can have the same scenarios and seeds and still ask different questions. A comparison of two policies under different
//! settings, engines or robots is refused. Differences that can belong to a policy or to its upgrade are named.

use std::collections::BTreeMap;

use robogate_core::{SettingSpec, TaskSpec};
use robogate_dictionary::{Place, Provenance};

/// The conditions of a record.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Conditions {
    /// Name and value of what must agree.
    fixed: Vec<(String, String)>,
    /// Name and value of what may differ, and is then named.
    stated: Vec<(String, String)>,
}

impl Conditions {
    /// The conditions of a run. Those of imports are unknown.
    pub(crate) fn of(provenance: &Provenance) -> Self {
        let Some(world) = provenance.world.as_ref().filter(|_| provenance.source.is_none()) else {
            return Self::default();
        };
        let task = &provenance.task;
        let settings = task.settings.iter().map(|setting| (setting.name.to_string(), shown(setting)));
        let mut fixed: Vec<(String, String)> = settings.collect();
        if !task.settings.iter().any(|setting| &*setting.name == "time_limit_s") {
            fixed.push(("time limit".to_owned(), format!("{} s", task.time_limit_s)));
        }
        fixed.push(("engine".to_owned(), provenance.engine.name.clone()));
        fixed.push(("robot".to_owned(), provenance.robot.name.clone()));
        let or_none = |value: Option<String>| value.unwrap_or_else(|| "none".to_owned());
        let mut stated = vec![
            ("version of the engine".to_owned(), or_none(provenance.engine.version.clone())),
            ("robot's files".to_owned(), or_none(provenance.robot.sha256.clone())),
            ("latency".to_owned(), or_none(world.execution.as_ref().and_then(|of| serde_json::to_string(of).ok()))),
            (
                "warner".to_owned(),
                or_none(world.warner.as_ref().map(|of| format!("{:?} {}", of.on_warning, of.sha256))),
            ),
            ("stress".to_owned(), or_none(world.stress.as_ref().and_then(|of| serde_json::to_string(of).ok()))),
        ];
        if let Place::Python(python) = &world.place {
            stated.push(("environment's file".to_owned(), or_none(python.sha256.clone())));
            stated.extend(python.packages.iter().map(|(name, version)| (format!("package {name}"), version.clone())));
        }
        Self { fixed, stated }
    }

    /// What must agree and differs, in words. `None` if nothing does.
    pub(crate) fn contradiction(&self, other: &Self) -> Option<String> {
        in_words(differences(pairs(&self.fixed), &other.fixed))
    }

    /// What must agree, by its name.
    pub(crate) fn fixed(&self) -> BTreeMap<String, String> {
        self.fixed.iter().cloned().collect()
    }

    /// How these conditions differ from the fixed ones of a baseline. `None` where they agree in all that both know.
    pub(crate) fn other_than(&self, fixed: &BTreeMap<String, String>) -> Option<String> {
        in_words(differences(fixed.iter(), &self.fixed))
    }

    /// What may differ and does, in words.
    pub(crate) fn differences(&self, other: &Self) -> Vec<String> {
        let only = |one: &Self, other: &Self, words: &str| -> Vec<String> {
            let missing = one.stated.iter().filter(|(name, _)| !other.stated.iter().any(|(known, _)| known == name));
            missing.map(|(name, value)| format!("{name}: {value}, {words}")).collect()
        };
        let both = differences(pairs(&self.stated), &other.stated);
        let unknown = self.stated.is_empty() || other.stated.is_empty();
        let others = if unknown {
            Vec::new()
        } else {
            [only(self, other, "only before"), only(other, self, "only now")].concat()
        };
        both.into_iter().chain(others).collect()
    }
}

/// Names and values.
fn pairs(conditions: &[(String, String)]) -> impl Iterator<Item = (&String, &String)> {
    conditions.iter().map(|(name, value)| (name, value))
}

/// `None` without a difference.
fn in_words(differences: Vec<String>) -> Option<String> {
    (!differences.is_empty()).then(|| differences.join("; "))
}

/// What differs between the conditions of A and those of B.
fn differences<'a>(a: impl Iterator<Item = (&'a String, &'a String)>, b: &[(String, String)]) -> Vec<String> {
    let short = |value: &str| match value.len() {
        // The start of a hash tells two of them apart.
        64 if value.bytes().all(|byte| byte.is_ascii_hexdigit()) => format!("SHA-256 {}...", &value[..12]),
        _ => value.to_owned(),
    };
    let differing = a.filter_map(|(name, one)| {
        let (_, two) = b.iter().find(|(known, two)| known == name && two != one)?;
        Some(format!("{name}: {} and {}", short(one), short(two)))
    });
    differing.collect()
}

/// The value of a setting.
fn shown(setting: &SettingSpec) -> String {
    let value = setting.value.as_ref().or(setting.default.as_ref());
    value.map_or_else(|| "that of the robot".to_owned(), ToString::to_string)
}

/// The settings of a task that are not those that it has by default: they decide what counts as a success.
pub(crate) fn changed_settings(task: &TaskSpec) -> Vec<String> {
    let changed = task.settings.iter().filter(|setting| setting.is_changed());
    changed
        .map(|setting| {
            let default = setting.default.as_ref().map_or_else(String::new, ToString::to_string);
            format!("{} = {} (default {default})", setting.name, shown(setting))
        })
        .collect()
}
