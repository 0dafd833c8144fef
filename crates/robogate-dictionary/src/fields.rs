//! What the fields of another tool's rows hold: from it comes the parameter space of an import.

use std::collections::BTreeSet;
use std::path::Path;
use std::sync::Arc;

use robogate_core::{Domain, Scale};

use crate::DictionaryError;
use crate::raw::{MOST_FIELDS, RawRow, Scalar};

/// A word field with more distinct words than this is text about the row and no parameter of it.
const MOST_WORDS: usize = 1000;

/// The fields of all rows so far, in the order in which they came up.
#[derive(Debug, Default)]
pub(crate) struct Fields(Vec<Field>);

impl Fields {
    /// Takes in the value that `row` has in the field `name`; a field of two kinds is an error.
    pub(crate) fn take(
        &mut self,
        path: &Path,
        row: &RawRow,
        name: &Arc<str>,
        value: &Scalar,
    ) -> Result<(), DictionaryError> {
        match self.field(row.number, name) {
            Some(field) => {
                let fits = field.take(row.number, value);
                fits.then_some(()).ok_or_else(|| row.wrong(path, name, "is of another kind than in the rows before"))
            }
            None => {
                let reason = format!("is in one field more than the {MOST_FIELDS} that a file can have");
                Err(row.wrong(path, name, reason))
            }
        }
    }

    /// The same for a field that nobody asked for: one of two kinds, or one too many, is no parameter.
    pub(crate) fn take_if_it_fits(&mut self, row: &RawRow, name: &Arc<str>, value: &Scalar) {
        if let Some(field) = self.field(row.number, name)
            && !field.take(row.number, value)
        {
            field.kind = FieldKind::Other("its rows are of several kinds");
        }
    }

    fn field(&mut self, number: u64, name: &Arc<str>) -> Option<&mut Field> {
        let at = match self.0.iter().position(|field| field.name == *name) {
            Some(at) => at,
            None if self.0.len() == MOST_FIELDS => return None,
            None => {
                let missing = (number > 0).then_some(0);
                self.0.push(Field { name: Arc::clone(name), missing, seen: number, kind: FieldKind::Nothing });
                self.0.len() - 1
            }
        };
        self.0.get_mut(at)
    }

    pub(crate) fn into_iter(self) -> impl Iterator<Item = Field> {
        self.0.into_iter()
    }
}

/// A field that is no outcome: what values it has in which rows.
#[derive(Debug)]
pub(crate) struct Field {
    pub(crate) name: Arc<str>,
    /// The first row that lacks it.
    missing: Option<u64>,
    /// Rows from the first on that have it.
    seen: u64,
    kind: FieldKind,
}

#[derive(Debug)]
enum FieldKind {
    /// No value yet.
    Nothing,
    /// Only whole numbers so far.
    Integers { low: i64, high: i64 },
    /// Real numbers.
    Numbers { low: f64, high: f64 },
    /// Words.
    Words(BTreeSet<String>),
    /// Something that is no parameter, and why.
    Other(&'static str),
}

impl FieldKind {
    fn of(value: &Scalar) -> Self {
        match value {
            Scalar::Integer(n) => Self::Integers { low: *n, high: *n },
            Scalar::Number(x) => Self::Numbers { low: *x, high: *x },
            Scalar::Text(text) => Self::Words(BTreeSet::from([text.clone()])),
            Scalar::Bool(_) => Self::Other("it is true or false"),
            Scalar::Null | Scalar::Nested => Self::Other("it is an array or object"),
        }
    }

    /// Takes one more value in; `false` where it is of another kind than those before.
    fn take(&mut self, value: &Scalar) -> bool {
        match (&mut *self, value) {
            (Self::Nothing, value) => {
                *self = Self::of(value);
                true
            }
            (Self::Other(_), _) => true,
            (Self::Integers { low, high }, Scalar::Integer(n)) => {
                (*low, *high) = ((*low).min(*n), (*high).max(*n));
                true
            }
            (Self::Integers { low, high }, Scalar::Number(x)) => {
                *self = Self::Numbers { low: x.min(*low as f64), high: x.max(*high as f64) };
                true
            }
            (Self::Numbers { low, high }, Scalar::Number(x)) => {
                (*low, *high) = (low.min(*x), high.max(*x));
                true
            }
            (Self::Numbers { low, high }, Scalar::Integer(n)) => {
                (*low, *high) = (low.min(*n as f64), high.max(*n as f64));
                true
            }
            (Self::Words(words), Scalar::Text(text)) => {
                if !words.contains(text) {
                    words.insert(text.clone());
                }
                if words.len() > MOST_WORDS {
                    *self = Self::Other("it has more words than a category can have");
                }
                true
            }
            _ => false,
        }
    }
}

impl Field {
    fn take(&mut self, number: u64, value: &Scalar) -> bool {
        if self.seen < number {
            self.missing.get_or_insert(self.seen);
        }
        self.seen = number + 1;
        self.kind.take(value)
    }

    /// The first of `rows` rows that lacks it.
    pub(crate) fn missing_of(&self, rows: u64) -> Option<u64> {
        self.missing.or((self.seen < rows).then_some(self.seen))
    }

    /// The observed range as a parameter's, or why it is no parameter.
    pub(crate) fn domain(&self) -> Result<Domain, &'static str> {
        self.domain_as(&self.name)
    }

    /// The same for a parameter that will be called `name`.
    pub(crate) fn domain_as(&self, name: &str) -> Result<Domain, &'static str> {
        let column = name.chars().all(|c| c.is_ascii_alphanumeric() || c == '_') && !name.is_empty();
        match &self.kind {
            FieldKind::Nothing => Err("it has no value"),
            FieldKind::Other(why) => Err(why),
            _ if !column => Err("its name cannot be a column's"),
            FieldKind::Integers { low, high } if high.abs_diff(*low) < 1 << 32 => {
                Ok(Domain::Integer { low: *low, high: *high })
            }
            FieldKind::Integers { low, high } => Ok(continuous(*low as f64, *high as f64)),
            FieldKind::Numbers { low, high } => Ok(continuous(*low, *high)),
            FieldKind::Words(words) => {
                Ok(Domain::Categorical { choices: words.iter().map(|word| word.as_str().into()).collect() })
            }
        }
    }
}

/// A range that holds what was observed; a single value is widened by the least that a double can.
fn continuous(low: f64, high: f64) -> Domain {
    let high = if low < high { high } else { low.next_up() };
    Domain::Continuous { low, high, scale: Scale::Linear }
}
