//! A column of a dictionary in memory.

use std::collections::HashMap;

use parquet::data_type::ByteArray;
use parquet::errors::ParquetError;

use crate::columns::{Cell, Kind};

/// A column in memory. `None` is a missing value.
#[derive(Debug, Clone, PartialEq)]
pub enum Column {
    /// Real numbers.
    Numbers(Vec<Option<f64>>),
    /// Signed integers.
    Integers(Vec<Option<i64>>),
    /// Integers of at least 0.
    Counts(Vec<Option<u64>>),
    /// Words. Each row has the index of its word in `words`, which are in order of appearance.
    Categories {
        /// The distinct words.
        words: Vec<String>,
        /// The index of the word of each row.
        codes: Vec<Option<u32>>,
    },
}

impl Column {
    pub(super) fn of(kind: Kind) -> Self {
        match kind {
            Kind::Number => Self::Numbers(Vec::new()),
            Kind::Integer => Self::Integers(Vec::new()),
            Kind::Count => Self::Counts(Vec::new()),
            Kind::Text => Self::Categories { words: Vec::new(), codes: Vec::new() },
        }
    }

    /// The number of rows.
    pub fn len(&self) -> usize {
        match self {
            Self::Numbers(values) => values.len(),
            Self::Integers(values) => values.len(),
            Self::Counts(values) => values.len(),
            Self::Categories { codes, .. } => codes.len(),
        }
    }

    /// Whether there are no rows.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    pub(super) fn extend_numbers(&mut self, present: &[i16], values: Vec<f64>) {
        if let Self::Numbers(column) = self {
            spread(column, present, values.into_iter());
        }
    }

    pub(super) fn extend_longs(&mut self, present: &[i16], values: Vec<i64>) {
        match self {
            Self::Integers(column) => spread(column, present, values.into_iter()),
            Self::Counts(column) => spread(column, present, values.into_iter().map(i64::cast_unsigned)),
            Self::Numbers(_) | Self::Categories { .. } => {}
        }
    }

    pub(super) fn extend_texts(
        &mut self,
        present: &[i16],
        values: &[ByteArray],
        places: &mut HashMap<Box<[u8]>, u32>,
    ) -> Result<(), ParquetError> {
        let Self::Categories { words, codes } = self else {
            return Ok(());
        };
        let mut of_values = Vec::with_capacity(values.len());
        for value in values {
            let code = match places.get(value.data()) {
                Some(code) => *code,
                None => {
                    let code = u32::try_from(words.len())
                        .map_err(|_| ParquetError::General("it has more than 2^32 distinct texts".to_owned()))?;
                    words.push(value.as_utf8()?.to_owned());
                    places.insert(value.data().into(), code);
                    code
                }
            };
            of_values.push(code);
        }
        spread(codes, present, of_values.into_iter());
        Ok(())
    }

    pub(super) fn cell(&self, row: usize) -> Cell<'_> {
        let cell = match self {
            Self::Numbers(values) => values.get(row).copied().flatten().map(Cell::Number),
            Self::Integers(values) => values.get(row).copied().flatten().map(Cell::Integer),
            Self::Counts(values) => values.get(row).copied().flatten().map(Cell::Count),
            Self::Categories { words, codes } => {
                let word = codes.get(row).copied().flatten().and_then(|code| words.get(code as usize));
                word.map(|word| Cell::Text(word.as_str().into()))
            }
        };
        cell.unwrap_or(Cell::Null)
    }
}

/// Distributes the values to the rows that have one. Without levels every row has one.
fn spread<T>(column: &mut Vec<Option<T>>, present: &[i16], mut values: impl Iterator<Item = T>) {
    if present.is_empty() {
        column.extend(values.map(Some));
    } else {
        column.extend(present.iter().map(|level| if *level == 0 { None } else { values.next() }));
    }
}
