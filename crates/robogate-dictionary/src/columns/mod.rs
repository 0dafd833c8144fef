//! Conversion between entries and flat rows, for Parquet, CSV and JSON Lines.

mod fixed;
mod layout;

use std::borrow::Cow;
use std::collections::BTreeSet;
use std::ops::Range;
use std::sync::Arc;

use robogate_core::{
    Assignment, Contact, Domain, Episode, FailureMode, Fault, Measures, Outcome, ParameterSpace, Scenario, Seed,
    TaskSpec, Value, Word,
};

use fixed::{CLOSING, LABEL, LEADING, TRAILING};
pub use fixed::{FixedColumn, Kind, fixed_columns};
pub(crate) use layout::Layout;

use crate::codec::{FAULT_KINDS, Interner, integer_as_number, number_as_integer};
use crate::{DictionaryError, Entry, Label, Provenance};

/// One column.
#[derive(Debug, Clone)]
pub(crate) struct ColumnSpec {
    /// The name.
    pub(crate) name: String,
    /// The data type.
    pub(crate) kind: Kind,
    /// Whether every row has a value.
    pub(crate) required: bool,
    /// Whether the column has few distinct values.
    pub(crate) repeats: bool,
}

/// One value of a row.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum Cell<'a> {
    /// A missing value.
    Null,
    /// A value of a [`Kind::Number`] column.
    Number(f64),
    /// A value of a [`Kind::Integer`] column.
    Integer(i64),
    /// A value of a [`Kind::Count`] column.
    Count(u64),
    /// A value of a [`Kind::Text`] column.
    Text(Cow<'a, str>),
}

/// A cell that cannot be part of an entry.
#[derive(Debug)]
pub(crate) struct WrongCell {
    /// The column's name.
    pub(crate) column: String,
    /// The offending value.
    pub(crate) value: String,
    /// The problem.
    pub(crate) reason: String,
}

/// Prefix of the columns of applied values.
const APPLIED: &str = "applied_";

/// The columns of a dictionary of one task over one space.
#[derive(Debug, Clone)]
pub(crate) struct Columns {
    space: ParameterSpace,
    measures: Vec<Word>,
    /// The hidden draws, whose columns are last.
    draws: Vec<Word>,
    specs: Vec<ColumnSpec>,
    /// Whether a row may lack the value of a parameter, as an imported one may.
    gaps: bool,
}

/// Checks that no parameter, measure or draw of a task has the name of another column. This is known before the first episode, and
/// nothing could be recorded after it.
///
/// # Errors
/// With the first such name.
pub fn check_columns(task: &TaskSpec) -> Result<(), DictionaryError> {
    let parameters = task.parameters.iter().flat_map(|of| [of.name.to_string(), format!("{APPLIED}{}", of.name)]);
    let measures = task.measures.iter().map(|of| of.name.as_str().to_owned());
    let draws = task.draws.iter().map(|of| of.name.as_str().to_owned());
    let mut known: BTreeSet<String> = fixed_columns().map(|column| column.name.to_ascii_lowercase()).collect();
    match parameters.chain(measures).chain(draws).find(|name| !known.insert(name.to_ascii_lowercase())) {
        Some(column) => Err(DictionaryError::ColumnClash { column }),
        None => Ok(()),
    }
}

impl Columns {
    /// The columns of a dictionary with this provenance. The rows of an imported one may lack parameters.
    pub(crate) fn of_provenance(provenance: &Provenance) -> Result<Self, DictionaryError> {
        let mut columns = Self::of(&provenance.task, &provenance.space)?;
        columns.gaps = provenance.source.is_some();
        let requested = LEADING.len()..LEADING.len() + provenance.space.len();
        if columns.gaps {
            columns.specs[requested].iter_mut().for_each(|spec| spec.required = false);
        }
        Ok(columns)
    }

    /// The columns of `task` over `space`. Returns an error if a parameter or measure has
    /// the name of another column.
    pub(crate) fn of(task: &TaskSpec, space: &ParameterSpace) -> Result<Self, DictionaryError> {
        let spec = |name, kind, required, repeats| ColumnSpec { name, kind, required, repeats };
        let fixed = |column: &FixedColumn| spec(column.name.to_owned(), column.kind, column.required, column.repeats);
        let of_parameters = |prefix: &'static str, required| {
            space.parameters().iter().map(move |parameter| {
                let kind = match parameter.domain {
                    Domain::Continuous { .. } => Kind::Number,
                    Domain::Integer { .. } => Kind::Integer,
                    Domain::Categorical { .. } => Kind::Text,
                };
                spec(format!("{prefix}{}", parameter.name), kind, required, kind != Kind::Number)
            })
        };
        let measures: Vec<Word> = task.measures.iter().map(|measure| measure.name).collect();
        let of_measures = measures.iter().map(|name| spec(name.as_str().to_owned(), Kind::Number, false, false));
        let draws: Vec<Word> = task.draws.iter().map(|draw| draw.name).collect();
        let of_draws = draws.iter().map(|name| spec(name.as_str().to_owned(), Kind::Number, false, false));
        let specs: Vec<ColumnSpec> = LEADING
            .iter()
            .map(fixed)
            .chain(of_parameters("", true))
            .chain(of_parameters(APPLIED, false))
            .chain(TRAILING.iter().map(fixed))
            .chain(of_measures)
            .chain(CLOSING.iter().map(fixed))
            .chain(LABEL.iter().map(fixed))
            .chain(of_draws)
            .collect();
        // Case-insensitive readers (DuckDB) cannot distinguish `Mass` from `mass`.
        let mut names: Vec<(String, usize)> =
            specs.iter().enumerate().map(|(i, spec)| (spec.name.to_ascii_lowercase(), i)).collect();
        names.sort();
        if let Some(pair) = names.windows(2).find(|pair| pair[0].0 == pair[1].0) {
            let parameters = parameter_columns(space);
            let first_measure = parameters.end + TRAILING.len();
            let first_draw = specs.len() - draws.len();
            let chosen = |at: &usize| {
                parameters.contains(at)
                    || (first_measure..first_measure + measures.len()).contains(at)
                    || *at >= first_draw
            };
            let at = if chosen(&pair[0].1) { pair[0].1 } else { pair[1].1 };
            return Err(DictionaryError::ColumnClash { column: specs[at].name.clone() });
        }
        Ok(Self { space: space.clone(), measures, draws, specs, gaps: false })
    }

    /// The columns in order.
    pub(crate) fn specs(&self) -> &[ColumnSpec] {
        &self.specs
    }

    /// Positions of the columns of requested and applied parameters.
    pub(crate) fn parameters(&self) -> Range<usize> {
        parameter_columns(&self.space)
    }

    /// Writes `entry` as one cell per column.
    ///
    /// Values that do not fit their column are kept elsewhere or dropped: an applied value of another kind or name goes
    /// to `applied_other`, and a measure that is not finite becomes null.
    pub(crate) fn flatten<'a>(&self, entry: &'a Entry, cells: &mut Vec<Cell<'a>>) -> Result<(), DictionaryError> {
        entry.check()?;
        let Entry { stage, design, weight, label, episode } = entry;
        let Episode { scenario, applied, outcome, time_s, phase, contact, measures, draws, ticks, trajectory_hash } =
            episode;
        cells.clear();
        cells.extend([
            Cell::Count(scenario.index),
            text(stage),
            text(design),
            Cell::Number(*weight),
            Cell::Count(scenario.seed.campaign_number()),
        ]);
        self.flatten_requested(scenario, cells)?;
        self.flatten_applied(applied, cells);
        cells.push(text(outcome.as_str()));
        cells.push(failure_type(outcome).map_or(Cell::Null, text));
        match outcome {
            Outcome::Invalid(Fault { kind, detail }) => {
                cells.extend([Cell::Text(kind.to_string().into()), text(detail)]);
            }
            Outcome::Success | Outcome::Failure(_) => cells.extend([Cell::Null, Cell::Null]),
        }
        cells.push(number(Some(*time_s)));
        cells.push(phase.map_or(Cell::Null, |phase| text(phase.as_str())));
        match contact {
            Some(Contact { robot_body, other_body, force_n }) => {
                cells.extend([text(robot_body), text(other_body), number(Some(*force_n))]);
            }
            None => cells.extend([Cell::Null, Cell::Null, Cell::Null]),
        }
        cells.extend(self.measures.iter().map(|name| number(measures.get(name.as_str()))));
        cells.push(Cell::Count(u64::from(*ticks)));
        cells.push(Cell::Text(format!("{trajectory_hash:016x}").into()));
        let Label { case, category, group } = label;
        cells.extend([case, category, group].map(|word| word.as_deref().map_or(Cell::Null, text)));
        cells.extend(self.draws.iter().map(|name| number(draws.get(name.as_str()))));
        Ok(())
    }

    fn flatten_requested<'a>(&self, scenario: &'a Scenario, cells: &mut Vec<Cell<'a>>) -> Result<(), DictionaryError> {
        let index = scenario.index;
        let wrong = |parameter: &str, reason: String| DictionaryError::Parameter {
            index,
            parameter: parameter.to_owned(),
            reason,
        };
        let mut missing = 0;
        for parameter in self.space.parameters() {
            let name = &parameter.name;
            let Some(value) = scenario.requested.get(name) else {
                if self.gaps {
                    missing += 1;
                    cells.push(Cell::Null);
                    continue;
                }
                return Err(wrong(name, "is missing in the request".to_owned()));
            };
            let cell = fit(&parameter.domain, value).ok_or_else(|| {
                wrong(name, format!("is {value}. Expected {}, as defined by the space", kind_word(&parameter.domain)))
            })?;
            cells.push(cell);
        }
        if scenario.requested.len() + missing == self.space.len() {
            return Ok(());
        }
        let stray = scenario.requested.iter().map(|(name, _)| name).find(|name| self.space.position(name).is_none());
        Err(wrong(stray.unwrap_or("?"), "was requested, but the space does not have it".to_owned()))
    }

    fn flatten_applied<'a>(&self, applied: &'a Assignment, cells: &mut Vec<Cell<'a>>) {
        let start = cells.len();
        let parameters = self.space.parameters();
        cells.resize(start + parameters.len(), Cell::Null);
        let mut other: Vec<(&str, &str, String)> = Vec::new();
        for (name, value) in applied.iter() {
            let place = self.space.position(name).filter(|i| cells[start + i] == Cell::Null);
            match place.and_then(|i| Some((i, fit(&parameters[i].domain, value)?))) {
                Some((i, cell)) => cells[start + i] = cell,
                None => other.push(match value {
                    // The Debug format is the shortest text that parses to the same double, and supports NaN and inf.
                    Value::Number(x) => (name, "number", format!("{x:?}")),
                    Value::Integer(n) => (name, "integer", n.to_string()),
                    Value::Category(word) => (name, "category", word.to_string()),
                }),
            }
        }
        cells.push(match serde_json::to_string(&other) {
            Ok(json) if !other.is_empty() => Cell::Text(json.into()),
            _ => Cell::Null,
        });
    }

    /// Builds the entry of a row from one cell per column.
    pub(crate) fn unflatten(&self, cells: &[Cell<'_>], words: &mut Interner) -> Result<Entry, WrongCell> {
        let mut row = RowReader { specs: &self.specs, cells, at: 0 };
        let index = row.count()?;
        let stage = row.text()?.to_owned();
        let design = row.text()?.to_owned();
        let weight = row.number()?;
        let seed = Seed::campaign(row.count()?).episode(index);
        let mut assignment = || -> Result<Assignment, WrongCell> {
            let mut pairs = Vec::with_capacity(self.space.len());
            for parameter in self.space.parameters() {
                let value = match row.next() {
                    Cell::Null => continue,
                    Cell::Number(x) => Value::Number(*x),
                    Cell::Integer(n) => Value::Integer(*n),
                    Cell::Text(word) => Value::Category(words.get(word)),
                    Cell::Count(_) => return Err(row.wrong("is not a parameter's value")),
                };
                pairs.push((Arc::clone(&parameter.name), value));
            }
            Ok(pairs.into_iter().collect())
        };
        let requested = assignment()?;
        let mut applied = assignment()?;
        if let Some(json) = row.optional_text() {
            let other = parse_other(json).ok_or_else(|| row.wrong("is not a list of [name, kind, value]"))?;
            applied = applied.iter().map(|(name, value)| (words.get(name), value.clone())).chain(other).collect();
        }
        let outcome = outcome(&mut row)?;
        let time_s = row.optional_number().unwrap_or(f64::NAN);
        let phase = match row.optional_text() {
            None => None,
            Some(word) => Some(Word::new(word).map_err(|why| row.wrong(&why.to_string()))?),
        };
        let (robot_body, other_body, force_n) = (row.optional_text(), row.optional_text(), row.optional_number());
        let contact = match (robot_body, other_body, force_n) {
            (None, None, None) => None,
            (Some(robot), Some(other), force) => Some(Contact {
                robot_body: robot.to_owned(),
                other_body: other.to_owned(),
                force_n: force.unwrap_or(f64::NAN),
            }),
            _ => return Err(row.wrong("belongs to a contact that lacks one of its two bodies")),
        };
        let measures: Measures = self.measures.iter().map(|name| (*name, row.optional_number())).collect();
        let ticks = u32::try_from(row.count()?).map_err(|_| row.wrong("does not fit in 32 bits"))?;
        let hash = row.text()?;
        // `from_str_radix` alone would accept a sign and fewer digits.
        let trajectory_hash = u64::from_str_radix(hash, 16)
            .ok()
            .filter(|_| hash.len() == 16 && !hash.starts_with('+'))
            .ok_or_else(|| row.wrong("is not a hash of 16 hexadecimal digits"))?;
        let mut word = || row.optional_text().map(str::to_owned);
        let label = Label { case: word(), category: word(), group: word() };
        let draws: Measures = self.draws.iter().map(|name| (*name, row.optional_number())).collect();
        let scenario = Scenario { index, seed, requested };
        let episode =
            Episode { scenario, applied, outcome, time_s, phase, contact, measures, draws, ticks, trajectory_hash };
        Ok(Entry { stage, design, weight, label, episode })
    }
}

fn parameter_columns(space: &ParameterSpace) -> Range<usize> {
    LEADING.len()..LEADING.len() + 2 * space.len()
}

/// The text of the `failure_type` column. `None` for an invalid episode.
pub(crate) fn failure_type(outcome: &Outcome) -> Option<&'static str> {
    match outcome {
        Outcome::Success => Some("none"),
        Outcome::Failure(mode) => Some(mode.as_str()),
        Outcome::Invalid(_) => None,
    }
}

fn outcome(row: &mut RowReader<'_>) -> Result<Outcome, WrongCell> {
    let word = row.text()?;
    let invalid = word == "invalid";
    let mode = match word {
        "success" | "invalid" => None,
        _ => Some(FailureMode::new(word).map_err(|why| row.wrong(&why.to_string()))?),
    };
    let expected = if invalid { None } else { Some(mode.map_or("none", FailureMode::as_str)) };
    if row.optional_text() != expected {
        return Err(row.wrong(&format!("contradicts the outcome {word}")));
    }
    let kind = match row.optional_text() {
        None => None,
        Some(kind) => {
            let known = FAULT_KINDS.into_iter().find(|known| known.to_string() == kind);
            Some(known.ok_or_else(|| row.wrong("is not a class of fault"))?)
        }
    };
    if kind.is_some() != invalid {
        return Err(row.wrong(&format!("contradicts the outcome {word}")));
    }
    let detail = row.optional_text();
    match (kind, detail, mode) {
        (Some(kind), Some(detail), _) => Ok(Outcome::Invalid(Fault::new(kind, detail))),
        (None, None, Some(mode)) => Ok(Outcome::Failure(mode)),
        (None, None, None) => Ok(Outcome::Success),
        _ => Err(row.wrong(&format!("contradicts the outcome {word}"))),
    }
}

/// Reads the cells of one row in the order of the columns.
struct RowReader<'a> {
    specs: &'a [ColumnSpec],
    cells: &'a [Cell<'a>],
    at: usize,
}

impl<'a> RowReader<'a> {
    fn next(&mut self) -> &'a Cell<'a> {
        self.at += 1;
        self.cells.get(self.at - 1).unwrap_or(&Cell::Null)
    }

    fn count(&mut self) -> Result<u64, WrongCell> {
        match self.next() {
            Cell::Count(n) => Ok(*n),
            _ => Err(self.wrong("is not an integer of at least 0")),
        }
    }

    fn number(&mut self) -> Result<f64, WrongCell> {
        self.optional_number().ok_or_else(|| self.wrong("is not a number"))
    }

    fn text(&mut self) -> Result<&'a str, WrongCell> {
        self.optional_text().ok_or_else(|| self.wrong("is not a text"))
    }

    fn optional_number(&mut self) -> Option<f64> {
        match self.next() {
            Cell::Number(x) => Some(*x),
            _ => None,
        }
    }

    fn optional_text(&mut self) -> Option<&'a str> {
        match self.next() {
            Cell::Text(text) => Some(text),
            _ => None,
        }
    }

    /// An error about the last cell that was read.
    fn wrong(&self, reason: &str) -> WrongCell {
        let at = self.at.saturating_sub(1);
        let value = match self.cells.get(at) {
            None | Some(Cell::Null) => "a missing value".to_owned(),
            Some(Cell::Number(x)) => x.to_string(),
            Some(Cell::Integer(n)) => n.to_string(),
            Some(Cell::Count(n)) => n.to_string(),
            Some(Cell::Text(text)) => format!("`{text}`"),
        };
        let column = self.specs.get(at).map_or_else(String::new, |spec| spec.name.clone());
        WrongCell { column, value, reason: reason.to_owned() }
    }
}

fn text(text: &str) -> Cell<'_> {
    Cell::Text(Cow::Borrowed(text))
}

fn number(x: Option<f64>) -> Cell<'static> {
    x.filter(|x| x.is_finite()).map_or(Cell::Null, Cell::Number)
}

/// The value as a cell of a column of this domain, if the conversion is exact.
fn fit<'a>(domain: &Domain, value: &'a Value) -> Option<Cell<'a>> {
    match (domain, value) {
        (Domain::Continuous { .. }, Value::Number(x)) if x.is_finite() => Some(Cell::Number(*x)),
        (Domain::Continuous { .. }, Value::Integer(n)) => integer_as_number(*n).map(Cell::Number),
        (Domain::Integer { .. }, Value::Integer(n)) => Some(Cell::Integer(*n)),
        (Domain::Integer { .. }, Value::Number(x)) => number_as_integer(*x).map(Cell::Integer),
        (Domain::Categorical { .. }, Value::Category(word)) => Some(text(word)),
        _ => None,
    }
}

fn kind_word(domain: &Domain) -> &'static str {
    match domain {
        Domain::Continuous { .. } => "a finite real number",
        Domain::Integer { .. } => "an integer",
        Domain::Categorical { .. } => "a word",
    }
}

fn parse_other(json: &str) -> Option<Vec<(Arc<str>, Value)>> {
    let other: Vec<(String, String, String)> = serde_json::from_str(json).ok()?;
    other
        .into_iter()
        .map(|(name, kind, value)| {
            let value = match kind.as_str() {
                "number" => Value::Number(value.parse().ok()?),
                "integer" => Value::Integer(value.parse().ok()?),
                "category" => Value::Category(value.into()),
                _ => return None,
            };
            Some((name.into(), value))
        })
        .collect()
}
