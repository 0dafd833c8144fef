//! Exports the dictionary as CSV, JSON Lines, or the published JSON.
//!
//! CSV and JSON Lines have the same rows and column names as Parquet. A missing value is an empty field in CSV and
//! `null` in JSON; neither has NaN. Both can be imported again without loss ([`crate::results`]). All formats are
//! written as a stream with one row group in memory.

use std::fmt::Write as _;
use std::io::{self, Write};
use std::path::Path;

use serde::ser::{Serialize, SerializeMap, Serializer};

use crate::atomic::AtomicFile;
use crate::columns::{Cell, Columns};
use crate::{Dictionary, DictionaryError, formula, published};

/// A format for export.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Format {
    /// CSV after RFC 4180 ([`csv()`]).
    Csv,
    /// One JSON object for each row ([`json_lines`]).
    JsonLines,
    /// The JSON of the published dictionaries ([`published::export`]).
    Published,
}

/// Exports the dictionary to the file `path`, which is complete or absent. Returns the number of rows.
pub fn write_file(dictionary: &Dictionary, format: Format, path: &Path) -> Result<u64, DictionaryError> {
    let mut file = AtomicFile::create(path)?;
    // The writers below do not know the path.
    let rows = write_to(dictionary, format, &mut file).map_err(|error| match error {
        DictionaryError::Io { action: WRITE, source, .. } => DictionaryError::io(path, WRITE)(source),
        other => other,
    })?;
    file.commit()?;
    Ok(rows)
}

/// Exports the dictionary to a stream. Returns the number of rows.
pub fn write_to(dictionary: &Dictionary, format: Format, out: impl Write) -> Result<u64, DictionaryError> {
    match format {
        Format::Csv => csv(dictionary, out),
        Format::JsonLines => json_lines(dictionary, out),
        Format::Published => published::export(dictionary, out),
    }
}

const WRITE: &str = "write";

/// An error of a writer without a path.
pub(crate) fn write_error(source: io::Error) -> DictionaryError {
    DictionaryError::io(Path::new("the export"), WRITE)(source)
}

/// Writes the dictionary as CSV (RFC 4180: lines end in CRLF, a field with a comma, a quote or a line
/// break is quoted), with a line of column names. Returns the number of rows.
pub fn csv(dictionary: &Dictionary, out: impl Write) -> Result<u64, DictionaryError> {
    let mut header = String::new();
    for (i, name) in dictionary.column_names().enumerate() {
        separate(&mut header, i);
        quote(&mut header, name);
    }
    header.push_str("\r\n");
    let parameters = dictionary.columns().parameters();
    rows(dictionary, out, header, |cells, text| {
        for (i, cell) in cells.iter().enumerate() {
            separate(text, i);
            // Writing to a string cannot fail.
            let _ = match cell {
                Cell::Null => Ok(()),
                // The Debug format has the shortest digits that parse to the same double, with a decimal point.
                Cell::Number(x) => write!(text, "{x:?}"),
                Cell::Integer(n) => write!(text, "{n}"),
                Cell::Count(n) => write!(text, "{n}"),
                // Quotes distinguish a category of digits from a number.
                Cell::Text(word) if parameters.contains(&i) && number(word).is_some() => write!(text, "\"{word}\""),
                Cell::Text(word) => {
                    quote(text, word);
                    Ok(())
                }
            };
        }
        text.push_str("\r\n");
        Ok(())
    })
}

/// Writes the dictionary as JSON Lines: one object for each row. Returns the number of rows.
///
/// Integers are written in full. A reader that stores all numbers as doubles loses the last digits of a `seed` above
/// 2^53.
pub fn json_lines(dictionary: &Dictionary, out: impl Write) -> Result<u64, DictionaryError> {
    let columns = dictionary.columns();
    rows(dictionary, out, String::new(), |cells, text| {
        let line = serde_json::to_string(&JsonRow { columns, cells }).map_err(|e| write_error(e.into()))?;
        text.push_str(&line);
        text.push('\n');
        Ok(())
    })
}

/// Text is written in pieces of this size, so `out` needs no buffer.
const PIECE: usize = 1 << 16;

fn rows(
    dictionary: &Dictionary,
    mut out: impl Write,
    mut text: String,
    mut row: impl FnMut(&[Cell<'_>], &mut String) -> Result<(), DictionaryError>,
) -> Result<u64, DictionaryError> {
    let mut rows = 0;
    for entry in dictionary.entries() {
        let entry = entry?;
        let mut cells = Vec::with_capacity(dictionary.columns().specs().len());
        dictionary.columns().flatten(&entry, &mut cells)?;
        row(&cells, &mut text)?;
        rows += 1;
        if text.len() >= PIECE {
            out.write_all(text.as_bytes()).map_err(write_error)?;
            text.clear();
        }
    }
    out.write_all(text.as_bytes()).and_then(|()| out.flush()).map_err(write_error)?;
    Ok(rows)
}

fn separate(text: &mut String, i: usize) {
    if i > 0 {
        text.push(',');
    }
}

/// Appends a text. An empty text is quoted, because an unquoted empty field is a missing value.
fn quote(text: &mut String, field: &str) {
    let field = &*formula::marked(field);
    if field.is_empty() || field.contains([',', '"', '\r', '\n']) {
        text.push('"');
        text.push_str(&field.replace('"', "\"\""));
        text.push('"');
    } else {
        text.push_str(field);
    }
}

/// The number in an unquoted CSV field.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Number {
    Integer(i64),
    Real(f64),
}

/// Parses a text as a number in the format of this module. `inf`, `nan` and `+1` are words.
pub(crate) fn number(text: &str) -> Option<Number> {
    let digits = text.strip_prefix('-').unwrap_or(text);
    if !digits.starts_with(|c: char| c.is_ascii_digit()) {
        return None;
    }
    if let Ok(n) = text.parse() {
        return Some(Number::Integer(n));
    }
    text.parse().ok().filter(|x: &f64| x.is_finite()).map(Number::Real)
}

struct JsonRow<'a> {
    columns: &'a Columns,
    cells: &'a [Cell<'a>],
}

impl Serialize for JsonRow<'_> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut map = serializer.serialize_map(Some(self.cells.len()))?;
        for (spec, cell) in self.columns.specs().iter().zip(self.cells) {
            match cell {
                Cell::Null => map.serialize_entry(&spec.name, &())?,
                Cell::Number(x) => map.serialize_entry(&spec.name, x)?,
                Cell::Integer(n) => map.serialize_entry(&spec.name, n)?,
                Cell::Count(n) => map.serialize_entry(&spec.name, n)?,
                Cell::Text(word) => map.serialize_entry(&spec.name, word)?,
            }
        }
        map.end()
    }
}
