//! The rows of an audited file, with the few quantities that the checks need.

use std::collections::BTreeSet;
use std::collections::hash_map::DefaultHasher;
use std::hash::{Hash, Hasher};
use std::path::Path;

use super::super::exported;
use super::super::names::{self, Suggested};
use super::super::outcome::{not_a_truth, truth};
use super::super::role::Role;
use super::super::survey::SEED_PARTS;
use super::super::{Mapping, SOURCE_SEED};
use crate::DictionaryError;
use crate::raw::{RawRow, Scalar};

/// Larger files are rejected, because the audit keeps every row in memory.
const MOST_ROWS: usize = 5_000_000;

/// Words of texts that report an infrastructure error.
const ERRORS: [&str; 22] = [
    "connection",
    "refused",
    "unreachable",
    "disconnected",
    "exception",
    "traceback",
    "crash",
    "crashed",
    "cuda",
    "oom",
    "out of memory",
    "killed",
    "segfault",
    "segmentation",
    "broken pipe",
    "websocket",
    "socket",
    "server",
    "env_start",
    "env_step",
    "model_act",
    "nan in",
];

/// Words of column names that hold the reason of an ending.
const REASONS: [&str; 11] = [
    "error",
    "exception",
    "traceback",
    "reason",
    "detail",
    "status",
    "message",
    "failure",
    "termination",
    "outcome",
    "note",
];

/// One row.
#[derive(Debug, Default)]
pub(super) struct AuditRow {
    pub(super) success: Option<bool>,
    /// The text that reports an infrastructure error.
    pub(super) error: Option<String>,
    /// Whether a column states why the episode ended.
    pub(super) has_reason: bool,
    /// Number of steps.
    pub(super) length: Option<f64>,
    /// Whether the time limit ended the episode, and not the task.
    pub(super) truncated: Option<bool>,
    /// Whether the task ended the episode.
    pub(super) terminated: Option<bool>,
    pub(super) seed: Option<String>,
    /// Task and case.
    pub(super) case: String,
    /// Category, group and policy. The arms of a paired comparison share task and seed on purpose.
    pub(super) arm: String,
    /// The number of the episode, within its case or in the file.
    pub(super) episode: Option<i64>,
    /// The parallel environment.
    pub(super) environment: Option<i64>,
    /// A named initial state.
    pub(super) state: Option<String>,
    /// Hash of all parameters.
    pub(super) parameters: Option<u64>,
    /// Hash of the parameters that are numbers.
    numbers: Option<u64>,
    /// Hash of all fields.
    pub(super) whole: u64,
}

/// The rows, and the columns that they came from.
#[derive(Debug)]
pub(super) struct Table<'a> {
    mapping: &'a Mapping,
    /// Whether the file is a dictionary or an export of RoboGate.
    pub(super) own: bool,
    /// Whether a value of the success column reports an outcome.
    pub(super) has_outcomes: bool,
    /// The first value of success that is neither true nor false.
    pub(super) unreadable: Option<DictionaryError>,
    pub(super) rows: Vec<AuditRow>,
    pub(super) length: BTreeSet<String>,
    pub(super) reasons: BTreeSet<String>,
    pub(super) truncated: BTreeSet<String>,
    pub(super) seed: BTreeSet<String>,
    pub(super) episode: BTreeSet<String>,
    pub(super) environment: BTreeSet<String>,
    pub(super) state: BTreeSet<String>,
    pub(super) parameters: BTreeSet<String>,
    /// Whether a parameter has a value that is not an integer. Only then can two equal rows not be a planned repeat.
    pub(super) continuous: bool,
}

impl AuditRow {
    /// Task, case and arm: where the number of an episode is expected once.
    pub(super) fn place(&self) -> String {
        format!("{}{}", self.case, self.arm)
    }

    /// Place and numbers of the scenario: where a seed is expected once. A design may run the same seeds in each of its scenarios.
    /// A word may name the arm of a comparison, which does not make another scenario.
    pub(super) fn scenario(&self) -> (String, Option<u64>) {
        (self.place(), self.numbers)
    }

    fn add_arm(&mut self, value: &Scalar) {
        self.arm.push_str(&value.show());
        self.arm.push('/');
    }
}

fn hashed(values: &[(&str, &Scalar)]) -> u64 {
    let mut hasher = DefaultHasher::new();
    for (name, value) in values {
        name.hash(&mut hasher);
        value.show().hash(&mut hasher);
    }
    hasher.finish()
}

/// Whether a value of success is neither true, false nor an error.
fn is_unreadable(mapping: &Mapping, name: &str, value: &Scalar) -> bool {
    mapping.column(Role::Success) == name && !reports_error(value) && truth(value).is_none()
}

fn reports_error(value: &Scalar) -> bool {
    matches!(value, Scalar::Text(word) if ["error", "invalid"].contains(&word.to_ascii_lowercase().as_str()))
}

impl<'a> Table<'a> {
    /// A table without rows, for a file with these columns.
    pub(super) fn new(mapping: &'a Mapping, columns: &[String]) -> Self {
        let none = BTreeSet::new;
        Self {
            mapping,
            own: exported::has_marks(columns),
            has_outcomes: false,
            unreadable: None,
            rows: Vec::new(),
            length: none(),
            reasons: none(),
            truncated: none(),
            seed: none(),
            episode: none(),
            environment: none(),
            state: none(),
            parameters: none(),
            continuous: false,
        }
    }

    pub(super) fn push(&mut self, path: &Path, raw: &RawRow) -> Result<(), DictionaryError> {
        if self.rows.len() == MOST_ROWS {
            let reason = format!("it has more than {MOST_ROWS} rows\nHint: audit it in parts");
            return Err(DictionaryError::results(path, reason));
        }
        let mut row = AuditRow::default();
        let mut parameters: Vec<(&str, &Scalar)> = Vec::new();
        let mut whole: Vec<(&str, &Scalar)> = Vec::new();
        for (name, value) in &raw.fields {
            if *value == Scalar::Null {
                continue;
            }
            whole.push((name, value));
            if self.own {
                self.take_own(name, value, &mut row);
            } else {
                if self.unreadable.is_none() && is_unreadable(self.mapping, name, value) {
                    self.unreadable = Some(not_a_truth(path, raw, name));
                }
                self.take(name, value, &mut row, &mut parameters);
            }
        }
        row.parameters = (!parameters.is_empty()).then(|| hashed(&parameters));
        parameters.retain(|(_, value)| matches!(value, Scalar::Integer(_) | Scalar::Number(_)));
        row.numbers = (!parameters.is_empty()).then(|| hashed(&parameters));
        row.whole = hashed(&whole);
        self.rows.push(row);
        Ok(())
    }

    /// Takes a field of a dictionary or an export of RoboGate.
    fn take_own(&mut self, name: &str, value: &Scalar, row: &mut AuditRow) {
        let columns = match (name, value) {
            ("outcome", Scalar::Text(outcome)) => {
                row.has_reason = true;
                row.success = (outcome != "invalid").then_some(outcome == "success");
                self.has_outcomes = true;
                &mut self.reasons
            }
            ("index", Scalar::Integer(index)) => {
                row.episode = Some(*index);
                &mut self.episode
            }
            // Imported episodes have no ticks. Their number is then 0.
            ("ticks", Scalar::Integer(ticks)) if *ticks > 0 => {
                row.length = Some(*ticks as f64);
                &mut self.length
            }
            // The column `seed` has the seed of the campaign.
            (SOURCE_SEED, value) => {
                row.seed = Some(value.show());
                &mut self.seed
            }
            (part, value) if SEED_PARTS.contains(&part) => {
                let seed = row.seed.get_or_insert_default();
                seed.push_str(&value.show());
                seed.push(' ');
                &mut self.seed
            }
            ("case", value) => {
                row.case = value.show();
                return;
            }
            ("category" | "group", value) => {
                row.add_arm(value);
                return;
            }
            _ => return,
        };
        if !columns.contains(name) {
            columns.insert(name.to_owned());
        }
    }

    fn take<'r>(
        &mut self,
        name: &'r str,
        value: &'r Scalar,
        row: &mut AuditRow,
        parameters: &mut Vec<(&'r str, &'r Scalar)>,
    ) {
        let plain = names::plain(name);
        let words: Vec<&str> = plain.split('_').collect();
        let has = |known: &[&str]| words.iter().any(|word| known.contains(word));
        let role = Role::ALL.into_iter().find(|role| self.mapping.column(*role) == name);
        let add = |columns: &mut BTreeSet<String>| {
            if !columns.contains(name) {
                columns.insert(name.to_owned());
            }
        };
        let integer = match value {
            Scalar::Integer(n) => Some(*n),
            Scalar::Text(text) => text.parse().ok(),
            _ => None,
        };
        let number = match value {
            Scalar::Integer(n) => Some(*n as f64),
            Scalar::Number(x) => Some(*x),
            _ => None,
        };
        match role {
            Some(Role::Success) => {
                let invalid = reports_error(value);
                row.success = if invalid { None } else { truth(value) };
                self.has_outcomes |= invalid || row.success.is_some();
                return;
            }
            Some(Role::Error) => {
                add(&mut self.reasons);
                row.has_reason = true;
                let quiet = matches!(value, Scalar::Bool(false) | Scalar::Integer(0))
                    || matches!(value, Scalar::Text(text) if text.trim().is_empty() || text.eq_ignore_ascii_case("none"));
                if !quiet {
                    row.error = Some(value.show());
                }
                return;
            }
            Some(Role::Seed) => {
                add(&mut self.seed);
                row.seed = Some(value.show());
                return;
            }
            Some(Role::Category | Role::Group | Role::Policy) => {
                row.add_arm(value);
                return;
            }
            _ => {}
        }
        if ["task", "tasks", "case", "suite", "instruction", "scenario"].iter().any(|word| words.contains(word))
            && !has(&["success", "reward"])
        {
            row.case.push_str(&value.show());
            row.case.push('/');
        } else if ["episode_in_env", "local_episode"].contains(&plain.as_str()) {
            // Numbered within an environment, which `environment` counts.
        } else if has(&["episode", "ep"]) && has(&["id", "ix", "idx", "index", "number", "global"])
            || ["episode", "source_episode"].contains(&plain.as_str())
        {
            if row.episode.is_none() && integer.is_some() {
                add(&mut self.episode);
                row.episode = integer;
            }
        } else if has(&["env"]) && has(&["id", "idx", "index", "ix"]) {
            add(&mut self.environment);
            row.environment = integer;
        } else if ["truncated", "timeout", "timed_out", "time_limit_reached"].contains(&plain.as_str()) {
            if let Some(truncated) = truth(value) {
                add(&mut self.truncated);
                row.truncated = Some(truncated);
            }
        } else if ["terminated", "terminal"].contains(&plain.as_str()) {
            row.terminated = truth(value);
        } else if has(&["state", "layout", "scene"]) && has(&["init", "initial", "reset", "start", "id"]) {
            add(&mut self.state);
            row.state = Some(value.show());
        } else if has(&REASONS)
            && let Scalar::Text(text) = value
        {
            add(&mut self.reasons);
            row.has_reason = true;
            let lower = text.to_ascii_lowercase();
            if row.error.is_none() && ERRORS.iter().any(|error| lower.contains(error)) {
                row.error = Some(text.chars().take(80).collect());
            }
        } else {
            self.measure_or_parameter(name, value, number, row, parameters);
        }
    }

    fn measure_or_parameter<'r>(
        &mut self,
        name: &'r str,
        value: &'r Scalar,
        number: Option<f64>,
        row: &mut AuditRow,
        parameters: &mut Vec<(&'r str, &'r Scalar)>,
    ) {
        let plain = names::plain(name);
        match names::suggested(name) {
            Suggested::Measure if names::counts_steps(&plain) => {
                self.length.insert(name.to_owned());
                row.length = number.or(row.length);
            }
            Suggested::Parameter if !self.mapping.ignores(name) => {
                self.continuous |= matches!(value, Scalar::Number(x) if x.fract().abs() > 0.0);
                self.parameters.insert(name.to_owned());
                parameters.push((name, value));
            }
            Suggested::Measure | Suggested::Identifier | Suggested::Parameter => {}
        }
    }
}
