//! The first reading: which parameters there are, and what the source does not record.

use std::path::Path;
use std::sync::Arc;

use robogate_core::{Assignment, Domain, Episode, Measures, Outcome, Parameter, ParameterSpace, Scenario, Seed, Value};
use serde_json::json;

use super::mapping::{Mapping, Role};
use super::{Format, Frame, outcome};
use crate::codec::{EXACT_INTEGER, Interner};
use crate::columns::Columns;
use crate::fields::Fields;
use crate::raw::{RawRow, Scalar};
use crate::{DictionaryError, Engine, Entry, Label, Provenance, Robot, Row, SCHEMA_VERSION, Source, Tool};

/// The parameter that an environment's seed becomes.
pub const SOURCE_SEED: &str = "source_seed";

/// The parameter of a source that has none, counting its rows: a space must have one.
pub const SOURCE_ROW: &str = "source_row";

/// What the first reading finds out.
pub(super) struct Survey<'a> {
    path: &'a Path,
    mapping: &'a Mapping,
    rows: u64,
    fields: Fields,
    /// Which columns are there.
    present: [bool; Role::ALL.len()],
    /// Whether any row has a word in its failure mode.
    names_modes: bool,
    /// Which flags are lacked by a failure of which nothing else says the kind, or by a success.
    lacked_by_failure: [bool; outcome::FLAGS.len()],
    lacked_by_success: [bool; outcome::FLAGS.len()],
    failures_of_unknown_kind: u64,
    contradicted: u64,
    silent: u64,
    invalid: u64,
    without_time: u64,
}

impl<'a> Survey<'a> {
    pub(super) fn new(path: &'a Path, mapping: &'a Mapping) -> Self {
        Self {
            path,
            mapping,
            rows: 0,
            fields: Fields::default(),
            present: [false; Role::ALL.len()],
            names_modes: false,
            lacked_by_failure: [false; outcome::FLAGS.len()],
            lacked_by_success: [false; outcome::FLAGS.len()],
            failures_of_unknown_kind: 0,
            contradicted: 0,
            silent: 0,
            invalid: 0,
            without_time: 0,
        }
    }

    pub(super) fn row(&mut self, row: &RawRow) -> Result<(), DictionaryError> {
        for (present, role) in self.present.iter_mut().zip(Role::ALL) {
            *present |= row.get(self.mapping.column(role)).is_some();
        }
        let word = row.get(self.mapping.column(Role::FailureMode));
        self.names_modes |= word.is_some_and(|word| *word != Scalar::Null);
        let went = outcome::of(self.path, row, self.mapping)?;
        let lacked = match went.outcome {
            Outcome::Success => Some(&mut self.lacked_by_success),
            Outcome::Failure(_) if !went.kind_known => Some(&mut self.lacked_by_failure),
            _ => None,
        };
        for (lacked, lacks) in lacked.into_iter().flatten().zip(went.lacks) {
            *lacked |= lacks;
        }
        let invalid = matches!(went.outcome, Outcome::Invalid(_));
        self.invalid += u64::from(invalid);
        self.silent += u64::from(went.silent);
        self.contradicted += u64::from(went.contradicted);
        self.failures_of_unknown_kind += u64::from(!went.kind_known);
        self.without_time += u64::from(!invalid && went.time_s.is_none());
        for (name, value) in &row.fields {
            if *value != Scalar::Null && self.may_be_parameter(name) {
                self.fields.take_if_it_fits(row, name, value);
            }
        }
        self.rows += 1;
        Ok(())
    }

    fn may_be_parameter(&self, name: &str) -> bool {
        if name == self.mapping.column(Role::Seed) {
            return true;
        }
        match &self.mapping.parameters {
            Some(parameters) => parameters.values().any(|column| column == name),
            None => {
                !Role::ALL.into_iter().any(|role| self.mapping.column(role) == name)
                    && !self.mapping.ignore.iter().any(|ignored| ignored == name)
            }
        }
    }

    /// The space, the provenance, and how rows become entries.
    pub(super) fn plan(self, format: Format, frame: &Frame) -> Result<Plan<'a>, DictionaryError> {
        if self.rows == 0 {
            return Err(DictionaryError::results(self.path, "it has no episodes: nothing was evaluated"));
        }
        self.check_roles()?;
        let mut notes = frame.notes.clone();
        let not_recorded = self.not_recorded(&mut notes);
        let Self { path, mapping, rows, fields, .. } = self;
        let (mut columns, mut parameters): (Vec<Option<Arc<str>>>, Vec<Parameter>) = (Vec::new(), Vec::new());
        for field in fields.into_iter() {
            let ours = match &mapping.parameters {
                _ if *field.name == *mapping.column(Role::Seed) => SOURCE_SEED,
                Some(asked) => asked.iter().find(|(_, column)| **column == *field.name).map_or("", |(ours, _)| ours),
                None => &field.name,
            };
            let asked_for = mapping.parameters.is_some() && ours != SOURCE_SEED;
            let domain = match (field.missing_of(rows), field.domain_as(ours)) {
                (Some(row), _) if asked_for => {
                    return Err(DictionaryError::Value {
                        path: path.to_owned(),
                        row: Row(row),
                        column: field.name.to_string(),
                        value: "the missing value".to_owned(),
                        reason: format!(
                            "is there in other rows\nhint: every row must have the parameter `{ours}`; fill it in, or leave the column out"
                        ),
                    });
                }
                (Some(row), _) => Err(format!("{} lacks it", Row(row))),
                (None, Err(why)) if asked_for => {
                    let reason = format!("column `{}` cannot be the parameter `{ours}`: {why}", field.name);
                    return Err(DictionaryError::results(path, reason));
                }
                (None, Err(why)) => Err(why.to_owned()),
                (None, Ok(domain)) if taken(ours, &domain) => Err("its name is another column's here".to_owned()),
                (None, Ok(domain)) => Ok(domain),
            };
            match domain {
                Ok(domain) => {
                    parameters.push(Parameter { name: ours.into(), domain });
                    columns.push(Some(field.name));
                }
                Err(why) => notes.push(format!("column `{}` is no parameter: {why}", field.name)),
            }
        }
        if let Some(asked) = &mapping.parameters
            && let Some((ours, column)) = asked.iter().find(|(ours, _)| parameters.iter().all(|p| *p.name != ***ours))
        {
            let reason =
                format!("no row has the column `{column}`, which the mapping names for the parameter `{ours}`");
            return Err(DictionaryError::results(path, reason));
        }
        if parameters.is_empty() {
            // Row numbers beyond 2^32 are beyond what an integer parameter can span.
            let high = i64::try_from(rows - 1).unwrap_or(i64::MAX).min((1 << 32) - 1);
            let domain = Domain::Integer { low: 0, high };
            parameters.push(Parameter { name: SOURCE_ROW.into(), domain });
            columns.push(None);
            notes.push(format!("the source has no parameters: `{SOURCE_ROW}` counts its episodes"));
        }
        notes.push("ranges are the observed ones, each row has weight 1, and the index is the row's number".to_owned());
        notes.push(
            "engine, robot and policy are known by name at most: what made these episodes cannot be checked by a hash"
                .to_owned(),
        );
        let word = |given: &Option<String>, keys: &[&str]| {
            let found = keys.iter().find_map(|key| frame.metadata.get(*key)?.as_str());
            given.as_deref().or(found).unwrap_or("unknown").to_owned()
        };
        let provenance = Provenance {
            tool: Tool::robogate(),
            schema_version: SCHEMA_VERSION,
            engine: Engine { name: word(&mapping.about.simulator, &["benchmark"]), version: None, build_sha256: None },
            task: Arc::new(crate::v1::task()),
            robot: Robot { name: word(&mapping.about.robot, &[]), sha256: None, dimensions: None },
            policy: word(&mapping.about.policy, &["model_server"]),
            world: serde_json::Value::Null,
            space: ParameterSpace::new("imported", parameters)?,
            plan: json!({ "source_metadata": frame.metadata }),
            seed: frame.metadata.get("seed").and_then(serde_json::Value::as_u64).unwrap_or(0),
            platform: None,
            source: Some(Source {
                format: format.word().to_owned(),
                sha256: frame.sha256.clone(),
                notes,
                not_recorded,
            }),
        };
        // Refused here, before anything is written.
        Columns::of(&provenance.task, &provenance.space, SCHEMA_VERSION)?;
        Ok(Plan { path, mapping, provenance, columns, format })
    }

    /// A column that the user named must be there, and something must say how episodes went.
    fn check_roles(&self) -> Result<(), DictionaryError> {
        for (present, role) in self.present.iter().zip(Role::ALL) {
            if !present && let Some(column) = self.mapping.named(role) {
                let reason = format!("no row has the column `{column}`, which the mapping names for {}", role.word());
                return Err(DictionaryError::results(self.path, reason));
            }
        }
        if self.silent == self.rows {
            let reason = format!(
                "no row says in `{}` how its episode went\nhint: name the column, as in --map success=COLUMN",
                self.mapping.column(Role::Success)
            );
            return Err(DictionaryError::results(self.path, reason));
        }
        Ok(())
    }

    fn not_recorded(&self, notes: &mut Vec<String>) -> Vec<String> {
        let mut not_recorded = Vec::new();
        // In the order of the modes' own list. A success needs no flag where failures are named by their mode.
        for of in crate::v1::task().modes() {
            let lacked = outcome::FLAGS
                .iter()
                .position(|(mode, _)| *mode == of)
                .is_some_and(|at| self.lacked_by_failure[at] || (!self.names_modes && self.lacked_by_success[at]));
            if lacked {
                not_recorded.push(of.as_str().to_owned());
            }
        }
        if self.failures_of_unknown_kind > 0 {
            notes.push(format!(
                "{} failures do not say of what kind they are: they stand as timeout, not done when the episode ended",
                self.failures_of_unknown_kind
            ));
        }
        if self.without_time > 0 {
            not_recorded.push("cycle_time_s".to_owned());
            notes.push(format!("{} episodes have no cycle time", self.without_time));
        }
        if self.contradicted > 0 {
            notes.push(format!(
                "{} episodes say success beside a collision or a drop: they stand as that failure",
                self.contradicted
            ));
        }
        if self.invalid > 0 {
            let silent = self.silent;
            notes.push(format!(
                "{} episodes are invalid and no failures: an error is named in {}, the outcome is missing in {silent}",
                self.invalid,
                self.invalid - silent
            ));
        }
        notes.push(
            "applied parameters, phases, contacts, ticks and trajectory hashes are not in the source: ticks and hashes \
             are 0"
                .to_owned(),
        );
        not_recorded
    }
}

/// Whether a parameter of this name would take the name of another column.
fn taken(name: &str, domain: &Domain) -> bool {
    let parameter = Parameter { name: name.into(), domain: domain.clone() };
    ParameterSpace::new("one", vec![parameter])
        .is_ok_and(|space| Columns::of(&crate::v1::task(), &space, SCHEMA_VERSION).is_err())
}

/// How a row becomes an entry.
pub(super) struct Plan<'a> {
    path: &'a Path,
    mapping: &'a Mapping,
    provenance: Provenance,
    /// For each parameter its column; `None` for the row's number.
    columns: Vec<Option<Arc<str>>>,
    format: Format,
}

impl Plan<'_> {
    pub(super) fn provenance(&self) -> &Provenance {
        &self.provenance
    }

    pub(super) fn into_provenance(self) -> Provenance {
        self.provenance
    }

    pub(super) fn entry(&self, row: &RawRow, words: &mut Interner) -> Result<Entry, DictionaryError> {
        let index = row.number;
        let parameters = self.provenance.space.parameters().iter().zip(&self.columns);
        let requested = parameters
            .map(|(parameter, column)| {
                let value = match column {
                    None => Value::Integer(i64::try_from(index).unwrap_or(i64::MAX)),
                    Some(column) => self.value(row, column, &parameter.domain, words)?,
                };
                Ok((Arc::clone(&parameter.name), value))
            })
            .collect::<Result<Assignment, DictionaryError>>()?;
        let went = outcome::of(self.path, row, self.mapping)?;
        let episode = Episode {
            scenario: Scenario { index, seed: Seed::campaign(self.provenance.seed).episode(index), requested },
            applied: Assignment::default(),
            outcome: went.outcome,
            // Missing in the record.
            time_s: went.time_s.unwrap_or(f64::NAN),
            phase: None,
            contact: None,
            measures: Measures::default(),
            ticks: 0,
            trajectory_hash: 0,
        };
        let label = Label {
            case: self.word(row, Role::Case)?,
            category: self.word(row, Role::Category)?,
            group: self.word(row, Role::Group)?,
        };
        Ok(Entry { stage: "imported".to_owned(), design: self.format.word().to_owned(), weight: 1.0, label, episode })
    }

    /// A word of the label, where the row has one; a number is the word that it is written as.
    fn word(&self, row: &RawRow, role: Role) -> Result<Option<String>, DictionaryError> {
        let column = self.mapping.column(role);
        match row.get(column) {
            None | Some(Scalar::Null) => Ok(None),
            Some(Scalar::Text(word)) => Ok(Some(word.clone())),
            Some(Scalar::Integer(n)) => Ok(Some(n.to_string())),
            Some(_) => Err(row.wrong(self.path, column, format!("is no word, as a {} must be", role.word()))),
        }
    }

    fn value(
        &self,
        row: &RawRow,
        column: &str,
        domain: &Domain,
        words: &mut Interner,
    ) -> Result<Value, DictionaryError> {
        let wrong = |reason: &str| Err(row.wrong(self.path, column, reason));
        Ok(match (row.get(column), domain) {
            (Some(Scalar::Integer(n)), Domain::Continuous { .. })
                if n.unsigned_abs() > EXACT_INTEGER.unsigned_abs() =>
            {
                return wrong("has more digits than a real number keeps\nhint: name it under `ignore` in a mapping");
            }
            (Some(Scalar::Integer(n)), Domain::Continuous { .. }) => Value::Number(*n as f64),
            (Some(Scalar::Integer(n)), _) => Value::Integer(*n),
            (Some(Scalar::Number(x)), _) => Value::Number(*x),
            (Some(Scalar::Text(text)), _) => Value::Category(words.get(text)),
            _ => return wrong("is no parameter's value"),
        })
    }
}
