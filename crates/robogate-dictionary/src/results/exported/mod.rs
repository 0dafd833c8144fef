//! Imports exports of RoboGate without loss.
//!
//! The CSV and JSON Lines of [`crate::export`] have the dictionary's column names in the same order. Stages, weights,
//! applied values, measures and hashes are restored, and each entry equals the exported one. An export has no
//! provenance; space and task are derived from the rows.

mod csv;
mod json_lines;
mod plan;
mod survey;

use std::path::Path;

use super::{About, Format};
use crate::codec::Interner;
use crate::published::Imported;
use crate::{DictionaryError, DictionaryWriter};

/// A field of an exported row.
#[derive(Debug, Clone, PartialEq, Eq)]
enum Field {
    /// No value.
    Missing,
    /// An unquoted CSV field (a number or a text), or a JSON number.
    Bare(String),
    /// A quoted text.
    Text(String),
}

impl Field {
    /// The text of the field, if it has a value.
    fn text(&self) -> Option<&str> {
        match self {
            Self::Missing => None,
            Self::Bare(text) | Self::Text(text) => Some(text),
        }
    }
}

/// The columns that identify an export.
const MARKS: [&str; 8] = ["index", "stage", "design", "weight", "seed", "outcome", "failure_type", "trajectory_hash"];

/// The rows of an exported table.
enum Table {
    Csv(csv::Rows),
    JsonLines(json_lines::Rows),
}

impl Table {
    /// Opens the file. `None` if it has no header.
    fn open(path: &Path, format: Format) -> Result<Option<Self>, DictionaryError> {
        Ok(match format {
            Format::Csv => csv::Rows::open(path)?.map(Self::Csv),
            Format::JsonLines => json_lines::Rows::open(path)?.map(Self::JsonLines),
            Format::Published
            | Format::LeRobot
            | Format::VlaEval
            | Format::InspectRobots
            | Format::LeRobotDataset
            | Format::Parquet => None,
        })
    }

    fn names(&self) -> &[String] {
        match self {
            Self::Csv(rows) => &rows.names,
            Self::JsonLines(rows) => &rows.names,
        }
    }

    /// Reads the next row into `fields`, one per column. Returns `false` after the last row.
    fn next(&mut self, fields: &mut Vec<Field>) -> Result<bool, DictionaryError> {
        match self {
            Self::Csv(rows) => rows.next(fields),
            Self::JsonLines(rows) => rows.next(fields),
        }
    }

    /// The hash of the file, after the last row.
    fn sha256(self) -> String {
        match self {
            Self::Csv(rows) => rows.sha256(),
            Self::JsonLines(rows) => rows.sha256(),
        }
    }
}

/// Whether the file is an export, judged by its columns. If the file cannot be read, the reader of its format reports
/// the error.
pub(super) fn is_export(path: &Path, format: Format) -> bool {
    let table = Table::open(path, format).ok().flatten();
    table.is_some_and(|table| has_marks(table.names()))
}

/// Whether these are the columns of an export or a dictionary.
pub(super) fn has_marks(names: &[String]) -> bool {
    MARKS.iter().all(|mark| names.iter().any(|name| name == mark))
}

/// Imports the export `from` as the dictionary `to`.
pub(super) fn import(from: &Path, to: &Path, format: Format, about: &About) -> Result<Imported, DictionaryError> {
    let open = || {
        Table::open(from, format)?
            .ok_or_else(|| DictionaryError::results(from, "it is empty. Expected an export with its column names"))
    };
    let mut fields = Vec::new();
    let mut table = open()?;
    let mut survey = survey::Survey::new(from, table.names())?;
    while table.next(&mut fields)? {
        survey.row(&fields)?;
    }
    let sha256 = table.sha256();
    let mut plan = survey.plan(format, &sha256, about)?;
    let mut writer = DictionaryWriter::create(to, &plan.provenance)?;
    let mut words = Interner::default();
    let mut table = open()?;
    while table.next(&mut fields)? {
        writer.push(&plan.entry(&fields, &mut words)?)?;
    }
    if table.sha256() != sha256 {
        return Err(super::changed(from));
    }
    let written = writer.finish()?;
    Ok(Imported { provenance: plan.provenance, written })
}
