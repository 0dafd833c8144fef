//! Per-episode results of other tools as a dictionary: policies can be judged in simulators that RoboGate never saw.
//!
//! Six layouts are read: LeRobot's `eval_info.json`, the aggregate JSON of vla-eval, tables (CSV, JSON Lines, Parquet) whose
//! columns a [`Mapping`] names, and the CSV and JSON Lines that [`crate::export`] writes. A file is read twice as a stream
//! of rows: once to learn which parameters there are and to check every row, once to write. Memory does not grow with the
//! number of rows.
//!
//! What a source does not record stays missing. An episode that ended in an error is invalid, not a failure. A failure
//! without a failure mode has [`FailureMode::UNKNOWN`](robogate_core::FailureMode::UNKNOWN), and
//! [`crate::Source::not_recorded`] lists the modes that it may have been.

mod csv;
mod exported;
mod flags;
mod flat;
mod format;
mod json_lines;
mod lerobot;
mod mapping;
mod outcome;
mod parquet;
mod plan;
mod role;
mod survey;
mod task;
mod vla_eval;

use std::path::Path;

pub use format::Format;
pub use mapping::{About, Mapping};
pub use role::Role;
pub use survey::{SOURCE_ROW, SOURCE_SEED};

use crate::codec::Interner;
use crate::published::{self, Imported};
use crate::raw::RawRow;
use crate::{Dictionary, DictionaryError, DictionaryWriter};

/// What a reader finds in a file beside its rows.
#[derive(Debug, Default)]
struct Frame {
    /// SHA-256 of the file.
    sha256: String,
    /// Numbers and words beside the rows (version, date, seed), as the tool wrote them.
    metadata: serde_json::Map<String, serde_json::Value>,
    /// What the reader left out or decided, in sentences.
    notes: Vec<String>,
}

/// Receives the rows.
type Sink<'a> = &'a mut dyn FnMut(&RawRow) -> Result<(), DictionaryError>;

/// Imports the results in `from` as the dictionary `to`.
///
/// The format is recognised by content where none is given. Nothing is written where a row is wrong.
pub fn import(from: &Path, to: &Path, format: Option<Format>, mapping: &Mapping) -> Result<Imported, DictionaryError> {
    let format = match format {
        Some(format) => format,
        None => format::recognise(from)?,
    };
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
        return Err(DictionaryError::results(from, "it is a dictionary already\nhint: use it as it is"));
    }
    let mapping = mapping.over(&format.mapping());
    let mut survey = survey::Survey::new(from, &mapping);
    let frame = read(format, from, &mut |row| survey.row(row))?;
    let plan = survey.plan(format, &frame)?;
    let mut writer = DictionaryWriter::create(to, &plan.provenance)?;
    let mut words = Interner::default();
    let again = read(format, from, &mut |row| writer.push(&plan.entry(row, &mut words)?))?;
    if again.sha256 != frame.sha256 {
        return Err(changed(from));
    }
    let written = writer.finish()?;
    Ok(Imported { provenance: plan.provenance, written })
}

/// A mapping for a file whose columns are fixed.
fn fixed_columns(from: &Path, what: &str) -> DictionaryError {
    DictionaryError::Mapping {
        origin: from.display().to_string(),
        reason: format!("the columns of {what} are fixed\nhint: leave the mapping out"),
    }
}

/// The second reading found another file than the first.
fn changed(from: &Path) -> DictionaryError {
    DictionaryError::results(from, "it changed while it was read\nhint: import it once it is complete")
}

fn read(format: Format, path: &Path, sink: Sink<'_>) -> Result<Frame, DictionaryError> {
    match format {
        Format::LeRobot => lerobot::read(path, sink),
        Format::VlaEval => vla_eval::read(path, sink),
        Format::Csv => csv::read(path, sink),
        Format::JsonLines => json_lines::read(path, sink),
        Format::Parquet => parquet::read(path, sink),
        Format::Published => Err(DictionaryError::results(path, "the published JSON has an importer of its own")),
    }
}
