//! Reads the aggregate JSON of vla-eval: `tasks`, each with its name and `episodes`.
//!
//! An episode has `metrics` (with `success`) and `steps`. After an infrastructure failure it has a `failure_reason`
//! (server_unreachable, connection_closed, timeout, env_start, env_step, model_act, exception) with a `failure_detail`.
//! Such an episode is invalid here. Its `elapsed_sec` is wall-clock time, not a cycle time.

use std::fmt;
use std::path::Path;

use serde::de::{DeserializeSeed, Deserializer, Error, IgnoredAny, MapAccess, Visitor};

use super::flat::{RowArray, Rows, Scalars, TaskArray, TaskObject, metadata};
use super::{Frame, Mapping, Sink};
use crate::DictionaryError;
use crate::raw::{AnyScalar, Scalar};

/// The number of steps is a measure. There are no parameters.
pub(super) fn mapping() -> Mapping {
    Mapping {
        parameters: Some(std::collections::BTreeMap::new()),
        ignore: vec!["elapsed_sec".to_owned(), "metrics.success".to_owned()],
        ..Mapping::default()
    }
}

pub(super) fn read(path: &Path, sink: Sink<'_>) -> Result<Frame, DictionaryError> {
    let mut frame = Frame::default();
    let mut found = false;
    frame.sha256 = Rows::read(path, sink, |rows, json| {
        json.deserialize_map(Whole { rows, metadata: &mut frame.metadata, found: &mut found })
    })?;
    if !found {
        let reason = "it has no `tasks`. Expected one entry for each task, as in the aggregate JSON of vla-eval";
        return Err(DictionaryError::results(path, reason));
    }
    let is_set =
        |key: &str| frame.metadata.get(key).is_some_and(|value| value != false && value != 0 && !value.is_null());
    if is_set("partial") || is_set("queue_unfinished") {
        frame.notes.push("The evaluation is not complete: some of its episodes were never run.".to_owned());
    }
    frame.notes.push("`elapsed_sec` is ignored: it is wall-clock time and not a cycle time.".to_owned());
    Ok(frame)
}

struct Whole<'a, 'b> {
    rows: &'a mut Rows<'b>,
    metadata: &'a mut serde_json::Map<String, serde_json::Value>,
    found: &'a mut bool,
}

impl<'de> Visitor<'de> for Whole<'_, '_> {
    type Value = ();

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("an object with `tasks`")
    }

    fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<(), A::Error> {
        // An aggregate has few unknown keys. Each one is kept in memory.
        const MOST_KEYS: usize = 1000;
        while let Some(key) = map.next_key::<String>()? {
            match key.as_str() {
                "tasks" if *self.found => return Err(A::Error::custom("`tasks` appears twice")),
                "tasks" => {
                    *self.found = true;
                    map.next_value_seed(TaskArray::<Task>::new(&mut *self.rows))?;
                }
                "server_info" => {
                    map.next_value_seed(OptionalScalars(&mut *self.metadata))?;
                }
                _ => {
                    if let Some(value) = metadata(map.next_value_seed(AnyScalar)?)
                        && self.metadata.len() < MOST_KEYS
                    {
                        self.metadata.insert(key, value);
                    }
                }
            }
        }
        Ok(())
    }
}

/// The scalars of an object, or null.
struct OptionalScalars<'a>(&'a mut serde_json::Map<String, serde_json::Value>);

impl<'de> DeserializeSeed<'de> for OptionalScalars<'_> {
    type Value = ();

    fn deserialize<D: Deserializer<'de>>(self, deserializer: D) -> Result<(), D::Error> {
        deserializer.deserialize_option(self)
    }
}

impl<'de> Visitor<'de> for OptionalScalars<'_> {
    type Value = ();

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("an object, or null")
    }

    fn visit_unit<E: Error>(self) -> Result<(), E> {
        Ok(())
    }

    fn visit_none<E: Error>(self) -> Result<(), E> {
        Ok(())
    }

    fn visit_some<D: Deserializer<'de>>(self, deserializer: D) -> Result<(), D::Error> {
        Scalars(self.0).deserialize(deserializer)
    }
}

/// A task of `tasks`.
enum Task {}

impl TaskObject for Task {
    const EXPECTED: &'static str = "a task with `task` and `episodes`";

    fn read<'de, A: MapAccess<'de>>(rows: &mut Rows<'_>, mut map: A) -> Result<(), A::Error> {
        let mut task: Option<String> = None;
        let mut found = false;
        while let Some(key) = map.next_key::<String>()? {
            match key.as_str() {
                "task" => task = Some(map.next_value()?),
                "episodes" => {
                    found = true;
                    // Rows are passed on immediately, so the task name must precede them.
                    let Some(task) = &task else {
                        return Err(A::Error::custom("a task has its `episodes` before its name `task`"));
                    };
                    map.next_value_seed(RowArray(&mut *rows, |rows: &mut Rows<'_>| complete(rows, task)))?;
                }
                _ => {
                    map.next_value::<IgnoredAny>()?;
                }
            }
        }
        if found { Ok(()) } else { Err(A::Error::custom("a task has no `episodes`")) }
    }
}

/// Adds the fields that every format has, unless the episode has them.
fn complete(rows: &mut Rows<'_>, task: &str) {
    let text = |name: &str| match rows.row.get(name) {
        Some(Scalar::Text(text)) if !text.is_empty() => Some(text.clone()),
        _ => None,
    };
    let error = text("failure_reason").map(|reason| match text("failure_detail") {
        Some(detail) => format!("{reason}: {detail}"),
        None => reason,
    });
    let given = [
        ("success", rows.row.get("metrics.success").cloned()),
        ("error", error.map(Scalar::Text)),
        ("case", Some(Scalar::Text(task.to_owned()))),
        ("category", text("suite").map(Scalar::Text)),
    ];
    for (name, value) in given {
        if let Some(value) = value
            && rows.row.get(name).is_none()
        {
            rows.push(name, value);
        }
    }
}
