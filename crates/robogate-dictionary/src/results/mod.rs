//! Imports per-episode results of other tools, so policies can be judged in any simulator.
//!
//! These formats are supported: LeRobot's `eval_info.json` and its datasets, the aggregate JSON of vla-eval, the log of Inspect Robots, tables (CSV, JSON Lines,
//! Parquet) with a [`Mapping`] of columns, and the CSV and JSON Lines of [`crate::export`]. A file is read twice as a
//! stream of rows: once to find the parameters and to check every row, and once to write. Memory does not grow with the
//! number of rows.
//!
//! Values that a source does not record stay missing. An episode that ended in an error is invalid, not a failure. A
//! failure without a failure mode has [`FailureMode::UNKNOWN`](robogate_core::FailureMode::UNKNOWN), and
//! [`crate::Source::not_recorded`] lists the modes that it may have been.

mod aggregates;
pub mod audit;
mod csv;
mod exported;
mod flags;
mod flat;
mod format;
mod inspect_robots;
mod json_lines;
mod lerobot;
mod lerobot_dataset;
mod mapping;
mod names;
mod numbers;
mod outcome;
mod parquet;
mod plan;
mod policies;
mod role;
mod survey;
mod task;
mod units;
mod vla_eval;

use std::cell::OnceCell;
use std::collections::BTreeSet;
use std::path::Path;
use std::sync::Arc;

use aggregates::Aggregates;
pub use format::Format;
pub use mapping::{About, Mapping};
pub use names::{follows_order, groups_rows, names_scenario};
use policies::Policies;
pub use policies::policies;
pub use role::Role;
pub use survey::{SOURCE_EPISODE, SOURCE_ROW, SOURCE_SEED, only_identifies, recorded_seed};

use crate::codec::Interner;
use crate::decode::placeholder;
use crate::published::{self, Imported};
use crate::raw::{MOST_FIELDS, RawRow};
use crate::{Dictionary, DictionaryError, DictionaryWriter};

/// The content of a file except its rows.
#[derive(Debug, Default)]
struct Frame {
    /// SHA-256 of the file.
    sha256: String,
    /// Numbers and words outside the rows (version, date, seed), as written by the tool.
    metadata: serde_json::Map<String, serde_json::Value>,
    /// Omissions and decisions of the reader, as sentences.
    notes: Vec<String>,
}

/// A function that receives the rows.
type Sink<'a> = &'a mut dyn FnMut(&RawRow) -> Result<(), DictionaryError>;

/// Imports the results in `from` as the dictionary `to`.
///
/// If no format is given, it is recognised from the content. If a row is invalid, no file is written. Of rows of several policies
/// ([`policies`]), those of the policy that the mapping names are imported.
pub fn import(from: &Path, to: &Path, format: Option<Format>, mapping: &Mapping) -> Result<Imported, DictionaryError> {
    let input = Input::new(from, format)?;
    let format = input.format;
    if format == Format::Published {
        if !mapping.is_empty() {
            return Err(fixed_columns(from, "the published JSON"));
        }
        return published::import(from, to);
    }
    if exported::is_export(from, format) {
        if !mapping.names_no_column() {
            return Err(fixed_columns(from, "an export of robogate"));
        }
        return exported::import(from, to, format, &mapping.about);
    }
    if format == Format::Parquet && Dictionary::open(from).is_ok() {
        return Err(DictionaryError::results(from, "it is already a dictionary\nHint: use it without importing it"));
    }
    let mapped = mapping.roles.contains_key(&Role::Success);
    let columns = input.columns();
    let mut mapping = mapping.over(&format.mapping()).found_in(&columns);
    let policies = Policies::of(&input, &mapping, &columns)?;
    let wanted = mapping.about.policy.clone();
    let kept = policies.chosen(from, wanted.as_deref())?;
    if mapping.about.policy.is_none() {
        mapping.about.policy = policies.only();
    }
    let mut aggregates = Aggregates::new(mapping.column(Role::Success), mapped);
    let mut survey = survey::Survey::new(from, &mapping);
    let mut frame = input.read(&mut |row| {
        if !policies.keeps(kept, row) {
            return Ok(());
        }
        aggregates.take(row);
        survey.row(row)
    })?;
    aggregates.check(from)?;
    frame.notes.extend(policies.note(kept));
    let plan = survey.plan(format, &frame)?;
    let mut writer = DictionaryWriter::create(to, &plan.provenance)?;
    let mut words = Interner::default();
    let mut index = 0;
    let again = input.read(&mut |row| {
        if policies.keeps(kept, row) {
            writer.push(&plan.entry(row, index, &mut words)?)?;
            index += 1;
        }
        Ok(())
    })?;
    if again.sha256 != frame.sha256 {
        return Err(changed(from));
    }
    let written = writer.finish()?;
    Ok(Imported { provenance: plan.provenance, written })
}

/// Imports `from` as the dictionary `to` if it is an export of RoboGate (CSV or JSON Lines). Returns whether it is one.
pub fn import_export(from: &Path, to: &Path) -> Result<bool, DictionaryError> {
    check_placeholder(from)?;
    match format::recognise(from) {
        Ok(format) if exported::is_export(from, format) => {
            exported::import(from, to, format, &About::default()).map(|_| true)
        }
        Ok(_) | Err(_) => Ok(false),
    }
}

fn check_placeholder(path: &Path) -> Result<(), DictionaryError> {
    placeholder(path).map_or(Ok(()), |reason| Err(DictionaryError::results(path, reason)))
}

/// The error about a mapping for a file with fixed columns.
fn fixed_columns(from: &Path, what: &str) -> DictionaryError {
    DictionaryError::Mapping {
        origin: from.display().to_string(),
        reason: format!("the columns of {what} are fixed\nHint: remove the mapping"),
    }
}

/// The error about a file that changed between the two passes.
fn changed(from: &Path) -> DictionaryError {
    DictionaryError::results(from, "it changed during the import\nHint: import it once it is complete")
}

/// A file whose rows are read several times.
#[derive(Debug)]
struct Input<'a> {
    path: &'a Path,
    format: Format,
    /// Of a CSV file. It depends on all fields, so the first reading decides it.
    spelling: OnceCell<csv::Spelling>,
}

impl<'a> Input<'a> {
    /// The input with the format that was given, or that of the content.
    fn new(path: &'a Path, given: Option<Format>) -> Result<Self, DictionaryError> {
        check_placeholder(path)?;
        let format = given.map_or_else(|| format::recognise(path), Ok)?;
        Ok(Self { path, format, spelling: OnceCell::new() })
    }

    fn read(&self, sink: Sink<'_>) -> Result<Frame, DictionaryError> {
        let path = self.path;
        match self.format {
            Format::LeRobot => lerobot::read(path, sink),
            Format::VlaEval => vla_eval::read(path, sink),
            Format::InspectRobots => inspect_robots::read(path, sink),
            Format::LeRobotDataset => lerobot_dataset::read(path, sink),
            Format::Csv => csv::read(path, self.spelling()?, sink),
            Format::JsonLines => json_lines::read(path, sink),
            Format::Parquet => parquet::read(path, sink),
            Format::Published => Err(DictionaryError::results(path, "the published JSON has a separate importer")),
        }
    }

    fn spelling(&self) -> Result<&csv::Spelling, DictionaryError> {
        if let Some(known) = self.spelling.get() {
            return Ok(known);
        }
        let found = csv::spelling(self.path)?;
        Ok(self.spelling.get_or_init(|| found))
    }

    /// The columns of the first rows. If the file cannot be read, its reader reports the error later.
    fn columns(&self) -> Vec<String> {
        const FIRST_ROWS: u64 = 100;
        let mut names: Vec<String> = Vec::new();
        let mut known: BTreeSet<Arc<str>> = BTreeSet::new();
        // The error ends the reading early.
        let _ = self.read(&mut |row| {
            for (name, _) in &row.fields {
                if known.insert(Arc::clone(name)) {
                    names.push(name.to_string());
                }
            }
            if row.number < FIRST_ROWS && names.len() < 2 * MOST_FIELDS {
                Ok(())
            } else {
                Err(DictionaryError::results(self.path, "enough rows were read"))
            }
        });
        names
    }
}
