//! Import from the published JSON.

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;

use robogate_core::{
    Assignment, Domain, Episode, FailureMode, Outcome, Parameter, ParameterSpace, Scenario, Seed, Value,
};
use serde_json::json;

use super::rows::{self, Frame};
use super::{
    ANALYTIC, CYCLE_TIME, FAILURE_TYPE, FLAGS, PREFIX, SAMPLE, SUCCESS, TARGET_DISTANCE, TARGET_DISTANCE_HERE,
    name_here,
};
use crate::codec::{EXACT_INTEGER, Interner};
use crate::columns::Columns;
use crate::fields::Fields;
use crate::raw::{MOST_MODES, RawRow, Scalar};
use crate::{
    DictionaryError, DictionaryWriter, Engine, Entry, Label, Provenance, Robot, RowPlace, SCHEMA_VERSION, Source, Tool,
    Written, v1,
};

/// The result of an import.
#[derive(Debug, Clone, PartialEq)]
pub struct Imported {
    /// The written provenance. Its `source` lists decisions and omissions.
    pub provenance: Provenance,
    /// The rows.
    pub written: Written,
}

/// Imports the published file `from` as the dictionary `to`.
///
/// The file is read twice: once to derive the parameter space (observed ranges and words) and to check every row, and
/// once to write. If a row is invalid, no file is written. Each row has weight 1: rates apply to the distribution that
/// the rows were sampled from.
pub fn import(from: &Path, to: &Path) -> Result<Imported, DictionaryError> {
    let mut survey = Survey::default();
    let frame = rows::read(from, &mut |row| survey.row(from, row))?;
    survey.check_frame(from, &frame)?;
    let plan = survey.plan(from, &frame)?;
    let mut writer = DictionaryWriter::create(to, &plan.provenance)?;
    let mut words = Interner::default();
    let again = rows::read(from, &mut |row| writer.push(&plan.entry(from, row, &mut words)?))?;
    if again.sha256 != frame.sha256 {
        let reason = "it changed during the import\nHint: import it once it is complete".to_owned();
        return Err(DictionaryError::Published { path: from.to_owned(), reason });
    }
    let written = writer.finish()?;
    Ok(Imported { provenance: plan.provenance, written })
}

/// The results of the first pass.
#[derive(Default)]
struct Survey {
    rows: u64,
    successes: u64,
    failures: BTreeMap<FailureMode, u64>,
    flagged_later: u64,
    fields: Fields,
    /// The last sample index. `None` once an index is missing or does not increase.
    last_sample: Option<i64>,
    samples_rise: bool,
}

impl Survey {
    fn row(&mut self, path: &Path, row: &RawRow) -> Result<(), DictionaryError> {
        let outcome = outcome(path, row)?;
        cycle_time(path, row)?;
        target_distance(path, row)?;
        match outcome {
            Outcome::Success => self.successes += 1,
            Outcome::Failure(mode) => {
                *self.failures.entry(mode).or_default() += 1;
                if self.failures.len() > MOST_MODES {
                    return Err(row.wrong(
                        path,
                        FAILURE_TYPE,
                        format!("exceeds the limit of {MOST_MODES} failure modes per file"),
                    ));
                }
                let raised = FLAGS.iter().filter(|flag| row.get(flag.column) == Some(&Scalar::Bool(true))).count();
                let own = usize::from(flag_of(mode).is_some_and(|flag| row.get(flag).is_some()));
                self.flagged_later += u64::from(raised > own);
            }
            Outcome::Invalid(_) => {}
        }
        self.sample(row);
        for (name, value) in &row.fields {
            if !is_parameter(name) || *value == Scalar::Null {
                continue;
            }
            self.fields.take(path, row, name, value)?;
        }
        self.rows += 1;
        Ok(())
    }

    fn sample(&mut self, row: &RawRow) {
        let sample = match row.get(SAMPLE) {
            Some(Scalar::Integer(n)) if *n >= 0 => Some(*n),
            _ => None,
        };
        let rises = sample.is_some_and(|sample| self.last_sample.is_none_or(|last| last < sample));
        self.samples_rise = rises && (row.number == 0 || self.samples_rise);
        self.last_sample = sample;
    }

    /// Checks that the totals of the file match its rows.
    fn check_frame(&self, path: &Path, frame: &Frame) -> Result<(), DictionaryError> {
        let refuse = |reason: String| Err(DictionaryError::Published { path: path.to_owned(), reason });
        if self.rows == 0 {
            return refuse("its `experiments` array is empty. Expected at least one row".to_owned());
        }
        let failures = self.rows - self.successes;
        let whole = [
            ("metadata.total_experiments", &frame.metadata["total_experiments"], self.rows),
            ("summary.total", &frame.summary["total"], self.rows),
            ("summary.success_count", &frame.summary["success_count"], self.successes),
            ("summary.failure_count", &frame.summary["failure_count"], failures),
        ];
        let types = &frame.summary["failure_types"];
        let count = |name: &str| self.failures.iter().find(|(mode, _)| mode.as_str() == name).map_or(0, |(_, n)| *n);
        let by_mode =
            types.as_object().into_iter().flatten().map(|(name, claimed)| (name.as_str(), claimed, count(name)));
        for (name, claimed, found) in whole.into_iter().chain(by_mode) {
            if claimed.as_u64().is_some_and(|claimed| claimed != found) {
                return refuse(format!("its `{name}` is {claimed}, but its rows have {found}"));
            }
        }
        Ok(())
    }

    /// Returns the space, the provenance, and the conversion from rows to entries.
    fn plan(self, path: &Path, frame: &Frame) -> Result<Plan, DictionaryError> {
        let mut notes = Vec::new();
        let (mut fields, mut parameters) = (Vec::new(), Vec::new());
        let mut left_out: Vec<Arc<str>> = Vec::new();
        for field in self.fields.into_iter() {
            let missing = field.missing_of(self.rows);
            if ANALYTIC.contains(&&*field.name) {
                left_out.push(field.name);
                continue;
            }
            let domain = match field.domain() {
                Ok(domain) => domain,
                Err(why) => {
                    notes.push(format!("Field `{}` is ignored: {why}.", field.name));
                    continue;
                }
            };
            if let Some(row) = missing {
                return Err(DictionaryError::Value {
                    path: path.to_owned(),
                    place: RowPlace::Row(row),
                    column: field.name.to_string(),
                    value: "a missing value".to_owned(),
                    reason: "cannot be used. Expected a value in every row, because other rows have one".to_owned(),
                });
            }
            let here = free_name(&field.name);
            if here != name_here(&field.name) {
                notes.push(format!("Field `{}` is the parameter `{here}`: another column has its name.", field.name));
            }
            parameters.push(Parameter { name: here.into(), domain });
            fields.push(field.name);
        }
        for name in left_out {
            notes.push(format!("Field `{name}` is ignored: it comes from a formula and not from an episode."));
        }
        let space = ParameterSpace::new("imported", parameters)?;
        if !self.samples_rise {
            notes.push(format!("`{SAMPLE}` is missing in a row or does not rise: the index is the row's number."));
        }
        if self.flagged_later > 0 {
            let n = self.flagged_later;
            notes.push(format!("Failures with the flag of another failure: {n}. Only `{FAILURE_TYPE}` is kept."));
        }
        let seed = frame.metadata["seed"].as_u64();
        if seed.is_none() {
            notes.push("The campaign's seed is not known: 0 is used in its place.".to_owned());
        }
        notes.push(
            "The source has no applied parameters, phases, contacts, ticks and trajectory hashes. Ticks and hashes are 0."
                .to_owned(),
        );
        notes.push("Ranges are the observed ones, and each row has weight 1.".to_owned());
        let word = |key: &str| frame.metadata[key].as_str();
        let name = |keys: [&str; 2]| keys.into_iter().find_map(word).unwrap_or("unknown").to_owned();
        let provenance = Provenance {
            tool: Tool::robogate(),
            schema_version: SCHEMA_VERSION,
            build: None,
            engine: Engine { name: name(["simulator", "mode"]), version: None, build_sha256: None },
            task: Arc::new(v1::task()),
            robot: Robot { name: name(["robot", "robot_name"]), sha256: None, dimensions: None },
            policy: name(["policy", "controller"]),
            world: None,
            space,
            plan: json!({ "published_metadata": frame.metadata }),
            seed: seed.unwrap_or(0),
            question_sha256: None,
            platform: None,
            source: Some(Source {
                format: "published_json".to_owned(),
                sha256: frame.sha256.clone(),
                notes,
                not_recorded: Vec::new(),
                columns: Vec::new(),
                sampling: None,
                stopping: None,
            }),
        };
        // Rejected here, before any file is written.
        Columns::of(&provenance.task, &provenance.space)?;
        Ok(Plan { provenance, fields, by_sample: self.samples_rise })
    }
}

/// The parameter name for a published name, distinct from all other columns.
fn free_name(published: &str) -> String {
    let here = name_here(published);
    let parameter = |name: &str| Parameter { name: name.into(), domain: Domain::Integer { low: 0, high: 0 } };
    let clashes =
        ParameterSpace::new("one", vec![parameter(here)]).is_ok_and(|space| Columns::of(&v1::task(), &space).is_err());
    if clashes { format!("{PREFIX}{here}") } else { here.to_owned() }
}

fn is_parameter(name: &str) -> bool {
    ![SUCCESS, FAILURE_TYPE, CYCLE_TIME, TARGET_DISTANCE, SAMPLE].contains(&name)
        && FLAGS.iter().all(|flag| flag.column != name)
}

/// The conversion from rows to entries.
struct Plan {
    provenance: Provenance,
    /// The published names of the parameters, in the order of the space.
    fields: Vec<Arc<str>>,
    /// Whether the index is the sample's index or the row number.
    by_sample: bool,
}

impl Plan {
    fn entry(&self, path: &Path, row: &RawRow, words: &mut Interner) -> Result<Entry, DictionaryError> {
        let index = match row.get(SAMPLE) {
            Some(Scalar::Integer(n)) if self.by_sample => n.cast_unsigned(),
            _ => row.number,
        };
        let parameters = self.provenance.space.parameters().iter().zip(&self.fields);
        let requested = parameters
            .map(|(parameter, field)| {
                let value = match (row.get(field), &parameter.domain) {
                    (Some(Scalar::Integer(n)), Domain::Continuous { .. })
                        if n.unsigned_abs() > EXACT_INTEGER.unsigned_abs() =>
                    {
                        return Err(row.wrong(path, field, "has more digits than a double can represent"));
                    }
                    (Some(Scalar::Integer(n)), Domain::Continuous { .. }) => Value::Number(*n as f64),
                    (Some(Scalar::Integer(n)), _) => Value::Integer(*n),
                    (Some(Scalar::Number(x)), _) => Value::Number(*x),
                    (Some(Scalar::Text(text)), _) => Value::Category(words.get(text)),
                    _ => return Err(row.wrong(path, field, "cannot be the value of a parameter")),
                };
                Ok((Arc::clone(&parameter.name), value))
            })
            .collect::<Result<Assignment, _>>()?;
        let episode = Episode {
            scenario: Scenario { index, seed: Seed::campaign(self.provenance.seed).episode(index), requested },
            applied: Assignment::default(),
            outcome: outcome(path, row)?,
            time_s: cycle_time(path, row)?,
            phase: None,
            contact: None,
            measures: [(TARGET_DISTANCE_HERE, target_distance(path, row)?)].into_iter().collect(),
            draws: Default::default(),
            ticks: 0,
            trajectory_hash: 0,
        };
        Ok(Entry {
            stage: "imported".to_owned(),
            design: "published".to_owned(),
            weight: 1.0,
            label: Label::default(),
            episode,
        })
    }
}

/// The flag column of this failure mode.
fn flag_of(mode: FailureMode) -> Option<&'static str> {
    FLAGS.iter().find(|flag| flag.mode == mode).map(|flag| flag.column)
}

/// The outcome of the row's episode, from all of its fields.
fn outcome(path: &Path, row: &RawRow) -> Result<Outcome, DictionaryError> {
    let Some(Scalar::Bool(success)) = row.get(SUCCESS) else {
        return Err(row.wrong(path, SUCCESS, "is neither true nor false"));
    };
    let Some(Scalar::Text(word)) = row.get(FAILURE_TYPE) else {
        return Err(row.wrong(path, FAILURE_TYPE, "is not a word. Expected a failure mode or none"));
    };
    let outcome = match word.as_str() {
        "none" => Outcome::Success,
        word => Outcome::Failure(FailureMode::new(word).map_err(|why| row.wrong(path, FAILURE_TYPE, why.to_string()))?),
    };
    if (outcome == Outcome::Success) != *success {
        return Err(row.wrong(path, FAILURE_TYPE, format!("contradicts `{SUCCESS}`, which is {success}")));
    }
    let own = match &outcome {
        Outcome::Failure(mode) => flag_of(*mode),
        Outcome::Success | Outcome::Invalid(_) => None,
    };
    for flag in FLAGS.map(|flag| flag.column) {
        let contradicts = match row.get(flag) {
            None | Some(Scalar::Null) => false,
            Some(Scalar::Bool(raised)) => {
                if *success {
                    *raised
                } else {
                    own == Some(flag) && !raised
                }
            }
            Some(_) => return Err(row.wrong(path, flag, "is neither true nor false")),
        };
        if contradicts {
            return Err(row.wrong(path, flag, format!("contradicts `{FAILURE_TYPE}`, which is `{word}`")));
        }
    }
    Ok(outcome)
}

/// The row's cycle time, in seconds.
fn cycle_time(path: &Path, row: &RawRow) -> Result<f64, DictionaryError> {
    non_negative(path, row, CYCLE_TIME)?
        .ok_or_else(|| row.wrong(path, CYCLE_TIME, "is not a time. Expected a number of seconds in every row"))
}

/// The row's distance of the object from its target, in metres.
fn target_distance(path: &Path, row: &RawRow) -> Result<Option<f64>, DictionaryError> {
    non_negative(path, row, TARGET_DISTANCE)
}

fn non_negative(path: &Path, row: &RawRow, field: &str) -> Result<Option<f64>, DictionaryError> {
    let x = match row.get(field) {
        None | Some(Scalar::Null) => return Ok(None),
        Some(Scalar::Integer(n)) => *n as f64,
        Some(Scalar::Number(x)) => *x,
        Some(_) => return Err(row.wrong(path, field, "is not a number")),
    };
    if x < 0.0 { Err(row.wrong(path, field, "is negative. Expected 0 or more")) } else { Ok(Some(x)) }
}
