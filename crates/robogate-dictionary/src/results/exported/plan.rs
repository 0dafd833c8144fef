//! The second pass over an export: converts rows to entries.

use std::path::Path;

use super::Field;
use crate::codec::{Interner, number_as_integer};
use crate::columns::{Cell, Columns, Kind};
use crate::export::{Number, number};
use crate::{DictionaryError, Entry, Provenance, RowPlace};

/// The conversion from rows to entries.
pub(super) struct Plan<'a> {
    pub(super) path: &'a Path,
    pub(super) provenance: Provenance,
    /// The columns of the export.
    pub(super) columns: Columns,
    /// The next row.
    pub(super) row: u64,
}

impl Plan<'_> {
    pub(super) fn entry(&mut self, fields: &[Field], words: &mut Interner) -> Result<Entry, DictionaryError> {
        let place = RowPlace::Row(self.row);
        self.row += 1;
        let wrong = |column: &str, value: &str, reason: &str| DictionaryError::Value {
            path: self.path.to_owned(),
            place,
            column: column.to_owned(),
            value: value.to_owned(),
            reason: reason.to_owned(),
        };
        let cells = self.columns.specs().iter().zip(fields).map(|(spec, field)| {
            cell(spec.kind, field).map_err(|expected| {
                let value = format!("`{}`", field.text().unwrap_or_default());
                wrong(&spec.name, &value, &format!("is not {expected}"))
            })
        });
        let cells = cells.collect::<Result<Vec<_>, _>>()?;
        self.columns.unflatten(&cells, words).map_err(|found| wrong(&found.column, &found.value, &found.reason))
    }
}

/// The field as a cell of a column of this kind. The error names the expected value.
fn cell(kind: Kind, field: &Field) -> Result<Cell<'_>, &'static str> {
    let (text, number) = match field {
        Field::Missing => return Ok(Cell::Null),
        Field::Bare(text) => (text, number(text)),
        Field::Text(text) => (text, None),
    };
    match (kind, number) {
        (Kind::Text, _) => Ok(Cell::Text(text.into())),
        (Kind::Number, Some(Number::Real(x))) => Ok(Cell::Number(x)),
        (Kind::Number, Some(Number::Integer(n))) => Ok(Cell::Number(n as f64)),
        (Kind::Number, None) => Err("a number without quotes"),
        // Another tool may have converted integers to real numbers.
        (Kind::Integer, number) => match number {
            Some(Number::Integer(n)) => Some(n),
            Some(Number::Real(x)) => number_as_integer(x),
            None => None,
        }
        .map(Cell::Integer)
        .ok_or("an integer without quotes"),
        (Kind::Count, _) if *field == Field::Text(text.clone()) => Err("an integer of at least 0 without quotes"),
        (Kind::Count, _) => text.parse().map(Cell::Count).map_err(|_| "an integer of at least 0 without quotes"),
    }
}
