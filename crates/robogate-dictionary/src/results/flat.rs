//! Flattens a JSON object to a row. Names of nested fields contain dots (`metrics.success`).

use std::fmt;
use std::io::{BufReader, Read};
use std::marker::PhantomData;
use std::path::Path;
use std::sync::Arc;

use serde::de::{DeserializeSeed, Deserializer, Error, IgnoredAny, MapAccess, SeqAccess, Visitor};

use super::Sink;
use crate::DictionaryError;
use crate::codec::Interner;
use crate::decode::Text;
use crate::raw::{MOST_FIELDS, MOST_JSON, Meter, RawRow, Scalar};

/// Adds the fields of one object to a row without clearing the row first.
pub(super) struct FlatRow<'a> {
    pub(super) row: &'a mut RawRow,
    pub(super) names: &'a mut Interner,
    /// The prefix of each name, including the dot.
    pub(super) prefix: &'a str,
}

impl<'de> DeserializeSeed<'de> for FlatRow<'_> {
    type Value = ();

    fn deserialize<D: Deserializer<'de>>(self, deserializer: D) -> Result<(), D::Error> {
        deserializer.deserialize_map(self)
    }
}

impl<'de> Visitor<'de> for FlatRow<'_> {
    type Value = ();

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "row {} as an object of fields", self.row.number)
    }

    fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<(), A::Error> {
        while let Some(key) = map.next_key::<String>()? {
            let name = if self.prefix.is_empty() { key } else { format!("{}{key}", self.prefix) };
            map.next_value_seed(OneField { row: &mut *self.row, names: &mut *self.names, name: &name })?;
        }
        Ok(())
    }
}

struct OneField<'a> {
    row: &'a mut RawRow,
    names: &'a mut Interner,
    name: &'a str,
}

impl OneField<'_> {
    fn push<E: Error>(self, value: Scalar) -> Result<(), E> {
        if self.row.get(self.name).is_some() {
            return Err(E::custom(format!("row {} has `{}` twice", self.row.number, self.name)));
        }
        if self.row.fields.len() == MOST_FIELDS {
            return Err(E::custom(format!("row {} has more than {MOST_FIELDS} fields", self.row.number)));
        }
        let name: Arc<str> = self.names.get(self.name);
        self.row.fields.push((name, value));
        Ok(())
    }
}

impl<'de> DeserializeSeed<'de> for OneField<'_> {
    type Value = ();

    fn deserialize<D: Deserializer<'de>>(self, deserializer: D) -> Result<(), D::Error> {
        deserializer.deserialize_any(self)
    }
}

impl<'de> Visitor<'de> for OneField<'_> {
    type Value = ();

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a value")
    }

    fn visit_unit<E: Error>(self) -> Result<(), E> {
        self.push(Scalar::Null)
    }

    fn visit_bool<E: Error>(self, value: bool) -> Result<(), E> {
        self.push(Scalar::Bool(value))
    }

    fn visit_i64<E: Error>(self, n: i64) -> Result<(), E> {
        self.push(Scalar::Integer(n))
    }

    fn visit_u64<E: Error>(self, n: u64) -> Result<(), E> {
        self.push(Scalar::unsigned(n))
    }

    fn visit_f64<E: Error>(self, x: f64) -> Result<(), E> {
        self.push(Scalar::Number(x))
    }

    fn visit_str<E: Error>(self, text: &str) -> Result<(), E> {
        self.push(Scalar::Text(text.to_owned()))
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut seq: A) -> Result<(), A::Error> {
        while seq.next_element::<IgnoredAny>()?.is_some() {}
        self.push(Scalar::Nested)
    }

    fn visit_map<A: MapAccess<'de>>(self, map: A) -> Result<(), A::Error> {
        // Names grow with depth. Longer ones cannot be columns.
        const LONGEST: usize = 200;
        if self.name.len() > LONGEST {
            return Err(A::Error::custom(format!("row {} is nested too deeply", self.row.number)));
        }
        let prefix = format!("{}.", self.name);
        FlatRow { row: self.row, names: self.names, prefix: &prefix }.visit_map(map)
    }
}

/// Rows read from a JSON document. Serde errors are text only, so a typed error is kept here.
pub(super) struct Rows<'a> {
    sink: Sink<'a>,
    meter: Meter,
    error: Option<DictionaryError>,
    pub(super) row: RawRow,
    pub(super) names: Interner,
}

impl<'a> Rows<'a> {
    /// Reads the JSON document `path`. `visit` reads it and passes on its rows. Returns the hash of the file.
    pub(super) fn read(
        path: &Path,
        sink: Sink<'a>,
        visit: impl FnOnce(&mut Self, &mut Json<'_>) -> Result<(), serde_json::Error>,
    ) -> Result<String, DictionaryError> {
        let mut text = Text::open_json(path, MOST_JSON)?;
        let mut rows =
            Self { sink, meter: text.meter(), error: None, row: RawRow::default(), names: Interner::default() };
        let reader: Box<dyn Read + '_> = Box::new(BufReader::with_capacity(1 << 16, &mut text));
        let mut json = serde_json::Deserializer::from_reader(reader);
        let parsed = visit(&mut rows, &mut json).and_then(|()| json.end());
        drop(json);
        match rows.error {
            Some(error) => Err(error),
            None => parsed.map_err(|source| DictionaryError::json(path, source)).map(|()| text.sha256()),
        }
    }

    /// Adds a field to the current row.
    pub(super) fn push(&mut self, name: &str, value: Scalar) {
        let name = self.names.get(name);
        self.row.fields.push((name, value));
    }

    /// Passes on the current row and starts the next one.
    pub(super) fn finish_row<E: Error>(&mut self) -> Result<(), E> {
        self.meter.reset();
        if let Err(error) = (self.sink)(&self.row) {
            self.error = Some(error);
            return Err(E::custom("a row was rejected"));
        }
        self.row.number += 1;
        self.row.fields.clear();
        Ok(())
    }
}

/// An array of objects, each of which becomes a row after `complete`.
pub(super) struct RowArray<'a, 'b, F>(pub(super) &'a mut Rows<'b>, pub(super) F);

impl<'de, F: FnMut(&mut Rows<'_>)> DeserializeSeed<'de> for RowArray<'_, '_, F> {
    type Value = ();

    fn deserialize<D: Deserializer<'de>>(self, deserializer: D) -> Result<(), D::Error> {
        deserializer.deserialize_seq(self)
    }
}

impl<'de, F: FnMut(&mut Rows<'_>)> Visitor<'de> for RowArray<'_, '_, F> {
    type Value = ();

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("an array of episodes")
    }

    fn visit_seq<A: SeqAccess<'de>>(mut self, mut seq: A) -> Result<(), A::Error> {
        loop {
            let Rows { row, names, .. } = &mut *self.0;
            if seq.next_element_seed(FlatRow { row, names, prefix: "" })?.is_none() {
                return Ok(());
            }
            (self.1)(self.0);
            self.0.finish_row()?;
        }
    }
}

/// An object of a task with several episodes.
pub(super) trait TaskObject {
    /// What the object is, for error messages.
    const EXPECTED: &'static str;

    /// Reads the fields and passes on the rows.
    fn read<'de, A: MapAccess<'de>>(rows: &mut Rows<'_>, map: A) -> Result<(), A::Error>;
}

/// An array of [`TaskObject`]s.
pub(super) struct TaskArray<'a, 'b, T>(&'a mut Rows<'b>, PhantomData<T>);

impl<'a, 'b, T> TaskArray<'a, 'b, T> {
    pub(super) fn new(rows: &'a mut Rows<'b>) -> Self {
        Self(rows, PhantomData)
    }
}

impl<'de, T: TaskObject> DeserializeSeed<'de> for TaskArray<'_, '_, T> {
    type Value = ();

    fn deserialize<D: Deserializer<'de>>(self, deserializer: D) -> Result<(), D::Error> {
        deserializer.deserialize_seq(self)
    }
}

impl<'de, T: TaskObject> Visitor<'de> for TaskArray<'_, '_, T> {
    type Value = ();

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("an array of tasks")
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut seq: A) -> Result<(), A::Error> {
        while seq.next_element_seed(OneTask::<T>(&mut *self.0, PhantomData))?.is_some() {}
        Ok(())
    }
}

struct OneTask<'a, 'b, T>(&'a mut Rows<'b>, PhantomData<T>);

impl<'de, T: TaskObject> DeserializeSeed<'de> for OneTask<'_, '_, T> {
    type Value = ();

    fn deserialize<D: Deserializer<'de>>(self, deserializer: D) -> Result<(), D::Error> {
        deserializer.deserialize_map(self)
    }
}

impl<'de, T: TaskObject> Visitor<'de> for OneTask<'_, '_, T> {
    type Value = ();

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(T::EXPECTED)
    }

    fn visit_map<A: MapAccess<'de>>(self, map: A) -> Result<(), A::Error> {
        T::read(self.0, map)
    }
}

/// The reader of a JSON document.
pub(super) type Json<'a> = serde_json::Deserializer<serde_json::de::IoRead<Box<dyn Read + 'a>>>;

/// Collects the scalars of an object as metadata with prefixed names. Arrays are omitted.
pub(super) struct Scalars<'a>(pub(super) &'a mut serde_json::Map<String, serde_json::Value>);

impl<'de> DeserializeSeed<'de> for Scalars<'_> {
    type Value = ();

    fn deserialize<D: Deserializer<'de>>(self, deserializer: D) -> Result<(), D::Error> {
        let mut row = RawRow::default();
        FlatRow { row: &mut row, names: &mut Interner::default(), prefix: "" }.deserialize(deserializer)?;
        for (name, value) in row.fields {
            if let Some(value) = metadata(value) {
                self.0.insert(name.to_string(), value);
            }
        }
        Ok(())
    }
}

/// A scalar as metadata. A long text is omitted.
pub(super) fn metadata(value: Scalar) -> Option<serde_json::Value> {
    const LONGEST: usize = 1000;
    Some(match value {
        Scalar::Bool(value) => value.into(),
        Scalar::Integer(n) => n.into(),
        Scalar::Unsigned(n) => n.into(),
        Scalar::Number(x) => x.into(),
        Scalar::Text(text) if text.len() <= LONGEST => text.into(),
        Scalar::Text(_) | Scalar::Null | Scalar::Nested => return None,
    })
}
