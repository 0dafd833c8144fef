//! Reads the evaluation log of Inspect Robots (schema version 1): `samples`, one for each scene, with one entry per trial in `epochs`,
//! `operator_judgements` and `termination_reasons`.
//!
//! The operator's judgement decides a trial, with the words that Inspect Robots accepts as a success. Without one, its own measures of
//! success do: `success_at_end`, then `reached_goal_state`. A trial that was not judged has no outcome, although the log
//! scores it with 0 (`operator`). A trial that ended with an error has no scores, and is invalid here.

use std::collections::BTreeMap;
use std::fmt;
use std::path::Path;

use serde::de::{Deserializer, Error, IgnoredAny, MapAccess, Visitor};
use serde_json::Value;

use super::flat::{FlatRow, Rows, Scalars, TaskArray, TaskObject};
use super::{Frame, SOURCE_EPISODE, Sink};
use crate::DictionaryError;
use crate::codec::Interner;
use crate::raw::{RawRow, Scalar};

/// The words that Inspect Robots reads as "the trial succeeded" (`is_affirmative_verdict`).
const SUCCESSES: [&str; 6] = ["success", "pass", "yes", "y", "1", "true"];
/// The score that repeats the operator's judgement. It is 0 for a trial without a judgement.
const OPERATOR: &str = "operator";
/// The scores that are a success of their own, the first one first.
const OWN: [&str; 2] = ["success_at_end", "reached_goal_state"];

pub(super) fn read(path: &Path, sink: Sink<'_>) -> Result<Frame, DictionaryError> {
    let mut frame = Frame::default();
    let mut found = false;
    frame.sha256 = Rows::read(path, sink, |rows, json| {
        json.deserialize_map(Whole { rows, metadata: &mut frame.metadata, found: &mut found })
    })?;
    if !found {
        return Err(DictionaryError::results(path, "it has no `samples`. Expected one entry for each scene"));
    }
    let version = frame.metadata.get("version").and_then(Value::as_u64);
    if version != Some(1) {
        let reason =
            format!("its schema version is {}. Expected 1", version.map_or("missing".to_owned(), |n| n.to_string()));
        return Err(DictionaryError::results(path, reason));
    }
    let simulated = frame.metadata.get("embodiment_info.is_simulated").and_then(Value::as_bool);
    if simulated == Some(false) {
        frame.metadata.entry("environment_id").or_insert_with(|| "real".into());
    }
    Ok(frame)
}

struct Whole<'a, 'b> {
    rows: &'a mut Rows<'b>,
    metadata: &'a mut serde_json::Map<String, Value>,
    found: &'a mut bool,
}

impl<'de> Visitor<'de> for Whole<'_, '_> {
    type Value = ();

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("an object with `samples`")
    }

    fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<(), A::Error> {
        while let Some(key) = map.next_key::<String>()? {
            match key.as_str() {
                "samples" if *self.found => return Err(A::Error::custom("`samples` appears twice")),
                "samples" => {
                    *self.found = true;
                    map.next_value_seed(TaskArray::<Scene>::new(&mut *self.rows))?;
                }
                "eval" => map.next_value_seed(Scalars(&mut *self.metadata))?,
                "version" => drop(self.metadata.insert(key, map.next_value()?)),
                _ => drop(map.next_value::<IgnoredAny>()?),
            }
        }
        Ok(())
    }
}

/// A scene of `samples`.
enum Scene {}

impl TaskObject for Scene {
    const EXPECTED: &'static str = "a scene with `scene_id` and `epochs`";

    fn read<'de, A: MapAccess<'de>>(rows: &mut Rows<'_>, mut map: A) -> Result<(), A::Error> {
        let (mut scene, mut epochs, mut error) = (None::<String>, None::<Vec<BTreeMap<String, Value>>>, None::<String>);
        let (mut judged, mut endings) = (Vec::<Option<String>>::new(), Vec::<Option<String>>::new());
        let mut properties = RawRow::default();
        while let Some(key) = map.next_key::<String>()? {
            // The meter of the file limits the number of values.
            match key.as_str() {
                "scene_id" => scene = Some(map.next_value()?),
                "epochs" => epochs = Some(map.next_value()?),
                "error" => error = map.next_value()?,
                "operator_judgements" => judged = map.next_value()?,
                "termination_reasons" => endings = map.next_value()?,
                "scene_metadata" => {
                    let row = &mut properties;
                    map.next_value_seed(FlatRow { row, names: &mut Interner::default(), prefix: "" })?;
                }
                _ => drop(map.next_value::<IgnoredAny>()?),
            }
        }
        let (Some(scene), Some(epochs)) = (scene, epochs) else {
            return Err(A::Error::custom("a scene of `samples` has no `scene_id` or no `epochs`"));
        };
        for (at, scores) in epochs.iter().enumerate() {
            let judgement = judged.get(at).and_then(Option::as_deref);
            let success = success(judgement, scores);
            rows.push("success", success.map_or(Scalar::Null, Scalar::Bool));
            rows.push("case", Scalar::Text(scene.clone()));
            rows.push(SOURCE_EPISODE, Scalar::Integer(at as i64));
            if scores.is_empty() {
                let why = error.as_deref().unwrap_or("the trial ended with an error");
                rows.push("error", Scalar::Text(why.to_owned()));
            }
            let ending = endings.get(at).and_then(Option::as_deref);
            if success == Some(false)
                && let Some(ending) = ending.filter(|ending| *ending != "success")
            {
                rows.push("failure_mode", Scalar::Text(ending.to_owned()));
            }
            for (name, value) in scores.iter().filter(|(name, _)| *name != OPERATOR) {
                rows.push(&format!("score_{name}"), value.as_f64().map_or(Scalar::Null, Scalar::Number));
            }
            for (name, value) in &properties.fields {
                if rows.row.get(name).is_none() {
                    rows.push(name, value.clone());
                }
            }
            rows.finish_row()?;
        }
        Ok(())
    }
}

/// The outcome of a trial. `None` if nothing judged it.
fn success(judgement: Option<&str>, scores: &BTreeMap<String, Value>) -> Option<bool> {
    if let Some(judgement) = judgement {
        return Some(SUCCESSES.contains(&judgement.trim().to_ascii_lowercase().as_str()));
    }
    let own = OWN.iter().find_map(|name| scores.get(*name));
    own.and_then(|value| value.as_bool().or_else(|| value.as_f64().map(|score| score > 0.5)))
}
