//! Episodes of one or several runs as columns of numbers, for the explorer.

use std::collections::HashMap;

use robogate_core::{Better, Domain, Outcome, Scale, Value};
use robogate_dictionary::{Entry, Provenance, results};
use serde::Serialize;

use crate::labels::{label_and_unit, mode_label};

/// Largest number of levels of a column. Further words share the last one.
const MAX_LEVELS: usize = 4_096;
/// The level of further words.
const OTHER: &str = "(other)";

/// Episodes of one or several runs. Every value is a 32-bit number, which has seven digits: enough for a picture and a
/// table, and half the memory. Words are indices of their levels. A missing value is NaN.
#[derive(Debug, Default)]
pub struct ExplorerTable {
    columns: Vec<ExplorerColumn>,
    rows: usize,
    /// The runs, with the columns of their parameters, measures and draws.
    runs: Vec<Run>,
}

/// A column of an [`ExplorerTable`].
#[derive(Debug, Clone, Serialize)]
pub struct ExplorerColumn {
    /// The name in the dictionary.
    pub name: String,
    /// The name for a person, without the unit.
    pub label: String,
    /// The unit. It may be empty.
    pub unit: String,
    /// The meaning of its values.
    pub role: Role,
    /// The type of its values.
    pub kind: ValueKind,
    /// Whether the values are uniform on a logarithmic scale.
    pub log: bool,
    /// The declared range of a parameter.
    pub range: Option<[f64; 2]>,
    /// Whether smaller or larger values are better.
    pub better: Better,
    /// The words of a [`ValueKind::Category`].
    pub levels: Vec<String>,
    #[serde(skip)]
    values: Vec<f32>,
    #[serde(skip)]
    known: HashMap<String, usize>,
}

/// The meaning of a column.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Role {
    /// The run of the episode.
    Run,
    /// The index of the episode in its run.
    Index,
    /// The stage of the campaign.
    Stage,
    /// How the episode ended: `success`, `invalid`, or a failure mode.
    Outcome,
    /// A requested value of a parameter.
    Parameter,
    /// A measure of the task, or the duration.
    Measure,
    /// A hidden draw.
    Draw,
    /// The scenario of a suite that the episode belongs to.
    Scenario,
    /// The importance weight.
    Weight,
}

/// The type of the values of a column.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum ValueKind {
    /// Real numbers.
    Number,
    /// Integers.
    Integer,
    /// Words.
    Category,
}

#[derive(Debug)]
struct Run {
    /// The level of the run.
    code: f32,
    parameters: Vec<(String, usize)>,
    measures: Vec<(String, usize)>,
    draws: Vec<(String, usize)>,
}

/// The columns that every table has, in order.
mod fixed {
    pub(super) const RUN: usize = 0;
    pub(super) const INDEX: usize = 1;
    pub(super) const STAGE: usize = 2;
    pub(super) const OUTCOME: usize = 3;
    pub(super) const TIME: usize = 4;
    pub(super) const WEIGHT: usize = 5;
    pub(super) const CATEGORY: usize = 6;
    pub(super) const GROUP: usize = 7;
    pub(super) const CASE: usize = 8;
}

impl ExplorerTable {
    /// An empty table.
    pub fn new() -> Self {
        let mut table = Self::default();
        let word = |name: &str, role| ExplorerColumn::new(name, name.replace('_', " "), role, ValueKind::Category);
        let fixed = [
            word("run", Role::Run),
            ExplorerColumn::new("index", "episode".to_owned(), Role::Index, ValueKind::Integer),
            word("stage", Role::Stage),
            word("outcome", Role::Outcome),
            ExplorerColumn {
                unit: "s".to_owned(),
                ..ExplorerColumn::new("cycle_time_s", "cycle time".to_owned(), Role::Measure, ValueKind::Number)
            },
            ExplorerColumn::new("weight", "weight".to_owned(), Role::Weight, ValueKind::Number),
            word("category", Role::Scenario),
            word("group", Role::Scenario),
            word("case", Role::Scenario),
        ];
        table.columns.extend(fixed);
        table.columns[fixed::OUTCOME].level("success");
        table
    }

    /// Adds a run with this name, and the columns that it needs. Returns its number for [`Self::push`]. Runs share columns
    /// of the same name and type.
    pub fn add_run(&mut self, name: &str, provenance: &Provenance) -> usize {
        let code = self.columns[fixed::RUN].level(name) as f32;
        for mode in provenance.task.modes() {
            self.columns[fixed::OUTCOME].level(mode.as_str());
        }
        // Identifiers of imported rows are not parameters of the scenario.
        let identifiers = [results::SOURCE_ROW, results::SOURCE_SEED, results::SOURCE_EPISODE];
        let parameters = provenance.space.parameters().iter().filter(|p| !identifiers.contains(&&*p.name));
        let parameters = parameters.map(|parameter| {
            let (label, unit) = label_and_unit(&parameter.name);
            let declared = provenance.task.parameter(&parameter.name).map(|spec| spec.unit.clone());
            let unit = if unit.is_empty() { declared.unwrap_or_default() } else { unit.to_owned() };
            let mut column = ExplorerColumn {
                unit,
                ..ExplorerColumn::new(&parameter.name, label, Role::Parameter, ValueKind::Number)
            };
            match &parameter.domain {
                Domain::Continuous { low, high, scale } => {
                    column.log = *scale == Scale::Log;
                    column.range = Some([*low, *high]);
                }
                Domain::Integer { low, high } => {
                    column.kind = ValueKind::Integer;
                    column.range = Some([*low as f64, *high as f64]);
                }
                Domain::Categorical { choices } => {
                    column.kind = ValueKind::Category;
                    for choice in choices {
                        column.level(choice);
                    }
                }
            }
            (parameter.name.to_string(), column)
        });
        let parameters: Vec<_> = parameters.collect();
        let number = |name: &str, unit: &str, role, better| {
            let (label, _) = label_and_unit(name);
            ExplorerColumn {
                unit: unit.to_owned(),
                better,
                ..ExplorerColumn::new(name, label, role, ValueKind::Number)
            }
        };
        let measures =
            provenance.task.measures.iter().map(|spec| {
                (spec.name.to_string(), number(spec.name.as_str(), &spec.unit, Role::Measure, spec.better))
            });
        let measures: Vec<_> = measures.collect();
        let draws =
            provenance.task.draws.iter().map(|spec| {
                (spec.name.to_string(), number(spec.name.as_str(), &spec.unit, Role::Draw, Better::Neither))
            });
        let draws: Vec<_> = draws.collect();
        let mut places = |columns: Vec<(String, ExplorerColumn)>| -> Vec<(String, usize)> {
            columns.into_iter().map(|(name, column)| (name, self.place(column))).collect()
        };
        let run = Run { code, parameters: places(parameters), measures: places(measures), draws: places(draws) };
        self.runs.push(run);
        self.runs.len() - 1
    }

    /// The place of a column, which is added if no run has one of this name and type.
    fn place(&mut self, column: ExplorerColumn) -> usize {
        let same = |known: &ExplorerColumn| {
            let words = |column: &ExplorerColumn| column.kind == ValueKind::Category;
            known.name == column.name && known.role == column.role && words(known) == words(&column)
        };
        let Some(at) = self.columns.iter().position(same) else {
            let mut column = column;
            column.values = vec![f32::NAN; self.rows];
            self.columns.push(column);
            return self.columns.len() - 1;
        };
        let known = &mut self.columns[at];
        for level in &column.levels {
            known.level(level);
        }
        known.range = match (known.range, column.range) {
            (Some([a, b]), Some([c, d])) => Some([a.min(c), b.max(d)]),
            (range, other) => range.or(other),
        };
        at
    }

    /// Adds an episode of a run.
    pub fn push(&mut self, run: usize, entry: &Entry) {
        let Some(run) = self.runs.get(run) else { return };
        let episode = &entry.episode;
        let columns = &mut self.columns;
        columns[fixed::RUN].values.push(run.code);
        columns[fixed::INDEX].values.push(entry.index() as f32);
        let stage = columns[fixed::STAGE].level(&entry.stage) as f32;
        columns[fixed::STAGE].values.push(stage);
        let word = match &episode.outcome {
            Outcome::Invalid(_) => "invalid",
            outcome => outcome.as_str(),
        };
        let outcome = columns[fixed::OUTCOME].level(word) as f32;
        columns[fixed::OUTCOME].values.push(outcome);
        columns[fixed::TIME].values.push(finite(episode.time_s));
        columns[fixed::WEIGHT].values.push(finite(entry.weight));
        let label = &entry.label;
        for (at, word) in [(fixed::CATEGORY, &label.category), (fixed::GROUP, &label.group), (fixed::CASE, &label.case)]
        {
            let code = word.as_ref().map_or(f32::NAN, |word| columns[at].level(word) as f32);
            columns[at].values.push(code);
        }
        for (name, at) in &run.parameters {
            let column = &mut columns[*at];
            let value = match episode.scenario.requested.get(name) {
                None => f32::NAN,
                Some(Value::Number(x)) => finite(*x),
                Some(Value::Integer(n)) => *n as f32,
                Some(Value::Category(word)) => column.level(word) as f32,
            };
            column.values.push(value);
        }
        for (name, at) in &run.measures {
            columns[*at].values.push(episode.measures.get(name).map_or(f32::NAN, finite));
        }
        for (name, at) in &run.draws {
            columns[*at].values.push(episode.draws.get(name).map_or(f32::NAN, finite));
        }
        self.rows += 1;
        // Columns that this run does not have.
        let rows = self.rows;
        for column in columns {
            column.values.resize(rows, f32::NAN);
        }
    }

    /// Removes all episodes of all runs. Columns and levels stay.
    pub fn clear(&mut self) {
        self.rows = 0;
        self.columns.iter_mut().for_each(|column| column.values.clear());
    }

    /// The number of episodes.
    pub fn rows(&self) -> usize {
        self.rows
    }

    /// The columns.
    pub fn columns(&self) -> &[ExplorerColumn] {
        &self.columns
    }

    /// The values of these rows, column after column, as little-endian 32-bit floats.
    pub fn bytes(&self, rows: std::ops::Range<usize>) -> Vec<u8> {
        let mut bytes = Vec::with_capacity(4 * rows.len() * self.columns.len());
        for column in &self.columns {
            let values = column.values.get(rows.clone()).unwrap_or_default();
            values.iter().for_each(|value| bytes.extend_from_slice(&value.to_le_bytes()));
        }
        bytes
    }
}

impl ExplorerColumn {
    fn new(name: &str, label: String, role: Role, kind: ValueKind) -> Self {
        Self {
            name: name.to_owned(),
            label: mode_label(&label),
            unit: String::new(),
            role,
            kind,
            log: false,
            range: None,
            better: Better::Neither,
            levels: Vec::new(),
            values: Vec::new(),
            known: HashMap::new(),
        }
    }

    /// The values, one per row.
    pub fn values(&self) -> &[f32] {
        &self.values
    }

    /// The index of a word, which becomes a level.
    fn level(&mut self, word: &str) -> usize {
        if let Some(at) = self.known.get(word) {
            return *at;
        }
        let word = if self.levels.len() < MAX_LEVELS { word } else { OTHER };
        if let Some(at) = self.known.get(word) {
            return *at;
        }
        self.levels.push(word.to_owned());
        self.known.insert(word.to_owned(), self.levels.len() - 1);
        self.levels.len() - 1
    }
}

fn finite(x: f64) -> f32 {
    let x = x as f32;
    if x.is_finite() { x } else { f32::NAN }
}
