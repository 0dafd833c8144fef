//! Export to the published JSON.

use std::collections::BTreeMap;
use std::io::Write;

use robogate_core::{Assignment, Domain, FailureMode, Outcome, ParameterSpace, Scale, Value};
use serde::Serialize;
use serde::ser::{SerializeMap, Serializer};
use serde_json::{Map, Value as Json, json};

use super::{
    ANALYTIC, CYCLE_TIME, FAILURE_TYPE, FLAGS, Flag, SAMPLE, SUCCESS, TARGET_DISTANCE, TARGET_DISTANCE_HERE, name_there,
};
use crate::columns::failure_type;
use crate::export::write_error;
use crate::{Dictionary, DictionaryError, Entry};

/// Writes the dictionary in the published schema, one row per line. Returns the number of rows.
///
/// A failure mode that the task lists under another published mode is written as that one. The schema has no field for invalid episodes. They are omitted, and `metadata` gives their number. `metadata` also
/// states that `zone` and `fail_prob` are omitted. Parameters are the requested values.
pub fn export(dictionary: &Dictionary, mut out: impl Write) -> Result<u64, DictionaryError> {
    let mut counts = Counts::default();
    for entry in dictionary.entries() {
        counts.add(&published(dictionary, &entry?.episode.outcome));
    }
    let mut text = Vec::new();
    text.extend_from_slice(b"{\n\"metadata\": ");
    to_json(&mut text, &metadata(dictionary, &counts))?;
    text.extend_from_slice(b",\n\"summary\": ");
    to_json(&mut text, &counts.summary())?;
    text.extend_from_slice(b",\n\"experiments\": [");
    let task = &dictionary.provenance().task;
    let flags: Vec<&Flag> = FLAGS.iter().filter(|flag| task.declares(flag.mode)).collect();
    let mut rows = 0;
    for entry in dictionary.entries() {
        let entry = entry?;
        if matches!(entry.episode.outcome, Outcome::Invalid(_)) {
            continue;
        }
        text.extend_from_slice(if rows == 0 { b"\n" } else { b",\n" });
        let outcome = published(dictionary, &entry.episode.outcome);
        to_json(&mut text, &PublishedRow { entry: &entry, outcome, flags: &flags })?;
        rows += 1;
        if text.len() > 1 << 16 {
            out.write_all(&text).map_err(write_error)?;
            text.clear();
        }
    }
    text.extend_from_slice(b"\n]\n}\n");
    out.write_all(&text).and_then(|()| out.flush()).map_err(write_error)?;
    Ok(rows)
}

/// The outcome with the failure mode that published data has for it.
fn published(dictionary: &Dictionary, outcome: &Outcome) -> Outcome {
    match outcome {
        Outcome::Failure(mode) => Outcome::Failure(dictionary.provenance().task.published_mode(*mode)),
        other => other.clone(),
    }
}

fn to_json(text: &mut Vec<u8>, value: &impl Serialize) -> Result<(), DictionaryError> {
    serde_json::to_writer(text, value).map_err(|e| write_error(e.into()))
}

/// Counts of the outcomes.
#[derive(Default)]
struct Counts {
    successes: u64,
    failures: BTreeMap<FailureMode, u64>,
    invalid: u64,
}

impl Counts {
    fn add(&mut self, outcome: &Outcome) {
        match outcome {
            Outcome::Success => self.successes += 1,
            Outcome::Invalid(_) => self.invalid += 1,
            Outcome::Failure(mode) => *self.failures.entry(*mode).or_default() += 1,
        }
    }

    fn total(&self) -> u64 {
        self.successes + self.failures.values().sum::<u64>()
    }

    fn summary(&self) -> Json {
        let types: Map<String, Json> =
            self.failures.iter().map(|(mode, n)| (mode.as_str().to_owned(), (*n).into())).collect();
        let mut summary = json!({
            "total": self.total(),
            "success_count": self.successes,
            "failure_count": self.total() - self.successes,
            "failure_types": types,
        });
        // Without episodes there is no rate.
        if self.total() > 0 {
            summary["success_rate"] = (self.successes as f64 / self.total() as f64).into();
        }
        summary
    }
}

fn metadata(dictionary: &Dictionary, counts: &Counts) -> Json {
    let provenance = dictionary.provenance();
    json!({
        "robot": provenance.robot.name,
        "simulator": provenance.engine.name,
        "policy": provenance.policy,
        "seed": provenance.seed,
        "total_experiments": counts.total(),
        "parameter_space": parameter_space(&provenance.space),
        "exported_by": format!("{} {}", provenance.tool.name, provenance.tool.version),
        "dataset_hash": dictionary.dataset_hash(),
        "invalid_episodes_left_out": counts.invalid,
        "fields_left_out": ANALYTIC,
        "note": "Parameters are the requested ones. zone and fail_prob are left out: in the published dictionaries an \
                 analytic formula gives them. Rows of a boundary-focused stage do not represent the whole space: \
                 their importance weights are in the Parquet dictionary.",
    })
}

fn parameter_space(space: &ParameterSpace) -> Json {
    let parameters = space.parameters().iter().map(|parameter| {
        let domain = match &parameter.domain {
            Domain::Continuous { low, high, scale } => {
                let scale = match scale {
                    Scale::Linear => "linear",
                    Scale::Log => "log",
                };
                json!({ "low": low, "high": high, "scale": scale })
            }
            Domain::Integer { low, high } => json!({ "low": low, "high": high }),
            Domain::Categorical { choices } => json!(choices),
        };
        (name_there(&parameter.name).to_owned(), domain)
    });
    Json::Object(parameters.collect())
}

struct PublishedRow<'a> {
    entry: &'a Entry,
    /// The outcome, with its published failure mode.
    outcome: Outcome,
    /// The flags of the task's failure modes.
    flags: &'a [&'a Flag],
}

impl Serialize for PublishedRow<'_> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let episode = &self.entry.episode;
        let mut row = serializer.serialize_map(None)?;
        parameters(&mut row, &episode.scenario.requested)?;
        row.serialize_entry(SUCCESS, &(self.outcome == Outcome::Success))?;
        row.serialize_entry(FAILURE_TYPE, &failure_type(&self.outcome))?;
        row.serialize_entry(CYCLE_TIME, &episode.time_s)?;
        for flag in self.flags {
            row.serialize_entry(flag.column, &(self.outcome == Outcome::Failure(flag.mode)))?;
        }
        if let Some(distance) = episode.measures.get(TARGET_DISTANCE_HERE.as_str()) {
            row.serialize_entry(TARGET_DISTANCE, &distance)?;
        }
        row.serialize_entry(SAMPLE, &self.entry.index())?;
        row.end()
    }
}

fn parameters<M: SerializeMap>(row: &mut M, requested: &Assignment) -> Result<(), M::Error> {
    for (name, value) in requested.iter() {
        let name = name_there(name);
        match value {
            Value::Number(x) => row.serialize_entry(name, x)?,
            Value::Integer(n) => row.serialize_entry(name, n)?,
            Value::Category(word) => row.serialize_entry(name, word)?,
        }
    }
    Ok(())
}
