//! The second pass: converts rows to entries.

use std::path::Path;
use std::sync::Arc;

use robogate_core::{Assignment, Domain, Episode, Measures, Scenario, Seed, Value, Word};

use super::outcome::Results;
use super::role::Role;
use super::survey::SEED_PARTS;
use super::{Format, Mapping};
use crate::codec::{EXACT_INTEGER, Interner};
use crate::raw::{RawRow, Scalar};
use crate::{DictionaryError, Entry, Label, Provenance};

/// The conversion from rows to entries.
pub(super) struct Plan<'a> {
    pub(super) path: &'a Path,
    pub(super) mapping: &'a Mapping,
    pub(super) results: Results<'a>,
    pub(super) provenance: Provenance,
    /// The column of each parameter. `None` stands for the row number.
    pub(super) columns: Vec<Option<Arc<str>>>,
    /// The column of each measure.
    pub(super) measures: Vec<(Arc<str>, Word)>,
    pub(super) format: Format,
}

impl Plan<'_> {
    /// The entry of a row. `index` is its number among the imported rows.
    pub(super) fn entry(&self, row: &RawRow, index: u64, words: &mut Interner) -> Result<Entry, DictionaryError> {
        let parameters = self.provenance.space.parameters().iter().zip(&self.columns);
        let requested = parameters
            .filter_map(|(parameter, column)| {
                let value = match column {
                    None => Ok(Value::Integer(i64::try_from(index).unwrap_or(i64::MAX))),
                    Some(column) if matches!(row.get(column), None | Some(Scalar::Null)) => return None,
                    Some(column) if let Some(at) = SEED_PARTS.iter().position(|part| *part == &*parameter.name) => {
                        seed_part(row.get(column), at)
                            .ok_or_else(|| row.wrong(self.path, column, "is not an integer of 64 bits"))
                    }
                    Some(column) => self.value(row, column, &parameter.domain, words),
                };
                Some(value.map(|value| (Arc::clone(&parameter.name), value)))
            })
            .collect::<Result<Assignment, DictionaryError>>()?;
        let ended = self.results.of(self.path, row)?;
        let episode = Episode {
            scenario: Scenario { index, seed: Seed::campaign(self.provenance.seed).episode(index), requested },
            applied: Assignment::default(),
            outcome: ended.outcome,
            // A missing value.
            time_s: ended.time_s.unwrap_or(f64::NAN),
            phase: None,
            contact: None,
            measures: self
                .measures
                .iter()
                .map(|(column, name)| (*name, measure(row.get(column))))
                .collect::<Measures>(),
            draws: Default::default(),
            ticks: 0,
            trajectory_hash: 0,
        };
        let label = Label {
            case: self.word(row, Role::Case)?,
            category: self.word(row, Role::Category)?,
            group: self.word(row, Role::Group)?,
        };
        Ok(Entry { stage: "imported".to_owned(), design: self.format.as_str().to_owned(), weight: 1.0, label, episode })
    }

    /// A word of the label, if the row has one. A number becomes its text.
    fn word(&self, row: &RawRow, role: Role) -> Result<Option<String>, DictionaryError> {
        let column = self.mapping.column(role);
        match row.get(column) {
            None | Some(Scalar::Null) => Ok(None),
            Some(Scalar::Text(word)) => Ok(Some(word.clone())),
            Some(Scalar::Integer(n)) => Ok(Some(n.to_string())),
            Some(Scalar::Unsigned(n)) => Ok(Some(n.to_string())),
            Some(_) => Err(row.wrong(self.path, column, format!("is not a word, as a {} must be", role.as_str()))),
        }
    }

    fn value(
        &self,
        row: &RawRow,
        column: &str,
        domain: &Domain,
        words: &mut Interner,
    ) -> Result<Value, DictionaryError> {
        let wrong = |reason: &str| Err(row.wrong(self.path, column, reason));
        Ok(match (row.get(column), domain) {
            (Some(Scalar::Integer(n)), Domain::Continuous { .. })
                if n.unsigned_abs() > EXACT_INTEGER.unsigned_abs() =>
            {
                return wrong(TOO_LONG);
            }
            (Some(Scalar::Unsigned(_)), _) => return wrong(TOO_LONG),
            (Some(Scalar::Integer(n)), Domain::Continuous { .. }) => Value::Number(*n as f64),
            (Some(Scalar::Integer(n)), _) => Value::Integer(*n),
            (Some(Scalar::Number(x)), _) => Value::Number(*x),
            (Some(Scalar::Text(text)), _) => Value::Category(words.get(text)),
            _ => return wrong("cannot be the value of a parameter"),
        })
    }
}

const TOO_LONG: &str = "has more digits than a double can represent\nHint: list the column under `ignore` in a mapping";

/// The upper (0) or lower (1) 32 bits of a seed.
fn seed_part(seed: Option<&Scalar>, part: usize) -> Option<Value> {
    let bits = match seed? {
        Scalar::Integer(n) => n.cast_unsigned(),
        Scalar::Unsigned(n) => *n,
        _ => return None,
    };
    Some(Value::Integer(if part == 0 { (bits >> 32).cast_signed() } else { (bits & 0xFFFF_FFFF).cast_signed() }))
}

/// The value of a measure. `None` if the row has none.
fn measure(value: Option<&Scalar>) -> Option<f64> {
    match value? {
        Scalar::Bool(truth) => Some(f64::from(u8::from(*truth))),
        Scalar::Integer(n) => Some(*n as f64),
        Scalar::Unsigned(n) => Some(*n as f64),
        Scalar::Number(x) => Some(*x),
        Scalar::Null | Scalar::Text(_) | Scalar::Nested => None,
    }
}
