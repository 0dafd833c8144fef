//! Per-episode results of other tools as a dictionary, so that policies can be judged whose simulator we
//! never saw.
//!
//! Five layouts are read: LeRobot's `eval_info.json`, the aggregate JSON of vla-eval, and tables (CSV,
//! JSON Lines, Parquet) whose columns a [`Mapping`] names. Each is a stream of rows of fields; the
//! mapping says which field is what. A file is read twice, once to learn which parameters there are and
//! to check every row, once to write: memory does not grow with the number of rows.
//!
//! What a source does not record is not made up. An episode that ended in an error is invalid, and no
//! failure. A failure whose kind is not said stands as a timeout ("not done when the episode ended"),
//! and [`crate::Source::not_recorded`] says that it may have been a collision.

mod csv;
mod flat;
mod format;
mod json_lines;
mod lerobot;
mod mapping;
mod outcome;
mod parquet;
mod survey;
mod vla_eval;

use std::path::Path;

pub use format::Format;
pub use mapping::{About, Mapping};
pub use survey::{SOURCE_ROW, SOURCE_SEED};

use crate::codec::Interner;
use crate::published::{self, Imported};
use crate::raw::RawRow;
use crate::{DictionaryError, DictionaryWriter};

/// What a reader says about a file beside its rows.
#[derive(Debug, Default)]
struct Frame {
    /// SHA-256 of the file.
    sha256: String,
    /// The numbers and words around the rows (version, date, seed), as the tool wrote them.
    metadata: serde_json::Map<String, serde_json::Value>,
    /// What the reader left out or had to decide, in sentences.
    notes: Vec<String>,
}

/// What takes the rows.
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
            return Err(DictionaryError::Mapping {
                origin: from.display().to_string(),
                reason: "the published JSON has fixed fields\nhint: leave the mapping out".to_owned(),
            });
        }
        return published::import(from, to);
    }
    let mapping = mapping.over(&format.mapping());
    let mut survey = survey::Survey::new(from, &mapping);
    let frame = read(format, from, &mut |row| survey.row(row))?;
    let plan = survey.plan(format, &frame)?;
    let mut writer = DictionaryWriter::create(to, plan.provenance())?;
    let mut words = Interner::default();
    let again = read(format, from, &mut |row| writer.push(&plan.entry(row, &mut words)?))?;
    if again.sha256 != frame.sha256 {
        return Err(DictionaryError::results(
            from,
            "it changed while it was read\nhint: import it once it is complete",
        ));
    }
    let written = writer.finish()?;
    Ok(Imported { provenance: plan.into_provenance(), written })
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
