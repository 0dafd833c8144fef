//! The rows of a published file, one at a time.

use std::fs::File;
use std::io::{self, BufReader, Read};
use std::path::Path;
use std::sync::Arc;

use serde::de::{DeserializeSeed, Deserializer, Error, IgnoredAny, MapAccess, SeqAccess, Visitor};
use serde_json::Value as Json;
use sha2::{Digest, Sha256};

use crate::codec::Interner;
use crate::hash::hex;
use crate::{DictionaryError, Row};

/// More fields than this are no row of parameters; each would become two columns.
pub(super) const MOST_FIELDS: usize = 1000;

/// One value of a published row.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Scalar {
    Null,
    Bool(bool),
    Integer(i64),
    Number(f64),
    Text(String),
    /// An array or object.
    Nested,
}

impl Scalar {
    /// As an error message shows it.
    pub(super) fn show(&self) -> String {
        match self {
            Self::Null => "the missing value".to_owned(),
            Self::Bool(value) => value.to_string(),
            Self::Integer(n) => n.to_string(),
            Self::Number(x) => x.to_string(),
            Self::Text(text) => format!("`{text}`"),
            Self::Nested => "the array or object".to_owned(),
        }
    }
}

/// The fields of one row, in the order of the file.
#[derive(Debug, Default)]
pub(super) struct RawRow {
    pub(super) number: u64,
    pub(super) fields: Vec<(Arc<str>, Scalar)>,
}

impl RawRow {
    pub(super) fn get(&self, name: &str) -> Option<&Scalar> {
        self.fields.iter().find(|(field, _)| &**field == name).map(|(_, value)| value)
    }

    /// An error about a field of this row.
    pub(super) fn wrong(&self, path: &Path, field: &str, reason: impl Into<String>) -> DictionaryError {
        DictionaryError::Value {
            path: path.to_owned(),
            row: Row(self.number),
            column: field.to_owned(),
            value: self.get(field).unwrap_or(&Scalar::Null).show(),
            reason: reason.into(),
        }
    }
}

/// What stands around the rows.
#[derive(Debug)]
pub(super) struct Frame {
    pub(super) metadata: Json,
    pub(super) summary: Json,
    /// SHA-256 of the file.
    pub(super) sha256: String,
}

/// Reads the published file `path` and hands every row to `sink`.
pub(super) fn read(
    path: &Path,
    sink: &mut dyn FnMut(&RawRow) -> Result<(), DictionaryError>,
) -> Result<Frame, DictionaryError> {
    let file = File::open(path).map_err(DictionaryError::io(path, "open"))?;
    let mut reader = Hashed { inner: file, hash: Sha256::new() };
    let mut whole = Whole { sink, error: None, metadata: Json::Null, summary: Json::Null, experiments: false };
    let mut json = serde_json::Deserializer::from_reader(BufReader::with_capacity(1 << 16, &mut reader));
    let parsed = whole.deserialize(&mut json).and_then(|()| json.end());
    drop(json);
    if let Some(error) = whole.error {
        return Err(error);
    }
    parsed.map_err(|source| match source.io_error_kind() {
        Some(kind) => DictionaryError::io(path, "read")(kind.into()),
        None => DictionaryError::Json { path: path.to_owned(), source },
    })?;
    if !whole.experiments {
        return Err(DictionaryError::Published {
            path: path.to_owned(),
            reason: "it has no `experiments`\nhint: a summary alone cannot be imported; the rows are needed".to_owned(),
        });
    }
    let Whole { metadata, summary, .. } = whole;
    Ok(Frame { metadata, summary, sha256: hex(&reader.hash.finalize()) })
}

/// A reader that takes the hash of what goes through it.
struct Hashed<R> {
    inner: R,
    hash: Sha256,
}

impl<R: Read> Read for Hashed<R> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let n = self.inner.read(buffer)?;
        self.hash.update(&buffer[..n]);
        Ok(n)
    }
}

/// The outermost object. Serde's errors are text; a typed error of `sink` waits in `error`.
struct Whole<'a> {
    sink: &'a mut dyn FnMut(&RawRow) -> Result<(), DictionaryError>,
    error: Option<DictionaryError>,
    metadata: Json,
    summary: Json,
    experiments: bool,
}

impl<'de> DeserializeSeed<'de> for &mut Whole<'_> {
    type Value = ();

    fn deserialize<D: Deserializer<'de>>(self, deserializer: D) -> Result<(), D::Error> {
        deserializer.deserialize_map(self)
    }
}

impl<'de> Visitor<'de> for &mut Whole<'_> {
    type Value = ();

    fn expecting(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("an object with `metadata`, `summary` and `experiments`")
    }

    fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<(), A::Error> {
        while let Some(key) = map.next_key::<String>()? {
            match key.as_str() {
                "metadata" => self.metadata = map.next_value()?,
                "summary" => self.summary = map.next_value()?,
                "experiments" if self.experiments => return Err(A::Error::custom("`experiments` is there twice")),
                "experiments" => {
                    self.experiments = true;
                    map.next_value_seed(Rows(self))?;
                }
                _ => {
                    map.next_value::<IgnoredAny>()?;
                }
            }
        }
        Ok(())
    }
}

/// The array of rows.
struct Rows<'a, 'b>(&'a mut Whole<'b>);

impl<'de> DeserializeSeed<'de> for Rows<'_, '_> {
    type Value = ();

    fn deserialize<D: Deserializer<'de>>(self, deserializer: D) -> Result<(), D::Error> {
        deserializer.deserialize_seq(self)
    }
}

impl<'de> Visitor<'de> for Rows<'_, '_> {
    type Value = ();

    fn expecting(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("an array of rows")
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut seq: A) -> Result<(), A::Error> {
        let mut row = RawRow::default();
        let mut names = Interner::default();
        while seq.next_element_seed(OneRow { row: &mut row, names: &mut names })?.is_some() {
            if let Err(error) = (self.0.sink)(&row) {
                self.0.error = Some(error);
                return Err(A::Error::custom("a row was refused"));
            }
            row.number += 1;
        }
        Ok(())
    }
}

/// One flat object, into a row whose memory is used again.
struct OneRow<'a> {
    row: &'a mut RawRow,
    names: &'a mut Interner,
}

impl<'de> DeserializeSeed<'de> for OneRow<'_> {
    type Value = ();

    fn deserialize<D: Deserializer<'de>>(self, deserializer: D) -> Result<(), D::Error> {
        deserializer.deserialize_map(self)
    }
}

impl<'de> Visitor<'de> for OneRow<'_> {
    type Value = ();

    fn expecting(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "row {} as an object of fields", self.row.number)
    }

    fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<(), A::Error> {
        self.row.fields.clear();
        while let Some(name) = map.next_key_seed(Name(self.names))? {
            if self.row.get(&name).is_some() {
                return Err(A::Error::custom(format!("row {} has `{name}` twice", self.row.number)));
            }
            if self.row.fields.len() == MOST_FIELDS {
                return Err(A::Error::custom(format!("row {} has more than {MOST_FIELDS} fields", self.row.number)));
            }
            let value = map.next_value_seed(AnyScalar)?;
            self.row.fields.push((name, value));
        }
        Ok(())
    }
}

/// A field's name: one of a few, shared between rows.
struct Name<'a>(&'a mut Interner);

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

/// Any value; what is in an array or object is skipped.
struct AnyScalar;

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
        // Beyond 2^63 it is some identifier or a huge measure; as a number it keeps its size.
        Ok(i64::try_from(n).map_or(Scalar::Number(n as f64), Scalar::Integer))
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
