//! Reads the rows of a published file, one at a time.

use std::io::BufReader;
use std::path::Path;

use serde::de::{DeserializeSeed, Deserializer, Error, IgnoredAny, MapAccess, SeqAccess, Visitor};
use serde_json::Value as Json;

use crate::DictionaryError;
use crate::codec::Interner;
use crate::raw::{AnyScalar, MOST_FIELDS, MOST_JSON, Metered, Name, RawRow};

/// The content of the file except its rows.
#[derive(Debug)]
pub(super) struct Frame {
    pub(super) metadata: Json,
    pub(super) summary: Json,
    /// SHA-256 of the file.
    pub(super) sha256: String,
}

/// Reads the published file `path` and passes every row to `sink`.
pub(super) fn read(
    path: &Path,
    sink: &mut dyn FnMut(&RawRow) -> Result<(), DictionaryError>,
) -> Result<Frame, DictionaryError> {
    let mut reader = Metered::open(path, MOST_JSON)?;
    let meter = reader.meter();
    let mut sink = |row: &RawRow| {
        meter.reset();
        sink(row)
    };
    let mut whole =
        Whole { sink: &mut sink, error: None, metadata: Json::Null, summary: Json::Null, experiments: false };
    let mut json = serde_json::Deserializer::from_reader(BufReader::with_capacity(1 << 16, &mut reader));
    let parsed = whole.deserialize(&mut json).and_then(|()| json.end());
    drop(json);
    if let Some(error) = whole.error {
        return Err(error);
    }
    parsed.map_err(|source| DictionaryError::json(path, source))?;
    if !whole.experiments {
        return Err(DictionaryError::Published {
            path: path.to_owned(),
            reason: "it has no `experiments`. Expected an array of rows: a summary alone cannot be imported".to_owned(),
        });
    }
    let Whole { metadata, summary, .. } = whole;
    Ok(Frame { metadata, summary, sha256: reader.sha256() })
}

/// The outermost object. Serde errors are text only, so `error` keeps a typed error of `sink`.
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
                "experiments" if self.experiments => return Err(A::Error::custom("`experiments` appears twice")),
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
                return Err(A::Error::custom("a row was rejected"));
            }
            row.number += 1;
        }
        Ok(())
    }
}

/// One flat object. The memory of the row is reused.
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
