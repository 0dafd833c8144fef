//! The outcome of a row's episode.

use std::path::Path;

use robogate_core::{FailureMode, Fault, FaultKind, Outcome};

use super::Mapping;
use super::flags::{self, Flag};
use super::role::{FAILURE_TYPE, Role};
use crate::DictionaryError;
use crate::raw::{RawRow, Scalar};

/// The outcome of a row's episode, and how the row reports it.
#[derive(Debug, PartialEq)]
pub(super) struct Ended {
    pub(super) outcome: Outcome,
    /// Time in seconds. `None` if the row has none.
    pub(super) time_s: Option<f64>,
    /// Whether the row names the failure mode of its failure. Otherwise it is [`FailureMode::UNKNOWN`].
    pub(super) kind_known: bool,
    /// The value of each flag, in the order of [`Results::flags`]. Empty for an invalid episode.
    pub(super) flags: Vec<Option<bool>>,
    /// Whether the row reports both success and a flag that excludes it.
    pub(super) contradicted: bool,
    /// Whether `success` is missing and no error is reported.
    pub(super) silent: bool,
}

/// The columns that determine the outcome.
#[derive(Debug)]
pub(super) struct Results<'a> {
    mapping: &'a Mapping,
    pub(super) flags: Vec<Flag>,
    /// The columns with the failure mode. The first non-empty one counts.
    failure_columns: Vec<&'a str>,
}

enum Success {
    Known(bool),
    Error,
    Missing,
}

impl<'a> Results<'a> {
    pub(super) fn new(mapping: &'a Mapping) -> Self {
        let flags = flags::of(mapping);
        let named = |column: &str| {
            mapping.roles.values().any(|named| named == column) || mapping.flags.values().any(|named| named == column)
        };
        let mut failure_columns = vec![mapping.column(Role::FailureMode)];
        if !mapping.roles.contains_key(&Role::FailureMode) && !named(FAILURE_TYPE) {
            failure_columns.push(FAILURE_TYPE);
        }
        Self { mapping, flags, failure_columns }
    }

    /// Whether this column determines the outcome. Such a column is never a parameter.
    pub(super) fn has(&self, column: &str) -> bool {
        column == FAILURE_TYPE
            || Role::ALL.into_iter().any(|role| role.is_result() && self.mapping.column(role) == column)
            || self.flags.iter().any(|flag| flag.column.as_deref() == Some(column))
    }

    /// Whether the row has a value in a failure-mode column.
    pub(super) fn names_mode(&self, row: &RawRow) -> bool {
        self.failure_columns.iter().any(|column| row.get(column).is_some_and(|value| *value != Scalar::Null))
    }

    /// The outcome of the row's episode.
    pub(super) fn of(&self, path: &Path, row: &RawRow) -> Result<Ended, DictionaryError> {
        let time_s = self.time(path, row)?;
        let invalid = |detail: String, silent| Ended {
            outcome: Outcome::Invalid(Fault::new(fault_kind(&detail), detail)),
            time_s,
            kind_known: true,
            flags: Vec::new(),
            contradicted: false,
            silent,
        };
        if let Some(error) = self.error(row) {
            return Ok(invalid(error, false));
        }
        let success = self.success(path, row)?;
        let column = self.mapping.column(Role::Success);
        if matches!(success, Success::Error) {
            return Ok(invalid(format!("`{column}` says error"), false));
        }
        let mode = self.failure_mode(path, row)?;
        let flags = self.flags.iter().map(|flag| self.flag(path, row, flag)).collect::<Result<Vec<_>, _>>()?;
        let raised = |tolerated: bool| {
            let mut raised = self.flags.iter().zip(&flags).filter(|(_, value)| **value == Some(true));
            raised.find(|(flag, _)| tolerated || !flag.tolerated).map(|(flag, _)| flag.mode)
        };
        let silent = matches!(success, Success::Missing);
        let ended = |outcome, kind_known, contradicted, flags| Ended {
            outcome,
            time_s,
            kind_known,
            flags,
            contradicted,
            silent,
        };
        match success {
            Success::Known(true) => {
                if let Some((mode, at)) = mode {
                    return Err(row.wrong(path, at, format!("({mode}) contradicts `{column}`, which is success")));
                }
                // A tolerated flag may be set in a success. Any other flag makes the episode a failure.
                return Ok(match raised(false) {
                    Some(mode) => ended(Outcome::Failure(mode), true, true, flags),
                    None => ended(Outcome::Success, true, false, flags),
                });
            }
            // A known failure must be counted. Dropping it would raise the success rate.
            Success::Missing if mode.is_none() && raised(false).is_none() => {
                return Ok(invalid(format!("`{column}` is missing"), true));
            }
            Success::Known(false) | Success::Missing | Success::Error => {}
        }
        if let Some((mode, at)) = mode {
            let lowered =
                self.flags.iter().zip(&flags).find(|(flag, value)| flag.mode == mode && **value == Some(false));
            if let Some(column) = lowered.and_then(|(flag, _)| flag.column.as_deref()) {
                return Err(row.wrong(path, column, format!("contradicts `{at}`, which is {mode}")));
            }
        }
        // All flags are false, which excludes every other mode: the task was not completed in time.
        let all_lowered = (self.flags.iter().zip(&flags))
            .all(|(flag, value)| *value == Some(false) || (value.is_none() && !flag.expected));
        let failure_mode = mode.map(|(mode, _)| mode).or(raised(true)).or(all_lowered.then_some(FailureMode::TIMEOUT));
        Ok(ended(Outcome::Failure(failure_mode.unwrap_or(FailureMode::UNKNOWN)), failure_mode.is_some(), false, flags))
    }

    fn success(&self, path: &Path, row: &RawRow) -> Result<Success, DictionaryError> {
        let column = self.mapping.column(Role::Success);
        Ok(match row.get(column) {
            None | Some(Scalar::Null) => Success::Missing,
            Some(Scalar::Text(word)) if ["error", "invalid"].contains(&word.to_ascii_lowercase().as_str()) => {
                Success::Error
            }
            Some(value) => Success::Known(truth(value).ok_or_else(|| not_a_truth(path, row, column))?),
        })
    }

    fn flag(&self, path: &Path, row: &RawRow, flag: &Flag) -> Result<Option<bool>, DictionaryError> {
        let Some((column, value)) = flag.column.as_deref().and_then(|column| Some((column, row.get(column)?))) else {
            return Ok(None);
        };
        if *value == Scalar::Null {
            return Ok(None);
        }
        truth(value).map(Some).ok_or_else(|| {
            let hint = if self.mapping.flags.contains_key(&flag.mode) {
                String::new()
            } else {
                "\nHint: if it is a parameter, list it under [parameters] in a mapping".to_owned()
            };
            row.wrong(path, column, format!("is neither true nor false, as the flag of {} must be{hint}", flag.mode))
        })
    }

    /// The failure mode named by the row, with its column.
    fn failure_mode(&self, path: &Path, row: &RawRow) -> Result<Option<(FailureMode, &'a str)>, DictionaryError> {
        for column in self.failure_columns.iter().copied() {
            let word = match row.get(column) {
                None | Some(Scalar::Null) => continue,
                Some(Scalar::Text(word)) => word,
                Some(_) => return Err(row.wrong(path, column, "is not a word. Expected the name of a failure mode")),
            };
            if let Some(mode) = self.mapping.failure_modes.get(word) {
                return Ok(Some((*mode, column)));
            }
            let word = word.trim();
            let no_failure = word.is_empty() || ["none", "success"].iter().any(|none| none.eq_ignore_ascii_case(word));
            if !no_failure {
                return Ok(Some((FailureMode::from_foreign(word), column)));
            }
        }
        Ok(None)
    }

    /// The infrastructure error, if the row reports one.
    fn error(&self, row: &RawRow) -> Option<String> {
        let column = self.mapping.column(Role::Error);
        let text = match row.get(column)? {
            Scalar::Null | Scalar::Bool(false) | Scalar::Integer(0) => return None,
            Scalar::Text(text) if text.trim().is_empty() || truth(&Scalar::Text(text.clone())) == Some(false) => {
                return None;
            }
            Scalar::Text(text) if text.eq_ignore_ascii_case("none") => return None,
            Scalar::Text(text) => text.clone(),
            other => format!("`{column}` is {}", other.show()),
        };
        // Tracebacks can be long. The dictionary keeps the part that distinguishes errors.
        const MOST: usize = 2000;
        Some(match text.char_indices().nth(MOST) {
            Some((end, _)) => format!("{}...", &text[..end]),
            None => text,
        })
    }

    fn time(&self, path: &Path, row: &RawRow) -> Result<Option<f64>, DictionaryError> {
        let column = self.mapping.column(Role::CycleTime);
        let time = match row.get(column) {
            None | Some(Scalar::Null) => return Ok(None),
            Some(Scalar::Integer(n)) => *n as f64,
            Some(Scalar::Number(x)) => *x,
            Some(_) => return Err(row.wrong(path, column, "is not a time in seconds")),
        };
        if time < 0.0 { Err(row.wrong(path, column, "is negative. Expected seconds")) } else { Ok(Some(time)) }
    }
}

/// The error about a success that is neither true nor false.
pub(super) fn not_a_truth(path: &Path, row: &RawRow, column: &str) -> DictionaryError {
    let hint = match row.get(column) {
        Some(Scalar::Integer(_) | Scalar::Unsigned(_) | Scalar::Number(_)) => {
            "\nHint: a percentage, a score or partial credit does not say success; add a column with true or false, and \
             name it with --map success=COLUMN"
        }
        _ => "",
    };
    let expected = "is neither true nor false. Expected true or false, 1 or 0, yes or no, success or fail, or error";
    row.wrong(path, column, format!("{expected}{hint}"))
}

/// Interprets a value as a truth value, if possible.
pub(super) fn truth(value: &Scalar) -> Option<bool> {
    match value {
        Scalar::Bool(truth) => Some(*truth),
        Scalar::Integer(0) => Some(false),
        Scalar::Integer(1) => Some(true),
        Scalar::Number(x) if x.to_bits() == 0_f64.to_bits() => Some(false),
        Scalar::Number(x) if x.to_bits() == 1_f64.to_bits() => Some(true),
        Scalar::Text(word) => match word.to_ascii_lowercase().as_str() {
            "true" | "yes" | "y" | "success" | "succeeded" | "pass" | "passed" => Some(true),
            "false" | "no" | "n" | "fail" | "failed" | "failure" => Some(false),
            _ => None,
        },
        Scalar::Null | Scalar::Integer(_) | Scalar::Unsigned(_) | Scalar::Number(_) | Scalar::Nested => None,
    }
}

/// The class of fault for the words of common tools. The default is an unavailable policy or simulator.
fn fault_kind(detail: &str) -> FaultKind {
    let word = detail.split(|c: char| !(c.is_ascii_alphanumeric() || c == '_')).find(|word| !word.is_empty());
    match word {
        Some("env_start" | "setup") => FaultKind::Setup,
        Some("diverged") => FaultKind::Diverged,
        Some("bad_action") => FaultKind::BadAction,
        _ => FaultKind::Unavailable,
    }
}
