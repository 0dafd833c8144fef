//! Rows of other tools before their fields are interpreted.

use std::cell::Cell;
use std::fs::File;
use std::io::{self, Read};
use std::path::Path;
use std::rc::Rc;
use std::sync::Arc;

use serde::de::{DeserializeSeed, Deserializer, Error, IgnoredAny, MapAccess, SeqAccess, Visitor};
use sha2::{Digest, Sha256};

use crate::codec::Interner;
use crate::hash::hex;
use crate::{DictionaryError, RowPlace};

/// Maximum number of fields per row. Each can become two columns.
pub(crate) const MOST_FIELDS: usize = 1000;

/// Maximum number of failure modes per file. More would be descriptions of single episodes.
pub(crate) const MOST_MODES: usize = 1000;

/// One value of a row.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum Scalar {
    Null,
    Bool(bool),
    Integer(i64),
    /// An integer above the range of [`Self::Integer`].
    Unsigned(u64),
    Number(f64),
    Text(String),
    /// An array or object.
    Nested,
}

impl Scalar {
    /// The integer without loss.
    pub(crate) fn unsigned(n: u64) -> Self {
        i64::try_from(n).map_or(Self::Unsigned(n), Self::Integer)
    }

    /// The value as shown in an error message.
    pub(crate) fn show(&self) -> String {
        match self {
            Self::Null => "a missing value".to_owned(),
            Self::Bool(value) => value.to_string(),
            Self::Integer(n) => n.to_string(),
            Self::Unsigned(n) => n.to_string(),
            Self::Number(x) => x.to_string(),
            Self::Text(text) => format!("`{text}`"),
            Self::Nested => "an array or object".to_owned(),
        }
    }
}

/// The fields of one row, in the order of the file.
#[derive(Debug, Default)]
pub(crate) struct RawRow {
    pub(crate) number: u64,
    /// The line of a text file, from 1.
    pub(crate) line: Option<u64>,
    pub(crate) fields: Vec<(Arc<str>, Scalar)>,
    /// Where the last search ended. Fields are mostly read in order, and a row may have a thousand of them.
    next: Cell<usize>,
}

impl RawRow {
    pub(crate) fn get(&self, name: &str) -> Option<&Scalar> {
        let is_it = |(field, _): &&(Arc<str>, Scalar)| &**field == name;
        if let Some((_, value)) = self.fields.get(self.next.get()).filter(is_it) {
            self.next.set(self.next.get() + 1);
            return Some(value);
        }
        let at = self.fields.iter().position(|field| is_it(&field))?;
        self.next.set(at + 1);
        self.fields.get(at).map(|(_, value)| value)
    }

    pub(crate) fn place(&self) -> RowPlace {
        self.line.map_or(RowPlace::Row(self.number), RowPlace::Line)
    }

    /// An error about a field of this row.
    pub(crate) fn wrong(&self, path: &Path, field: &str, reason: impl Into<String>) -> DictionaryError {
        DictionaryError::Value {
            path: path.to_owned(),
            place: self.place(),
            column: field.to_owned(),
            value: self.get(field).unwrap_or(&Scalar::Null).show(),
            reason: reason.into(),
        }
    }
}

/// Maximum bytes of JSON between two rows, which bounds memory for a file of any size.
pub(crate) const MOST_JSON: u64 = 16 << 20;

/// A file that is hashed while it is read. Reading fails if more than `most` bytes pass without a row, which bounds
/// memory for formats without a limit.
#[derive(Debug)]
pub(crate) struct Metered {
    inner: File,
    hash: Sha256,
    meter: Meter,
    most: u64,
}

/// The number of bytes read since the last row.
#[derive(Debug, Clone, Default)]
pub(crate) struct Meter(Rc<Cell<u64>>);

impl Meter {
    /// Resets the count after a row was read and its bytes were released.
    pub(crate) fn reset(&self) {
        self.0.set(0);
    }
}

impl Metered {
    pub(crate) fn open(path: &Path, most: u64) -> Result<Self, DictionaryError> {
        let inner = File::open(path).map_err(DictionaryError::io(path, "open"))?;
        Ok(Self { inner, hash: Sha256::new(), meter: Meter::default(), most })
    }

    pub(crate) fn meter(&self) -> Meter {
        self.meter.clone()
    }

    /// The hash of the bytes read so far, or of the whole file at its end.
    pub(crate) fn sha256(self) -> String {
        hex(&self.hash.finalize())
    }
}

impl Read for Metered {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let n = self.inner.read(buffer)?;
        self.hash.update(&buffer[..n]);
        let since = self.meter.0.get().saturating_add(n as u64);
        self.meter.0.set(since);
        if since > self.most {
            let reason = format!(
                "{} MiB without a row. Expected smaller rows: larger ones are rejected to bound memory",
                self.most >> 20
            );
            return Err(io::Error::new(io::ErrorKind::InvalidData, reason));
        }
        Ok(n)
    }
}

/// A field name, shared between rows.
pub(crate) struct Name<'a>(pub(crate) &'a mut Interner);

impl<'de> DeserializeSeed<'de> for Name<'_> {
    type Value = Arc<str>;

    fn deserialize<D: Deserializer<'de>>(self, deserializer: D) -> Result<Arc<str>, D::Error> {
        deserializer.deserialize_str(self)
    }
}

impl Visitor<'_> for Name<'_> {
    type Value = Arc<str>;

    fn expecting(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("a field's name")
    }

    fn visit_str<E: Error>(self, name: &str) -> Result<Arc<str>, E> {
        Ok(self.0.get(name))
    }
}

/// Any value. The content of an array or object is skipped.
pub(crate) struct AnyScalar;

impl<'de> DeserializeSeed<'de> for AnyScalar {
    type Value = Scalar;

    fn deserialize<D: Deserializer<'de>>(self, deserializer: D) -> Result<Scalar, D::Error> {
        deserializer.deserialize_any(self)
    }
}

impl<'de> Visitor<'de> for AnyScalar {
    type Value = Scalar;

    fn expecting(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("a value")
    }

    fn visit_unit<E: Error>(self) -> Result<Scalar, E> {
        Ok(Scalar::Null)
    }

    fn visit_bool<E: Error>(self, value: bool) -> Result<Scalar, E> {
        Ok(Scalar::Bool(value))
    }

    fn visit_i64<E: Error>(self, n: i64) -> Result<Scalar, E> {
        Ok(Scalar::Integer(n))
    }

    fn visit_u64<E: Error>(self, n: u64) -> Result<Scalar, E> {
        Ok(Scalar::unsigned(n))
    }

    fn visit_f64<E: Error>(self, x: f64) -> Result<Scalar, E> {
        Ok(Scalar::Number(x))
    }

    fn visit_str<E: Error>(self, text: &str) -> Result<Scalar, E> {
        Ok(Scalar::Text(text.to_owned()))
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut seq: A) -> Result<Scalar, A::Error> {
        while seq.next_element::<IgnoredAny>()?.is_some() {}
        Ok(Scalar::Nested)
    }

    fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<Scalar, A::Error> {
        while map.next_entry::<IgnoredAny, IgnoredAny>()?.is_some() {}
        Ok(Scalar::Nested)
    }
}
