//! Episodes of one or several runs as columns of numbers, for the explorer.

use std::collections::{BTreeMap, HashMap};

use robogate_core::{Better, Domain, Outcome, Scale, Value};
use robogate_dictionary::{Entry, Provenance, results};
use serde::Serialize;

use crate::distance::{Difference, sentence};
use crate::labels::{label_and_unit, mode_label};
use crate::table::{ParameterKind, is_focused, stage_of};

/// Largest number of levels of a column. Further words share the last one.
const MAX_LEVELS: usize = 4_096;
/// The level of further words.
const OTHER: &str = "(other)";
/// The smallest sample is one in 2^32 episodes.
const MOST_HALVINGS: u32 = 32;

/// Episodes of one or several runs. Every value is a 32-bit number, which has seven digits: enough for a picture and a
/// table, and half the memory. Words are indices of their levels. A missing value is NaN.
///
/// The table keeps a limited number of rows. When it is full, it drops half of them and keeps one in two of the further
/// episodes, then one in four, and so on. A hash of run and index decides, so the rows stay a random sample that does
/// not depend on their order and outcomes. [`RunCounts`] always count all episodes.
#[derive(Debug)]
pub struct ExplorerTable {
    columns: Vec<ExplorerColumn>,
    rows: usize,
    /// Largest number of rows.
    most: usize,
    /// How often the table dropped half of its rows.
    halvings: u32,
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
    /// The stage of the campaign. The rows of the active stage that no model chose are a stage of their own, as in the
    /// analysis.
    Stage,
    /// The sampler of the point.
    Design,
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
    /// The domain of each parameter.
    domains: Vec<Domain>,
    measures: Vec<(String, usize)>,
    draws: Vec<(String, usize)>,
    /// All episodes by stage.
    stages: BTreeMap<String, StageCounts>,
}

/// All episodes of a stage.
#[derive(Debug, Clone, Copy, Default)]
struct StageCounts {
    successes: u64,
    failures: u64,
    invalid: u64,
    /// Whether a weight differs from 1.
    weighted: bool,
}

/// The episodes of a run: all of them, also those that are not in the table.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize)]
pub struct RunCounts {
    /// Valid episodes of points that were sampled from the operating space.
    pub n: u64,
    /// Successes among them.
    pub k: u64,
    /// Valid episodes of other points: those of the boundary stage and those that a model chose.
    pub focused: u64,
    /// Invalid episodes.
    pub invalid: u64,
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
    pub(super) const DESIGN: usize = 9;
}

/// The passing episode with the most similar parameters.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct PassingTwin {
    /// Its index in the run.
    pub index: u64,
    /// The largest differences from the failed episode, as a sentence.
    pub differences: String,
}

impl ExplorerTable {
    /// An empty table of at most this number of rows.
    pub fn new(most: usize) -> Self {
        let mut table = Self { columns: Vec::new(), rows: 0, most: most.max(1), halvings: 0, runs: Vec::new() };
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
            word("design", Role::Design),
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
        let parameters = provenance.space.parameters().iter().filter(|p| !results::only_identifies(&p.name));
        let domains = parameters.clone().map(|parameter| parameter.domain.clone()).collect();
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
        let run = Run {
            code,
            parameters: places(parameters),
            domains,
            measures: places(measures),
            draws: places(draws),
            stages: BTreeMap::new(),
        };
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

    /// Counts an episode of a run, and adds it if it belongs to the sample.
    pub fn push(&mut self, run: usize, entry: &Entry) {
        let Some(of) = self.runs.get_mut(run) else { return };
        let stage = stage_of(&entry.stage, &entry.design);
        of.count(stage, entry);
        let code = of.code;
        if !is_kept(code, entry.index() as f32, self.halvings) {
            return;
        }
        if self.rows >= self.most {
            self.halve();
            if !is_kept(code, entry.index() as f32, self.halvings) {
                return;
            }
        }
        let Some(run) = self.runs.get(run) else { return };
        let episode = &entry.episode;
        let columns = &mut self.columns;
        columns[fixed::RUN].values.push(run.code);
        columns[fixed::INDEX].values.push(entry.index() as f32);
        let stage = columns[fixed::STAGE].level(stage) as f32;
        columns[fixed::STAGE].values.push(stage);
        let design = columns[fixed::DESIGN].level(&entry.design) as f32;
        columns[fixed::DESIGN].values.push(design);
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

    /// Drops the rows that a sample of half the size does not have, until there is room.
    fn halve(&mut self) {
        while self.rows >= self.most && self.halvings < MOST_HALVINGS {
            self.halvings += 1;
            let [runs, indices] = [fixed::RUN, fixed::INDEX].map(|at| self.columns[at].values.as_slice());
            let kept: Vec<bool> =
                runs.iter().zip(indices).map(|(run, index)| is_kept(*run, *index, self.halvings)).collect();
            for column in &mut self.columns {
                let mut row = kept.iter();
                column.values.retain(|_| row.next().is_none_or(|kept| *kept));
            }
            self.rows = kept.iter().filter(|kept| **kept).count();
        }
    }

    /// How often the table dropped half of its rows: it has one in `2^halvings` episodes.
    pub fn halvings(&self) -> u32 {
        self.halvings
    }

    /// The counts of all episodes of a run, by the rule of the analysis: a stage is focused if it is the boundary or the active
    /// stage, or an unknown stage whose weights are not all 1.
    pub fn counts(&self, run: usize) -> RunCounts {
        let mut all = RunCounts::default();
        for (name, stage) in self.runs.get(run).iter().flat_map(|run| &run.stages) {
            let valid = stage.successes + stage.failures;
            all.invalid += stage.invalid;
            if is_focused(name, stage.weighted) {
                all.focused += valid;
            } else {
                all.n += valid;
                all.k += stage.successes;
            }
        }
        all
    }

    /// Removes all episodes of all runs. Columns and levels stay.
    pub fn clear(&mut self) {
        self.rows = 0;
        self.halvings = 0;
        self.columns.iter_mut().for_each(|column| column.values.clear());
        self.runs.iter_mut().for_each(|run| run.stages.clear());
    }

    /// The nearest passing twin of a failed episode: the successful episode of its run with the most similar parameters, by
    /// the distance of [`worth_watching`](crate::worth_watching). `None` for any other episode, and if no episode passed.
    pub fn passing_twin(&self, run: usize, index: u64) -> Option<PassingTwin> {
        let of = self.runs.get(run)?;
        let row = self.row(run, index)?;
        let [runs, indices, outcomes] =
            [fixed::RUN, fixed::INDEX, fixed::OUTCOME].map(|at| self.columns[at].values.as_slice());
        let is_own = |row: &usize| runs[*row].to_bits() == of.code.to_bits();
        // The first level of an outcome is always success.
        let passed = |row: usize| outcomes[row] <= 0.0;
        let invalid = self.columns[fixed::OUTCOME].known.get("invalid").map(|code| *code as f32);
        if passed(row) || invalid.is_some_and(|code| code.to_bits() == outcomes[row].to_bits()) {
            return None;
        }
        let parameters: Vec<(&str, ParameterKind, &[f32])> = of
            .parameters
            .iter()
            .zip(&of.domains)
            .map(|((name, at), domain)| (name.as_str(), kind(domain, &self.columns[*at]), &*self.columns[*at].values))
            .collect();
        let point: Vec<f64> = parameters.iter().map(|(_, kind, values)| kind.position(values[row].into())).collect();
        let distance = |other: usize| -> f64 {
            let part = |((_, kind, values), to): (&(&str, ParameterKind, &[f32]), &f64)| {
                kind.apart(kind.position(values[other].into()), *to).powi(2)
            };
            parameters.iter().zip(&point).map(part).sum()
        };
        let passing = (0..self.rows).filter(|other| passed(*other) && is_own(other));
        let (twin, _) = passing.map(|other| (other, distance(other))).min_by(|a, b| a.1.total_cmp(&b.1))?;
        let differences = sentence(parameters.iter().map(|(name, kind, values)| Difference {
            name,
            kind,
            failed: values[row].into(),
            passed: values[twin].into(),
        }));
        Some(PassingTwin { index: indices[twin] as u64, differences })
    }

    /// The number of episodes.
    pub fn rows(&self) -> usize {
        self.rows
    }

    /// The row of an episode.
    pub fn row(&self, run: usize, index: u64) -> Option<usize> {
        let of = self.runs.get(run)?;
        let [runs, indices] = [fixed::RUN, fixed::INDEX].map(|at| self.columns[at].values.as_slice());
        let wanted = (of.code.to_bits(), (index as f32).to_bits());
        (0..self.rows).find(|row| (runs[*row].to_bits(), indices[*row].to_bits()) == wanted)
    }

    /// At most this number of rows in ascending order, chosen by a fixed hash of their numbers: a sample that does not depend
    /// on the order or the values of the rows.
    pub fn sample(&self, most: usize) -> Vec<usize> {
        let mut rows: Vec<usize> = (0..self.rows).collect();
        if rows.len() > most {
            rows.sort_unstable_by_key(|row| mixed(*row as u64));
            rows.truncate(most);
            rows.sort_unstable();
        }
        rows
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

impl Run {
    fn count(&mut self, stage: &str, entry: &Entry) {
        if !self.stages.contains_key(stage) {
            self.stages.insert(stage.to_owned(), StageCounts::default());
        }
        let Some(counts) = self.stages.get_mut(stage) else { return };
        counts.weighted |= (entry.weight - 1.0).abs() > 0.0;
        match &entry.episode.outcome {
            Outcome::Success => counts.successes += 1,
            Outcome::Failure(_) => counts.failures += 1,
            Outcome::Invalid(_) => counts.invalid += 1,
        }
    }
}

/// Whether an episode belongs to a sample of one in `2^halvings`.
fn is_kept(run: f32, index: f32, halvings: u32) -> bool {
    let place = u64::from(index.to_bits()) | u64::from(run.to_bits()) << 32;
    halvings == 0 || mixed(place) >> (64 - halvings) == 0
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

/// The finaliser of SplitMix64 (Steele, Lea and Flood 2014).
fn mixed(x: u64) -> u64 {
    let x = x.wrapping_add(0x9e37_79b9_7f4a_7c15);
    let x = (x ^ (x >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    let x = (x ^ (x >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    x ^ (x >> 31)
}

/// The range of a parameter, with the words of its column.
fn kind(domain: &Domain, column: &ExplorerColumn) -> ParameterKind {
    match domain {
        Domain::Continuous { low, high, scale } => {
            ParameterKind::Continuous { low: *low, high: *high, log: *scale == Scale::Log }
        }
        Domain::Integer { low, high } => ParameterKind::Integer { low: *low, high: *high },
        Domain::Categorical { .. } => ParameterKind::Categorical { levels: column.levels.clone() },
    }
}

fn finite(x: f64) -> f32 {
    let x = x as f32;
    if x.is_finite() { x } else { f32::NAN }
}
