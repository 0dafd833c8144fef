//! Collects the fields of another tool's rows, from which an import derives the parameter space.

use std::borrow::Cow;
use std::collections::BTreeSet;
use std::path::Path;
use std::sync::Arc;

use robogate_core::{Domain, Scale};

use crate::DictionaryError;
use crate::raw::{MOST_FIELDS, RawRow, Scalar};

/// Maximum number of distinct words of a category. A field with more contains free text.
pub(crate) const MOST_WORDS: usize = 1000;

/// The fields of all rows so far, in order of appearance.
#[derive(Debug, Default)]
pub(crate) struct Fields {
    all: Vec<Field>,
    /// The position after the last one. Rows mostly have their fields in the same order.
    next: usize,
}

impl Fields {
    /// Adds the value of `row` in the field `name`. Returns an error if a field has values of two kinds.
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
                fits.then_some(()).ok_or_else(|| row.wrong(path, name, "has another type than the earlier values"))
            }
            None => {
                let reason = format!("is in a new field, but a file can have at most {MOST_FIELDS}");
                Err(row.wrong(path, name, reason))
            }
        }
    }

    /// Adds an optional value like [`Self::take`]. A field with two kinds, or beyond the limit, does not become a
    /// parameter.
    pub(crate) fn take_if_it_fits(&mut self, row: &RawRow, name: &Arc<str>, value: &Scalar) {
        if let Some(field) = self.field(row.number, name)
            && !field.take(row.number, value)
        {
            let why = format!("its values have several types: {} has {}", row.place(), value.show());
            field.kind = FieldKind::Other(why.into());
        }
    }

    fn field(&mut self, number: u64, name: &Arc<str>) -> Option<&mut Field> {
        let is_next = self.all.get(self.next).is_some_and(|field| field.name == *name);
        let known = if is_next { Some(self.next) } else { self.all.iter().position(|field| field.name == *name) };
        let at = match known {
            Some(at) => at,
            None if self.all.len() == MOST_FIELDS => return None,
            None => {
                let missing = (number > 0).then_some(0);
                self.all.push(Field {
                    name: Arc::clone(name),
                    missing,
                    seen: number,
                    values: 0,
                    kind: FieldKind::Nothing,
                });
                self.all.len() - 1
            }
        };
        self.next = at + 1;
        self.all.get_mut(at)
    }

    /// The names of the fields.
    pub(crate) fn names(&self) -> impl Iterator<Item = &str> {
        self.all.iter().map(|field| &*field.name)
    }

    pub(crate) fn into_iter(self) -> impl Iterator<Item = Field> {
        self.all.into_iter()
    }
}

/// The values of a field that is not an outcome.
#[derive(Debug)]
pub(crate) struct Field {
    pub(crate) name: Arc<str>,
    /// The first row without a value.
    missing: Option<u64>,
    /// The row after the last row with a value.
    seen: u64,
    /// Number of rows with a value.
    pub(crate) values: u64,
    kind: FieldKind,
}

#[derive(Debug)]
enum FieldKind {
    /// No value yet.
    Nothing,
    /// Only integers so far.
    Integers { low: i128, high: i128 },
    /// Real numbers.
    Numbers { low: f64, high: f64 },
    /// Words.
    Words(BTreeSet<String>),
    /// Values that cannot be a parameter, with the reason.
    Other(Cow<'static, str>),
}

impl FieldKind {
    fn of(value: &Scalar) -> Self {
        match value {
            Scalar::Integer(n) => Self::Integers { low: (*n).into(), high: (*n).into() },
            Scalar::Unsigned(n) => Self::Integers { low: (*n).into(), high: (*n).into() },
            Scalar::Number(x) => Self::Numbers { low: *x, high: *x },
            Scalar::Text(text) => Self::Words(BTreeSet::from([text.clone()])),
            Scalar::Bool(_) => Self::Other("it contains truth values".into()),
            Scalar::Null | Scalar::Nested => Self::Other("it contains arrays or objects".into()),
        }
    }

    /// Adds one more value. Returns `false` if it has another kind than the earlier ones.
    fn take(&mut self, value: &Scalar) -> bool {
        match (&mut *self, value) {
            (Self::Nothing, value) => {
                *self = Self::of(value);
                true
            }
            (Self::Other(_), _) => true,
            (Self::Integers { low, high }, Scalar::Integer(n)) => {
                (*low, *high) = ((*low).min((*n).into()), (*high).max((*n).into()));
                true
            }
            (Self::Integers { low, high }, Scalar::Unsigned(n)) => {
                (*low, *high) = ((*low).min((*n).into()), (*high).max((*n).into()));
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
            (Self::Numbers { low, high }, Scalar::Unsigned(n)) => {
                (*low, *high) = (low.min(*n as f64), high.max(*n as f64));
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
                    *self = Self::Other("it has too many distinct words for a category".into());
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
        self.values += 1;
        self.kind.take(value)
    }

    /// The first of `rows` rows without a value.
    pub(crate) fn missing_of(&self, rows: u64) -> Option<u64> {
        self.missing.or((self.seen < rows).then_some(self.seen))
    }

    /// Whether every value is a number.
    pub(crate) fn is_numeric(&self) -> bool {
        matches!(self.kind, FieldKind::Integers { .. } | FieldKind::Numbers { .. })
    }

    /// The lowest and highest value, if all values are integers and an integer parameter cannot span them.
    pub(crate) fn wide_integers(&self) -> Option<(i128, i128)> {
        match self.kind {
            FieldKind::Integers { low, high } if high - low >= 1 << 32 || high > i64::MAX.into() => Some((low, high)),
            _ => None,
        }
    }

    /// The observed range as the domain of a parameter, or the reason why it cannot be one.
    pub(crate) fn domain(&self) -> Result<Domain, Cow<'static, str>> {
        self.domain_as(&self.name)
    }

    /// The observed range as the domain of a parameter with the name `name`.
    pub(crate) fn domain_as(&self, name: &str) -> Result<Domain, Cow<'static, str>> {
        let column = name.chars().all(|c| c.is_ascii_alphanumeric() || c == '_') && !name.is_empty();
        match &self.kind {
            FieldKind::Nothing => Err("it has no value".into()),
            FieldKind::Other(why) => Err(why.clone()),
            _ if !column => Err("its name must be letters, digits and underscores".into()),
            FieldKind::Integers { low, high } => match (i64::try_from(*low), i64::try_from(*high)) {
                (Ok(low), Ok(high)) => Ok(integers(low, high)),
                _ => Ok(continuous(*low as f64, *high as f64)),
            },
            FieldKind::Numbers { low, high } => Ok(continuous(*low, *high)),
            FieldKind::Words(words) => {
                Ok(Domain::Categorical { choices: words.iter().map(|word| word.as_str().into()).collect() })
            }
        }
    }
}

/// The domain of observed integers. A wide range is continuous, because an integer parameter must span less than 2^32.
pub(crate) fn integers(low: i64, high: i64) -> Domain {
    if high.abs_diff(low) < 1 << 32 { Domain::Integer { low, high } } else { continuous(low as f64, high as f64) }
}

/// The domain of observed numbers. A single value is widened to the next larger double.
pub(crate) fn continuous(low: f64, high: f64) -> Domain {
    let high = if low < high { high } else { low.next_up() };
    Domain::Continuous { low, high, scale: Scale::Linear }
}
