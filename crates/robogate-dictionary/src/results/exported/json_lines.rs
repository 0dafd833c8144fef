//! The rows of exported JSON Lines.

use std::fmt;
use std::path::{Path, PathBuf};

use serde::Deserialize;
use serde::de::{Deserializer, Error, MapAccess, Visitor};

use super::Field;
use crate::DictionaryError;
use crate::raw::MOST_FIELDS;
use crate::results::json_lines::Lines;

/// The rows of a file. The first one is already read.
pub(super) struct Rows {
    path: PathBuf,
    lines: Lines,
    pub(super) names: Vec<String>,
    first: Option<Vec<Field>>,
}

impl Rows {
    /// Opens the file and reads its first row. `None` if it has none.
    pub(super) fn open(path: &Path) -> Result<Option<Self>, DictionaryError> {
        let mut lines = Lines::open(path)?;
        let Some(row) = read(&mut lines)? else { return Ok(None) };
        let (names, first) = row.0.into_iter().unzip();
        Ok(Some(Self { path: path.to_owned(), lines, names, first: Some(first) }))
    }

    pub(super) fn next(&mut self, fields: &mut Vec<Field>) -> Result<bool, DictionaryError> {
        if let Some(first) = self.first.take() {
            *fields = first;
            return Ok(true);
        }
        let Some(row) = read(&mut self.lines)? else { return Ok(false) };
        if !row.0.iter().map(|(name, _)| name).eq(&self.names) {
            let reason = format!(
                "line {}: its fields differ from those of the first line. Expected the same names in the same order",
                self.lines.number()
            );
            return Err(DictionaryError::results(&self.path, reason));
        }
        fields.clear();
        fields.extend(row.0.into_iter().map(|(_, field)| field));
        Ok(true)
    }

    pub(super) fn sha256(self) -> String {
        self.lines.sha256()
    }
}

fn read(lines: &mut Lines) -> Result<Option<Row>, DictionaryError> {
    let Some(text) = lines.next()? else { return Ok(None) };
    match serde_json::from_slice(text) {
        Ok(row) => Ok(Some(row)),
        Err(e) => Err(lines.wrong(&e)),
    }
}

/// Names and fields in their order.
struct Row(Vec<(String, Field)>);

impl<'de> Deserialize<'de> for Row {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_map(RowVisitor)
    }
}

struct RowVisitor;

impl<'de> Visitor<'de> for RowVisitor {
    type Value = Row;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("an object of fields")
    }

    fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<Row, A::Error> {
        let mut fields = Vec::new();
        while let Some(field) = map.next_entry()? {
            if fields.len() == 2 * MOST_FIELDS {
                return Err(A::Error::custom("a row has more fields than a dictionary can have"));
            }
            fields.push(field);
        }
        Ok(Row(fields))
    }
}

impl<'de> Deserialize<'de> for Field {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_any(FieldVisitor)
    }
}

struct FieldVisitor;

impl Visitor<'_> for FieldVisitor {
    type Value = Field;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a number, a text or null")
    }

    fn visit_unit<E: Error>(self) -> Result<Field, E> {
        Ok(Field::Missing)
    }

    fn visit_i64<E: Error>(self, n: i64) -> Result<Field, E> {
        Ok(Field::Bare(n.to_string()))
    }

    fn visit_u64<E: Error>(self, n: u64) -> Result<Field, E> {
        Ok(Field::Bare(n.to_string()))
    }

    /// The shortest digits that parse to the same double.
    fn visit_f64<E: Error>(self, x: f64) -> Result<Field, E> {
        Ok(Field::Bare(format!("{x:?}")))
    }

    fn visit_str<E: Error>(self, text: &str) -> Result<Field, E> {
        Ok(Field::Text(text.to_owned()))
    }
}
