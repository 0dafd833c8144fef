//! The first pass: finds parameters and failure modes, and which quantities the source does not record.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;
use std::sync::Arc;

use robogate_core::{
    Assignment, Domain, FailureMode, MeasureSpec, Outcome, Parameter, ParameterSpace, TaskSpec, Value, Word,
};
use serde_json::json;

use super::names::{self, Suggested};
use super::outcome::{Ended, Results};
use super::plan::Plan;
use super::role::{FAILURE_TYPE, Role};
use super::{Format, Frame, Mapping, task};
use crate::columns::Columns;
use crate::fields::{Field, Fields};
use crate::provenance::SourceColumn;
use crate::raw::{MOST_FIELDS, MOST_MODES, RawRow, Scalar};
use crate::{DictionaryError, Engine, Provenance, Robot, SCHEMA_VERSION, Source, Tool, published};

/// The parameter that stores an environment's seed.
pub const SOURCE_SEED: &str = "source_seed";

/// The parameters that store the upper and lower 32 bits of seeds that need more than 32 bits.
pub(super) const SEED_PARTS: [&str; 2] = ["source_seed_high", "source_seed_low"];

/// The seed of an imported episode. One above the range of `i64` has its bits.
pub fn recorded_seed(requested: &Assignment) -> Option<i64> {
    let part = |name: &str| match requested.get(name) {
        Some(Value::Integer(n)) => Some(*n),
        _ => None,
    };
    part(SOURCE_SEED).or_else(|| Some(part(SEED_PARTS[0])? << 32 | part(SEED_PARTS[1])?))
}

/// The parameter that stores the number of an episode within its case, for sources that record no seed.
pub const SOURCE_EPISODE: &str = "source_episode";

/// The parameter that numbers the rows of a source without parameters, because a space needs at least one.
pub const SOURCE_ROW: &str = "source_row";

/// Whether a parameter of imported rows only identifies the episode, and is not one of its scenario.
pub fn only_identifies(parameter: &str) -> bool {
    [SOURCE_SEED, SOURCE_EPISODE, SOURCE_ROW].contains(&parameter) || SEED_PARTS.contains(&parameter)
}

/// Columns of the dictionary whose names a setting can have.
const SETTINGS: [&str; 3] = ["weight", "design", "stage"];

/// The column of a parameter (`None` for the row number) and the parameter.
type FromColumn = (Option<Arc<str>>, Parameter);

/// The results of the first pass.
pub(super) struct Survey<'a> {
    path: &'a Path,
    mapping: &'a Mapping,
    results: Results<'a>,
    rows: u64,
    /// Columns that can be parameters.
    fields: Fields,
    /// Columns that are measures.
    measures: Fields,
    /// Other columns in order of appearance, with their number of values.
    others: Vec<(Arc<str>, u64)>,
    modes: BTreeSet<FailureMode>,
    /// The use of each column by its name, computed once.
    uses: BTreeMap<Arc<str>, Use>,
    /// Whether the column of each role exists.
    roles: [bool; Role::ALL.len()],
    flags: Vec<FlagUse>,
    /// Whether the column [`FAILURE_TYPE`] exists.
    failure_type: bool,
    /// Whether any row names a failure mode.
    names_modes: bool,
    unknown_failures: u64,
    contradicted: u64,
    silent: u64,
    invalid: u64,
    invalid_by_error: u64,
    without_time: u64,
}

/// What a column can become.
#[derive(Debug, Clone, Copy)]
enum Use {
    Measure,
    Parameter,
    Other,
}

/// The use of a flag in the rows.
#[derive(Debug, Clone, Default)]
struct FlagUse {
    /// The column exists.
    present: bool,
    /// At least one row has a value.
    used: bool,
    /// At least one failure without a failure mode has no value.
    lacked_by_failure: bool,
    /// At least one success has no value.
    lacked_by_success: bool,
}

impl<'a> Survey<'a> {
    pub(super) fn new(path: &'a Path, mapping: &'a Mapping) -> Self {
        let results = Results::new(mapping);
        Self {
            path,
            mapping,
            flags: vec![FlagUse::default(); results.flags.len()],
            results,
            rows: 0,
            fields: Fields::default(),
            measures: Fields::default(),
            others: Vec::new(),
            modes: BTreeSet::new(),
            uses: BTreeMap::new(),
            roles: [false; Role::ALL.len()],
            failure_type: false,
            names_modes: false,
            unknown_failures: 0,
            contradicted: 0,
            silent: 0,
            invalid: 0,
            invalid_by_error: 0,
            without_time: 0,
        }
    }

    pub(super) fn row(&mut self, row: &RawRow) -> Result<(), DictionaryError> {
        for (present, role) in self.roles.iter_mut().zip(Role::ALL) {
            *present |= row.get(self.mapping.column(role)).is_some();
        }
        for (found, flag) in self.flags.iter_mut().zip(&self.results.flags) {
            found.present |= flag.column.as_deref().is_some_and(|column| row.get(column).is_some());
        }
        self.failure_type |= row.get(FAILURE_TYPE).is_some();
        self.names_modes |= self.results.names_mode(row);
        let ended = self.results.of(self.path, row)?;
        self.count(row, &ended)?;
        for (name, value) in &row.fields {
            self.take(row, name, value);
        }
        self.rows += 1;
        Ok(())
    }

    fn take(&mut self, row: &RawRow, name: &Arc<str>, value: &Scalar) {
        let present = *value != Scalar::Null;
        match self.use_of(name) {
            Use::Measure | Use::Parameter if !present => {}
            Use::Measure => {
                let truth = |truth: bool| Scalar::Integer(i64::from(truth));
                let value = if let Scalar::Bool(value) = value { &truth(*value) } else { value };
                self.measures.take_if_it_fits(row, name, value);
            }
            Use::Parameter => self.fields.take_if_it_fits(row, name, value),
            Use::Other => match self.others.iter().position(|(known, _)| known == name) {
                Some(at) => self.others[at].1 += u64::from(present),
                None if self.others.len() < MOST_FIELDS => self.others.push((Arc::clone(name), u64::from(present))),
                None => {}
            },
        }
    }

    fn use_of(&mut self, name: &Arc<str>) -> Use {
        if let Some(known) = self.uses.get(name) {
            return *known;
        }
        let found = if self.is_measure(name) {
            Use::Measure
        } else if self.may_be_parameter(name) {
            Use::Parameter
        } else {
            Use::Other
        };
        self.uses.insert(Arc::clone(name), found);
        found
    }

    /// Whether the column is a measure, by the mapping or by its name.
    fn is_measure(&self, name: &str) -> bool {
        self.mapping.names_measure(name)
            || (!self.has_role(name) && !self.mapping.names(name) && names::suggested(name) == Suggested::Measure)
    }

    /// Whether the column has a role, or indicates a failure mode.
    fn has_role(&self, name: &str) -> bool {
        let is_role = Role::ALL.into_iter().any(|role| self.mapping.column(role) == name);
        let is_flag = published::FLAGS.iter().any(|flag| flag.column == name);
        is_role || is_flag || self.results.has(name)
    }

    fn count(&mut self, row: &RawRow, ended: &Ended) -> Result<(), DictionaryError> {
        let invalid = matches!(ended.outcome, Outcome::Invalid(_));
        self.invalid += u64::from(invalid);
        self.invalid_by_error += u64::from(invalid && !ended.silent);
        self.silent += u64::from(ended.silent);
        self.contradicted += u64::from(ended.contradicted);
        self.unknown_failures += u64::from(!ended.kind_known);
        self.without_time += u64::from(!invalid && ended.time_s.is_none());
        for (found, value) in self.flags.iter_mut().zip(&ended.flags) {
            found.used |= value.is_some();
            found.lacked_by_success |= value.is_none() && ended.outcome == Outcome::Success;
            found.lacked_by_failure |= value.is_none() && !ended.kind_known;
        }
        if let Outcome::Failure(mode) = ended.outcome {
            self.modes.insert(mode);
            if self.modes.len() > MOST_MODES {
                let reason = format!(
                    "it has more than {MOST_MODES} different failure modes\nHint: map its words to fewer modes under \
                     [failure_modes] in a mapping"
                );
                return Err(DictionaryError::results(self.path, format!("{}: {reason}", row.place())));
            }
        }
        Ok(())
    }

    fn may_be_parameter(&self, name: &str) -> bool {
        if name == self.mapping.column(Role::Seed) || name == SOURCE_EPISODE {
            return true;
        }
        if self.mapping.parameters.is_some() {
            return self.mapping.names_parameter(name);
        }
        !self.has_role(name) && !self.mapping.ignores(name) && names::suggested(name) != Suggested::Identifier
    }

    /// Returns the space, the provenance, and the conversion from rows to entries.
    pub(super) fn plan(mut self, format: Format, frame: &Frame) -> Result<Plan<'a>, DictionaryError> {
        if self.rows == 0 {
            return Err(DictionaryError::results(self.path, "it has no episodes. Expected at least one row"));
        }
        self.check_columns()?;
        let mut notes = frame.notes.clone();
        let not_recorded = self.not_recorded(&mut notes);
        let mut roles = self.roles_of_others();
        let measures = self.measures(&mut roles);
        let mut task = task::of_rows(&self.mapping.about, self.declared_modes(&not_recorded), &[], Vec::new());
        task.measures = measures.iter().map(|(_, measure)| measure.clone()).collect();
        let named = frame.metadata.get("task").and_then(serde_json::Value::as_str).and_then(Word::nearest);
        task.name = self.mapping.about.task.or(named).unwrap_or(task.name);
        let (columns, parameters) = self.parameters(&task, &mut roles, &mut notes)?.into_iter().unzip();
        notes
            .push("Ranges are the observed ones, each row has weight 1, and the index is the row's number.".to_owned());
        notes
            .push("Engine, robot and policy are known by name at most: no hash identifies what was judged.".to_owned());
        let about = &self.mapping.about;
        let word = |given: &Option<String>, keys: &[&str]| {
            let found = keys.iter().find_map(|key| frame.metadata.get(*key)?.as_str());
            given.as_deref().or(found).unwrap_or("unknown").to_owned()
        };
        let provenance = Provenance {
            tool: Tool::robogate(),
            schema_version: SCHEMA_VERSION,
            build: None,
            engine: Engine {
                name: word(&about.simulator, &["benchmark", "environment_id"]),
                version: None,
                build_sha256: None,
            },
            task: Arc::new(task),
            robot: Robot { name: word(&about.robot, &["embodiment", "robot_type"]), sha256: None, dimensions: None },
            policy: word(&about.policy, &["model_server", "policy"]),
            world: None,
            space: ParameterSpace::new("imported", parameters)?,
            plan: json!({ "source_metadata": frame.metadata }),
            seed: frame.metadata.get("seed").and_then(serde_json::Value::as_u64).unwrap_or(0),
            question_sha256: None,
            platform: None,
            source: Some(Source {
                format: format.as_str().to_owned(),
                sha256: frame.sha256.clone(),
                notes,
                not_recorded,
                columns: roles,
                sampling: about.sampling,
                stopping: about.stopping,
            }),
        };
        // Rejected here, before any file is written.
        Columns::of_provenance(&provenance)?;
        let measures = measures.into_iter().map(|(column, measure)| (column, measure.name)).collect();
        Ok(Plan {
            path: self.path,
            mapping: self.mapping,
            results: self.results,
            provenance,
            columns,
            measures,
            format,
        })
    }

    /// The roles of the columns that are neither parameters nor measures.
    fn roles_of_others(&self) -> Vec<SourceColumn> {
        let role_of = |column: &str| {
            let ignored = self.mapping.ignores(column);
            let mut of_column = Role::ALL.into_iter().filter(|role| self.mapping.column(*role) == column);
            let role = of_column.find(|role| *role != Role::Policy || !ignored);
            let flag = self.results.flags.iter().find(|flag| flag.column.as_deref() == Some(column));
            match (role, flag) {
                (Some(role), _) => role.as_str().replace('_', " "),
                (None, Some(flag)) => format!("flag of {}", flag.mode),
                _ if self.results.has(column) => Role::FailureMode.as_str().replace('_', " "),
                _ if ignored => "not used, as requested".to_owned(),
                _ if names::suggested(column) == Suggested::Identifier => "identifier, not used".to_owned(),
                _ if self.mapping.parameters.is_some() => "not used: the mapping names all parameters".to_owned(),
                _ => "not used".to_owned(),
            }
        };
        let others = self.others.iter();
        others
            .map(|(column, values)| SourceColumn { column: column.to_string(), role: role_of(column), values: *values })
            .collect()
    }

    /// The measures, with their columns.
    fn measures(&mut self, roles: &mut Vec<SourceColumn>) -> Vec<(Arc<str>, MeasureSpec)> {
        let mut measures: Vec<(Arc<str>, MeasureSpec)> = Vec::new();
        for field in std::mem::take(&mut self.measures).into_iter() {
            let named = self.mapping.measures.iter().find(|(_, column)| **column == *field.name);
            let name = Word::nearest(named.map_or(&*field.name, |(name, _)| name));
            let taken = |name: &Word| {
                let same = |other: &str| other.eq_ignore_ascii_case(name.as_str());
                measures.iter().any(|(_, measure)| same(measure.name.as_str()))
                    || crate::fixed_columns().any(|column| same(column.name))
            };
            let role = match name {
                _ if !field.is_numeric() => "not used: a result that is not a number".to_owned(),
                None => "not used: its name has no letter or digit".to_owned(),
                Some(name) if taken(&name) => "not used: another column of the dictionary has its name".to_owned(),
                Some(name) => {
                    let (unit, better) = (names::unit(&field.name).to_owned(), names::better(&field.name));
                    measures
                        .push((Arc::clone(&field.name), MeasureSpec { name, unit, meaning: String::new(), better }));
                    format!("measure {name}")
                }
            };
            roles.push(SourceColumn { column: field.name.to_string(), role, values: field.values });
        }
        measures
    }

    /// Derives the parameters from the rows.
    fn parameters(
        &mut self,
        task: &TaskSpec,
        roles: &mut Vec<SourceColumn>,
        notes: &mut Vec<String>,
    ) -> Result<Vec<FromColumn>, DictionaryError> {
        let mut parameters: Vec<FromColumn> = Vec::new();
        let fields: Vec<Field> = std::mem::take(&mut self.fields).into_iter().collect();
        let known: BTreeSet<String> = fields.iter().map(|field| field.name.to_string()).collect();
        for field in fields {
            let name = match &self.mapping.parameters {
                _ if *field.name == *self.mapping.column(Role::Seed) => SOURCE_SEED,
                _ if *field.name == *SOURCE_EPISODE => SOURCE_EPISODE,
                Some(named) => named.iter().find(|(_, column)| **column == *field.name).map_or("", |(name, _)| name),
                None => &field.name,
            };
            if name == SOURCE_SEED
                && let Some((low, high)) = field.wide_integers()
                && (low >= 0 || high <= i64::MAX.into())
            {
                for part in SEED_PARTS {
                    let domain = Domain::Integer { low: 0, high: (1 << 32) - 1 };
                    parameters.push((Some(Arc::clone(&field.name)), Parameter { name: part.into(), domain }));
                }
                notes.push(format!(
                    "Seeds of 64 bits are kept in two parameters, `{}` and `{}`.",
                    SEED_PARTS[0], SEED_PARTS[1]
                ));
                let column = field.name.to_string();
                roles.push(SourceColumn { column, role: "seed".to_owned(), values: field.values });
                continue;
            }
            // A setting with the name of a column of the dictionary keeps it behind `source_`. The other names are those of results.
            let own = format!("source_{name}");
            let is_setting = self.mapping.parameters.is_none() && SETTINGS.contains(&name);
            let name = if is_setting && !known.contains(&own) { &own } else { name };
            // A spreadsheet names its columns with units and spaces.
            let taken = |name: &String| {
                known.contains(name) || parameters.iter().any(|(_, parameter)| *parameter.name == **name)
            };
            let spelled = names::as_parameter(name).filter(|spelled| !taken(spelled));
            let name = spelled.as_deref().unwrap_or(name);
            let domain = if self.mapping.parameters.is_some() && ![SOURCE_SEED, SOURCE_EPISODE].contains(&name) {
                Ok(self.required(&field, name)?)
            } else {
                optional(&field, name, task)
            };
            let identifies = [SOURCE_SEED, SOURCE_EPISODE].contains(&name);
            let role = match domain {
                Ok(domain) => {
                    let missing = self.rows - field.values;
                    if missing > 0 && !identifies {
                        notes.push(format!(
                            "Parameter `{name}`: {missing} of {} rows have no value. They are kept without it.",
                            self.rows
                        ));
                    }
                    parameters.push((Some(Arc::clone(&field.name)), Parameter { name: name.into(), domain }));
                    if name == SOURCE_SEED { "seed".to_owned() } else { format!("parameter {name}") }
                }
                Err(why) => {
                    notes.push(format!("Column `{}` is ignored: {why}.", field.name));
                    format!("not used: {why}")
                }
            };
            roles.push(SourceColumn { column: field.name.to_string(), role, values: field.values });
        }
        if let Some(named) = &self.mapping.parameters
            && let Some((name, column)) =
                named.iter().find(|(name, _)| parameters.iter().all(|(_, p)| *p.name != ***name))
        {
            let reason =
                format!("no row has the column `{column}`, which the mapping names for the parameter `{name}`");
            return Err(DictionaryError::results(self.path, reason));
        }
        if parameters.is_empty() {
            // Row numbers above 2^32 exceed the range of an integer parameter.
            let high = i64::try_from(self.rows - 1).unwrap_or(i64::MAX).min((1 << 32) - 1);
            let domain = Domain::Integer { low: 0, high };
            parameters.push((None, Parameter { name: SOURCE_ROW.into(), domain }));
            notes.push(format!("No column is a parameter: `{SOURCE_ROW}` numbers the episodes."));
        }
        Ok(parameters)
    }

    /// The domain of a parameter that the mapping names.
    fn required(&self, field: &Field, name: &str) -> Result<Domain, DictionaryError> {
        field.domain_as(name).map_err(|why| {
            let reason = format!("column `{}` cannot be the parameter `{name}`: {why}", field.name);
            DictionaryError::results(self.path, reason)
        })
    }

    /// Checks that the columns of the mapping exist and that a column determines the outcome.
    fn check_columns(&self) -> Result<(), DictionaryError> {
        let absent = |column: &str, what: &str| {
            let reason = format!("no row has the column `{column}`, which the mapping names for {what}");
            Err(DictionaryError::results(self.path, reason))
        };
        for (present, role) in self.roles.iter().zip(Role::ALL) {
            if !present && let Some(column) = self.mapping.roles.get(&role) {
                return absent(column, role.as_str());
            }
        }
        for (found, flag) in self.flags.iter().zip(&self.results.flags) {
            if !found.present
                && let Some(column) = self.mapping.flags.get(&flag.mode)
            {
                return absent(column, &format!("the flag of {}", flag.mode));
            }
        }
        let seen = |fields: &Fields, column: &str| fields.names().any(|name| name == column);
        for (name, column) in &self.mapping.measures {
            if !seen(&self.measures, column) {
                return absent(column, &format!("the measure `{name}`"));
            }
        }
        for (name, column) in self.mapping.parameters.iter().flatten() {
            if self.results.has(column) {
                let reason =
                    format!("column `{column}` determines the outcome, so it cannot be the parameter `{name}`");
                return Err(DictionaryError::results(self.path, reason));
            }
        }
        if self.silent == self.rows {
            let column = self.mapping.column(Role::Success);
            let exists = Role::ALL.iter().zip(self.roles).any(|(role, present)| present && *role == Role::Success);
            let absent = if exists { "" } else { ": there is no such column" };
            let others =
                self.fields.names().chain(self.measures.names()).chain(self.others.iter().map(|(name, _)| &**name));
            let others: Vec<&str> = others.take(12).collect();
            let reason = format!(
                "no row has an outcome in `{column}`{absent}. Other columns: {}\nHint: name the one with the outcome: --map success=COLUMN",
                if others.is_empty() { "none".to_owned() } else { others.join(", ").escape_debug().to_string() }
            );
            return Err(DictionaryError::results(self.path, reason));
        }
        Ok(())
    }

    /// The failure modes that the source can report: the ones in its rows, the targets of the mapping, and the ones
    /// with a recorded flag.
    fn declared_modes(&self, not_recorded: &[String]) -> Vec<FailureMode> {
        let mut modes: Vec<FailureMode> = self.modes.iter().copied().collect();
        let recorded =
            self.flags.iter().zip(&self.results.flags).filter(|(found, flag)| {
                found.used && !not_recorded.iter().any(|missing| missing == flag.mode.as_str())
            });
        let others = self.mapping.failure_modes.values().copied().chain(recorded.map(|(_, flag)| flag.mode));
        for mode in others {
            if !modes.contains(&mode) {
                modes.push(mode);
            }
        }
        modes
    }

    fn not_recorded(&self, notes: &mut Vec<String>) -> Vec<String> {
        // If failures are named by their mode, a success needs no flag.
        let lacks = |found: &FlagUse| found.lacked_by_failure || (!self.names_modes && found.lacked_by_success);
        let lacked = self.flags.iter().zip(&self.results.flags).filter(|(found, flag)| flag.expected && lacks(found));
        let lacked: BTreeSet<FailureMode> = lacked.map(|(_, flag)| flag.mode).collect();
        let mut not_recorded: Vec<String> = lacked.into_iter().map(|mode| mode.to_string()).collect();
        if self.failure_type
            && let Some(column) = self.mapping.roles.get(&Role::FailureMode)
            && column != FAILURE_TYPE
        {
            notes.push(format!(
                "Column `{FAILURE_TYPE}` is ignored: the mapping names `{column}` for the failure mode."
            ));
        }
        if self.unknown_failures > 0 {
            let (n, unknown) = (self.unknown_failures, FailureMode::UNKNOWN);
            notes.push(format!("Failures without a failure mode: {n}. They are recorded as `{unknown}`."));
        }
        if self.without_time > 0 {
            not_recorded.push("cycle_time_s".to_owned());
            notes.push(format!("Episodes without a cycle time: {}.", self.without_time));
        }
        if self.contradicted > 0 {
            notes.push(format!(
                "Episodes with success and the flag of a failure mode: {}. They are recorded as failures.",
                self.contradicted
            ));
        }
        if self.invalid > 0 {
            let (all, by_error) = (self.invalid, self.invalid_by_error);
            notes.push(format!(
                "Invalid episodes: {all}, of which {by_error} report an error and {} have no outcome.",
                all - by_error
            ));
        }
        notes.push(
            "The source has no applied parameters, phases, contacts, ticks and trajectory hashes. Ticks and hashes are 0."
                .to_owned(),
        );
        not_recorded
    }
}

/// The domain of a column that the mapping does not mention, or the reason why it is ignored.
fn optional(field: &Field, name: &str, task: &TaskSpec) -> Result<Domain, String> {
    let domain = field.domain_as(name)?;
    let parameter = Parameter { name: name.into(), domain: domain.clone() };
    let taken = ParameterSpace::new("one", vec![parameter]).is_ok_and(|space| Columns::of(task, &space).is_err());
    if taken { Err("another column of the dictionary has its name".to_owned()) } else { Ok(domain) }
}
