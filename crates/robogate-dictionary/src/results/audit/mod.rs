//! Audits a file of results: finds rows that make its success rate wrong.
//!
//! The audit reads the same formats as [`super::import`] and interprets no outcome beyond success. Each check names the
//! columns that it needs. A check whose columns are missing, or that could not find its fault in these rows, is listed as not
//! possible, because silence would look like a pass.

mod checks;
mod table;

use std::path::Path;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::{Aggregates, Format, Input, Mapping, Role};
use crate::DictionaryError;
use table::Table;

/// A check of an audit.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Check {
    /// Infrastructure errors that are counted as failures.
    InfrastructureErrors,
    /// Episodes that start in the same state.
    DuplicateInitialStates,
    /// Episodes that succeed in their first step.
    SuccessAtFirstStep,
    /// Episodes that succeed when the time limit ends them.
    SuccessAtTimeLimit,
    /// Numbers of episodes without a row.
    MissingRows,
    /// Rows that occur twice.
    DuplicateRows,
    /// Results that depend on the parallel environment or on the position in a batch.
    BatchArtefacts,
    /// Seeds that several episodes share.
    RepeatedSeeds,
}

impl Check {
    /// Every check.
    pub const ALL: [Self; 8] = [
        Self::InfrastructureErrors,
        Self::DuplicateInitialStates,
        Self::SuccessAtFirstStep,
        Self::SuccessAtTimeLimit,
        Self::MissingRows,
        Self::DuplicateRows,
        Self::BatchArtefacts,
        Self::RepeatedSeeds,
    ];

    /// The check in a heading.
    pub fn title(self) -> &'static str {
        match self {
            Self::InfrastructureErrors => "infrastructure errors counted as failures",
            Self::DuplicateInitialStates => "duplicate initial states",
            Self::SuccessAtFirstStep => "success at the first step",
            Self::SuccessAtTimeLimit => "success at the time limit",
            Self::MissingRows => "missing rows",
            Self::DuplicateRows => "duplicate rows",
            Self::BatchArtefacts => "batch-size artefacts",
            Self::RepeatedSeeds => "repeated seeds",
        }
    }

    /// What to do about it.
    fn remedy(self) -> &'static str {
        match self {
            Self::InfrastructureErrors => {
                "Run these episodes again, or import them as invalid: `robogate import --map error=COLUMN`."
            }
            Self::DuplicateInitialStates => {
                "Give each episode its own initial state. Until then, count each state once: repeats add no evidence."
            }
            Self::SuccessAtFirstStep => {
                "Look at these episodes. The success test may be true at the reset, or the state of the previous episode was kept."
            }
            Self::SuccessAtTimeLimit => {
                "Look at these episodes. The time limit ended them, although other successes end the episode: success may \
                 be reported for a timeout."
            }
            Self::MissingRows => {
                "Find out what happened to the missing episodes. If they ended in errors or were stopped, the rate is biased."
            }
            Self::DuplicateRows => {
                "Keep one row of each episode. The file may have been written twice or merged with itself."
            }
            Self::BatchArtefacts => {
                "Run the same number of episodes in each environment, and check the reset and the seed of each position."
            }
            Self::RepeatedSeeds => {
                "Give each episode its own seed. With a policy that decides without chance, episodes with the same seed and scenario are copies, not new evidence."
            }
        }
    }
}

/// The result of one check.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case", tag = "result")]
pub enum CheckResult {
    /// Nothing was found.
    Clear {
        /// The columns that were used.
        columns: Vec<String>,
    },
    /// The file lacks what the check needs, or has too few rows to find the fault.
    NotPossible {
        /// What is missing.
        because: String,
    },
    /// Problems were found.
    Found {
        /// The problems.
        problems: Vec<Problem>,
        /// What to do.
        remedy: String,
    },
}

/// A problem of some rows.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct Problem {
    /// What is wrong, in one sentence.
    pub what: String,
    /// Number of affected rows.
    pub count: u64,
    /// The first affected rows, numbered from 0 without the header.
    pub rows: Vec<u64>,
}

/// One check of an audit with its result.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct Checked {
    /// The check.
    pub check: Check,
    /// Its result.
    #[serde(flatten)]
    pub result: CheckResult,
}

/// The audit of a file.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct Audit {
    /// Version of the document.
    pub version: u32,
    /// The format of the file.
    pub format: String,
    /// SHA-256 (hex) of the file.
    pub sha256: String,
    /// Number of rows.
    pub rows: u64,
    /// Number of rows that report success.
    pub successes: u64,
    /// Number of rows that report failure.
    pub failures: u64,
    /// Every check with its result.
    pub checks: Vec<Checked>,
}

impl Audit {
    /// The version of the document.
    pub const VERSION: u32 = 1;

    /// Number of checks that found a problem.
    pub fn found(&self) -> usize {
        self.checks.iter().filter(|checked| matches!(checked.result, CheckResult::Found { .. })).count()
    }
}

/// Audits the results in `path`. If no format is given, it is recognised from the content.
///
/// # Errors
/// If the file cannot be read, has no rows, or does not report success and failure.
pub fn audit(path: &Path, format: Option<Format>, mapping: &Mapping) -> Result<Audit, DictionaryError> {
    let input = Input::new(path, format)?;
    let format = input.format;
    if format == Format::Published {
        let reason = "the published JSON has one layout, whose import checks every row\nHint: robogate import";
        return Err(DictionaryError::results(path, reason));
    }
    let columns = input.columns();
    let mapped = mapping.roles.contains_key(&Role::Success);
    let mapping = mapping.over(&format.mapping()).found_in(&columns);
    let mut aggregates = Aggregates::new(mapping.column(Role::Success), mapped);
    let mut table = Table::new(&mapping, &columns);
    let frame = input.read(&mut |row| {
        aggregates.take(row);
        table.push(path, row)
    })?;
    if !table.own {
        aggregates.check(path)?;
    }
    if table.rows.is_empty() {
        return Err(DictionaryError::results(path, "it has no episodes. Expected at least one row"));
    }
    if !table.has_outcomes {
        let reason = format!(
            "no row reports success or failure: column `{}` is missing, or its values are neither true nor false\nHint: name the \
             column with --map success=COLUMN",
            mapping.column(Role::Success)
        );
        return Err(DictionaryError::results(path, reason));
    }
    if let Some(error) = table.unreadable.take() {
        return Err(error);
    }
    let result = |check: Check| {
        let result = match checks::run(check, &table, &frame.metadata) {
            Err(because) => CheckResult::NotPossible { because },
            Ok((problems, columns)) if problems.is_empty() => CheckResult::Clear { columns },
            Ok((problems, _)) => CheckResult::Found { problems, remedy: check.remedy().to_owned() },
        };
        Checked { check, result }
    };
    let count = |wanted: bool| table.rows.iter().filter(|row| row.success == Some(wanted)).count() as u64;
    Ok(Audit {
        version: Audit::VERSION,
        format: format.as_str().to_owned(),
        sha256: frame.sha256,
        rows: table.rows.len() as u64,
        successes: count(true),
        failures: count(false),
        checks: Check::ALL.map(result).into(),
    })
}
