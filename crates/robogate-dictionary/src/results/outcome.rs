//! How a foreign row's episode went.

use std::path::Path;

use robogate_core::{FailureMode, Fault, FaultKind, Outcome};

use super::mapping::{Mapping, Role};
use crate::DictionaryError;
use crate::raw::{RawRow, Scalar};

/// What a row says, and how surely.
#[derive(Debug, PartialEq)]
pub(super) struct Went {
    pub(super) outcome: Outcome,
    /// Seconds; `None` where the row has none.
    pub(super) time_s: Option<f64>,
    /// Whether a failure's kind is said; else `timeout` stands in its place.
    pub(super) kind_known: bool,
    /// Which flags the row lacks, in the order of [`FLAGS`].
    pub(super) lacks: [bool; FLAGS.len()],
    /// Whether the row said success beside a collision or a drop.
    pub(super) contradicted: bool,
    /// Whether `success` was missing without an error being named.
    pub(super) silent: bool,
}

/// The columns that say of one mode alone whether it was so.
pub(super) const FLAGS: [(FailureMode, Role); 3] = [
    (FailureMode::constant("collision"), Role::Collision),
    (FailureMode::constant("grip_loss"), Role::Drop),
    (FailureMode::constant("grasp_miss"), Role::GraspMiss),
];

/// A failure mode by its word.
pub(super) fn mode(word: &str) -> Option<FailureMode> {
    FailureMode::new(word).ok()
}

/// How the row's episode went.
pub(super) fn of(path: &Path, row: &RawRow, mapping: &Mapping) -> Result<Went, DictionaryError> {
    let time_s = time(path, row, mapping)?;
    let invalid = |detail: String, silent| Went {
        outcome: Outcome::Invalid(Fault::new(fault_kind(&detail), detail)),
        time_s,
        kind_known: true,
        lacks: [false; FLAGS.len()],
        contradicted: false,
        silent,
    };
    if let Some(error) = error(row, mapping) {
        return Ok(invalid(error, false));
    }
    let said = match success(path, row, mapping)? {
        Success::Said(success) => success,
        Success::Error => return Ok(invalid(format!("`{}` says error", mapping.column(Role::Success)), false)),
        Success::Silent => return Ok(invalid(format!("`{}` is missing", mapping.column(Role::Success)), true)),
    };
    let mode = failure_mode(path, row, mapping)?;
    let mut flags = FLAGS.map(|(mode, _)| (mode, None));
    for ((_, flag), (_, role)) in flags.iter_mut().zip(FLAGS) {
        *flag = self::flag(path, row, mapping, role)?;
    }
    let lacks = flags.map(|(_, flag)| flag.is_none());
    let raised = flags.iter().find(|(_, flag)| *flag == Some(true)).map(|(mode, _)| *mode);
    let went =
        |outcome, kind_known, contradicted| Went { outcome, time_s, kind_known, lacks, contradicted, silent: false };
    if said {
        if let Some(mode) = mode {
            let reason = format!("contradicts `{}`, which says success", mapping.column(Role::Success));
            return Err(row.wrong(path, mapping.column(Role::FailureMode), format!("({}) {reason}", mode.as_str())));
        }
        // A grasp that was missed once and then succeeded is a success; a touch or a drop is not.
        return Ok(match raised.filter(|mode| mode.as_str() != "grasp_miss") {
            Some(mode) => went(Outcome::Failure(mode), true, true),
            None => went(Outcome::Success, true, false),
        });
    }
    if let Some(mode) = mode
        && let Some(((_, role), _)) =
            FLAGS.into_iter().zip(flags).find(|(_, (of, flag))| *of == mode && *flag == Some(false))
    {
        let reason = format!("contradicts `{}`, which says {}", mapping.column(Role::FailureMode), mode.as_str());
        return Err(row.wrong(path, mapping.column(role), reason));
    }
    // All three flags lowered say what it was not: the object was never placed in time.
    let told = mode.or(raised).or(flags.iter().all(|(_, flag)| *flag == Some(false)).then_some(FailureMode::TIMEOUT));
    Ok(went(Outcome::Failure(told.unwrap_or(FailureMode::TIMEOUT)), told.is_some(), false))
}

enum Success {
    Said(bool),
    Error,
    Silent,
}

fn success(path: &Path, row: &RawRow, mapping: &Mapping) -> Result<Success, DictionaryError> {
    let column = mapping.column(Role::Success);
    Ok(match row.get(column) {
        None | Some(Scalar::Null) => Success::Silent,
        Some(Scalar::Text(word)) if ["error", "invalid"].contains(&word.to_ascii_lowercase().as_str()) => {
            Success::Error
        }
        Some(value) => Success::Said(truth(value).ok_or_else(|| {
            row.wrong(path, column, "is neither true nor false\nhint: true, false, 1, 0, success, fail, or error")
        })?),
    })
}

/// A value as a truth, where it is one.
fn truth(value: &Scalar) -> Option<bool> {
    match value {
        Scalar::Bool(truth) => Some(*truth),
        Scalar::Integer(0) => Some(false),
        Scalar::Integer(1) => Some(true),
        Scalar::Number(x) if x.to_bits() == 0_f64.to_bits() => Some(false),
        Scalar::Number(x) if x.to_bits() == 1_f64.to_bits() => Some(true),
        Scalar::Text(word) => match word.to_ascii_lowercase().as_str() {
            "true" | "yes" | "success" | "succeeded" => Some(true),
            "false" | "no" | "fail" | "failed" | "failure" => Some(false),
            _ => None,
        },
        Scalar::Null | Scalar::Integer(_) | Scalar::Number(_) | Scalar::Nested => None,
    }
}

fn flag(path: &Path, row: &RawRow, mapping: &Mapping, role: Role) -> Result<Option<bool>, DictionaryError> {
    let column = mapping.column(role);
    match row.get(column) {
        None | Some(Scalar::Null) => Ok(None),
        Some(value) => truth(value)
            .map(Some)
            .ok_or_else(|| row.wrong(path, column, format!("is neither true nor false, as {} must be", role.word()))),
    }
}

fn failure_mode(path: &Path, row: &RawRow, mapping: &Mapping) -> Result<Option<FailureMode>, DictionaryError> {
    let column = mapping.column(Role::FailureMode);
    let word = match row.get(column) {
        None | Some(Scalar::Null) => return Ok(None),
        Some(Scalar::Text(word)) => word.as_str(),
        Some(_) => return Err(row.wrong(path, column, "is no word for a failure mode")),
    };
    if let Some(ours) = mapping.failure_modes.get(word) {
        return Ok(mode(ours));
    }
    if ["", "none", "success"].contains(&word) {
        return Ok(None);
    }
    mode(word).map(Some).ok_or_else(|| {
        row.wrong(
            path,
            column,
            "is none of grasp_miss, grip_loss, collision, timeout\nhint: a mapping file says which of them it is, under [failure_modes]",
        )
    })
}

/// What the row says that broke, where it says so.
fn error(row: &RawRow, mapping: &Mapping) -> Option<String> {
    let text = match row.get(mapping.column(Role::Error))? {
        Scalar::Null | Scalar::Bool(false) | Scalar::Integer(0) => return None,
        Scalar::Text(text) if text.trim().is_empty() || truth(&Scalar::Text(text.clone())) == Some(false) => {
            return None;
        }
        Scalar::Text(text) if text.eq_ignore_ascii_case("none") => return None,
        Scalar::Text(text) => text.clone(),
        other => format!("`{}` is {}", mapping.column(Role::Error), other.show()),
    };
    // Tracebacks can be long; the dictionary keeps what tells one from another.
    const MOST: usize = 2000;
    Some(match text.char_indices().nth(MOST) {
        Some((end, _)) => format!("{}...", &text[..end]),
        None => text,
    })
}

/// The class of fault by the words that tools use; where they say nothing, the policy or simulator went away.
fn fault_kind(detail: &str) -> FaultKind {
    let word = detail.split(|c: char| !(c.is_ascii_alphanumeric() || c == '_')).find(|word| !word.is_empty());
    match word {
        Some("env_start" | "setup") => FaultKind::Setup,
        Some("diverged") => FaultKind::Diverged,
        Some("bad_action") => FaultKind::BadAction,
        _ => FaultKind::Unavailable,
    }
}

fn time(path: &Path, row: &RawRow, mapping: &Mapping) -> Result<Option<f64>, DictionaryError> {
    let column = mapping.column(Role::CycleTime);
    let time = match row.get(column) {
        None | Some(Scalar::Null) => return Ok(None),
        Some(Scalar::Integer(n)) => *n as f64,
        Some(Scalar::Number(x)) => *x,
        Some(_) => return Err(row.wrong(path, column, "is no time in seconds")),
    };
    if time < 0.0 { Err(row.wrong(path, column, "is below 0 seconds")) } else { Ok(Some(time)) }
}
