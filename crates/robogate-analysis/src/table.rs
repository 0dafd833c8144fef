//! The columns of a dictionary in memory, and samples of its rows.

use robogate_core::{Domain, FailureMode, Suite, Word};
use robogate_dictionary::{Column, Dictionary, DictionaryError, results};
use robogate_stats::clusters::Clusters;
use robogate_stats::weighted::{WeightedRate, hajek};
use robogate_stats::{Confidence, Trials};

use crate::dependence::{Dependence, strata, varying};
use crate::{AnalysisError, Population};

/// The name of the column of cycle times.
const TIME: &str = "cycle_time_s";

/// The columns that the analysis reads, with one value per episode. A row takes about 120 bytes.
pub(crate) struct EpisodeTable {
    pub(crate) index: Vec<u64>,
    /// Index of each row's stage in `stages`.
    pub(crate) stage: Vec<u8>,
    pub(crate) stages: Vec<Stage>,
    pub(crate) weight: Vec<f64>,
    pub(crate) outcome: Vec<Ending>,
    /// The failure modes of the task, then undeclared modes that occurred.
    pub(crate) modes: Vec<FailureMode>,
    /// Number of declared modes.
    pub(crate) declared: usize,
    pub(crate) parameters: Vec<ParameterColumn>,
    /// The measures of the task by name.
    pub(crate) measures: Vec<(Word, Vec<Option<f64>>)>,
    pub(crate) time_s: Vec<Option<f64>>,
    /// Faults of invalid episodes, with their counts.
    pub(crate) faults: Vec<(String, u64)>,
    /// Columns that only identify an episode: its seed.
    pub(crate) identifiers: Vec<ParameterColumn>,
    /// The case of each row as a number, with its category and group. `None` if the rows name none.
    pub(crate) cases: Option<Vec<[u32; 3]>>,
    /// The group of each row. Empty if no row has one.
    pub(crate) groups: Vec<Option<u32>>,
    /// Failure modes that the source of imported rows does not record.
    pub(crate) not_recorded: Vec<String>,
    /// Whether the scenarios of the suite were new points of a space in each round.
    pub(crate) is_fresh: bool,
}

/// How an episode ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Ending {
    Success,
    /// Index in [`EpisodeTable::modes`].
    Failure(u16),
    Invalid,
}

/// A stage and the sampler of its points.
pub(crate) struct Stage {
    pub(crate) name: String,
    pub(crate) designs: Vec<String>,
    pub(crate) focused: bool,
}

/// The requested values of one parameter. For a categorical one, the indices of its levels.
pub(crate) struct ParameterColumn {
    pub(crate) name: String,
    pub(crate) kind: ParameterKind,
    pub(crate) values: Vec<f64>,
}

/// The type and the range of a parameter's values.
#[derive(Debug, Clone)]
pub(crate) enum ParameterKind {
    Continuous { low: f64, high: f64, log: bool },
    Integer { low: i64, high: i64 },
    Categorical { levels: Vec<String> },
}

impl EpisodeTable {
    pub(crate) fn read(dictionary: &Dictionary) -> Result<Self, DictionaryError> {
        let index = match dictionary.column("index")? {
            Column::Counts(values) => values.into_iter().map(Option::unwrap_or_default).collect(),
            _ => Vec::new(),
        };
        let weight = dictionary.numbers("weight")?.into_iter().map(Option::unwrap_or_default).collect::<Vec<f64>>();
        let (stage_names, stage) = categories(dictionary, "stage")?;
        let (design_names, design) = categories(dictionary, "design")?;
        let (outcomes, outcome_codes) = categories(dictionary, "outcome")?;
        let task = &dictionary.provenance().task;
        let mut modes: Vec<FailureMode> = task.modes().collect();
        let declared = modes.len();
        let endings: Vec<Ending> = outcomes.iter().map(|outcome| ending(outcome, &mut modes)).collect();
        let outcome: Vec<Ending> =
            outcome_codes.iter().map(|code| at(&endings, *code).unwrap_or(Ending::Invalid)).collect();
        let mut stages = stages(&stage_names, &stage, &design_names, &design, &weight);
        let mut stage: Vec<u8> =
            stage.iter().map(|code| code.map_or(0, |code| u8::try_from(code).unwrap_or(u8::MAX))).collect();
        separate_uniform_part(&mut stages, &mut stage, &design_names, &design);
        let mut faults: Vec<(String, u64)> = Vec::new();
        if outcome.contains(&Ending::Invalid) {
            let (fault_kinds, codes) = categories(dictionary, "fault_kind")?;
            let mut counts = vec![0; fault_kinds.len()];
            for code in codes.iter().flatten() {
                counts[*code as usize] += 1;
            }
            faults = fault_kinds.into_iter().zip(counts).collect();
            faults.sort_by(|a, b| b.1.cmp(&a.1).then_with(|| a.0.cmp(&b.0)));
        }
        let provenance = dictionary.provenance();
        let source = provenance.source.iter().flat_map(|source| &source.not_recorded);
        // The task of such a source declares no failure modes, so the other names are its modes.
        let not_recorded = source.filter(|name| *name != TIME).cloned().collect();
        let measure = |name: Word| Ok((name, dictionary.numbers(name.as_str())?));
        let measures = task.measures.iter().map(|spec| measure(spec.name)).collect::<Result<_, DictionaryError>>()?;
        // Identifiers of imported rows are not parameters of the scenario.
        let read = |identifies: bool| {
            let of = provenance.space.parameters().iter().filter(|p| results::only_identifies(&p.name) == identifies);
            of.map(|p| parameter(dictionary, &p.name, &p.domain)).collect::<Result<Vec<_>, DictionaryError>>()
        };
        let (parameters, identifiers) = (read(false)?, read(true)?);
        Ok(Self {
            index,
            stage,
            stages,
            weight,
            outcome,
            parameters,
            modes,
            declared,
            measures,
            time_s: dictionary.numbers(TIME)?,
            faults,
            identifiers,
            cases: cases(dictionary)?,
            groups: Some(categories(dictionary, "group")?.1)
                .filter(|groups| groups.iter().any(Option::is_some))
                .unwrap_or_default(),
            not_recorded,
            is_fresh: fresh_suite(&provenance.plan),
        })
    }

    pub(crate) fn len(&self) -> usize {
        self.outcome.len()
    }

    /// A measure of the task, with one value per row.
    pub(crate) fn measure(&self, name: &str) -> Option<&[Option<f64>]> {
        self.measures.iter().find(|(known, _)| *known == name).map(|(_, values)| &**values)
    }

    /// The name of the failure mode at an index of [`Self::modes`].
    pub(crate) fn mode(&self, at: usize) -> &'static str {
        self.modes.get(at).copied().unwrap_or(FailureMode::UNKNOWN).as_str()
    }

    /// The outcome of an episode, as the dictionary names it.
    pub(crate) fn outcome_name(&self, ending: Ending) -> &'static str {
        match ending {
            Ending::Success => "success",
            Ending::Failure(mode) => self.mode(usize::from(mode)),
            Ending::Invalid => "invalid",
        }
    }

    /// The valid rows of the focused stages, or of all others.
    pub(crate) fn sample(&self, focused: bool) -> Sample {
        self.valid_where(|row| self.is_focused(row) == focused)
    }

    /// The valid rows from which a model of the parameters alone can learn. An active stage chooses its points knowing the
    /// hidden draws, so among its rows the rate at given parameters is not that of the operating space.
    pub(crate) fn unselected(&self) -> Sample {
        self.valid_where(|row| !self.is_active(row))
    }

    /// All valid rows.
    pub(crate) fn valid(&self) -> Sample {
        self.valid_where(|_| true)
    }

    /// All valid rows with the weights that bring them to the operating space, one for each row of the table.
    pub(crate) fn weighted(&self, weights: &[f64]) -> Sample {
        let mut sample = self.valid();
        sample.weights = Some(sample.rows.iter().map(|row| weights[*row as usize]).collect());
        sample
    }

    fn valid_where(&self, keep: impl Fn(usize) -> bool) -> Sample {
        let keep = |row: &usize| self.outcome[*row] != Ending::Invalid && keep(*row);
        let rows: Vec<u32> = (0..self.len()).filter(keep).map(|row| row as u32).collect();
        Sample {
            weights: None,
            success: rows.iter().map(|row| self.outcome[*row as usize] == Ending::Success).collect(),
            parameters: self.parameters.iter().map(|p| p.take(&rows)).collect(),
            identifiers: self.identifiers.iter().map(|p| p.take(&rows)).collect(),
            dependence: None,
            strata: None,
            rows,
        }
    }

    /// Whether a row belongs to the active stage, whose weights refer to the whole operating distribution.
    pub(crate) fn is_active(&self, row: usize) -> bool {
        self.stages.get(usize::from(self.stage[row])).is_some_and(|stage| stage.name == ACTIVE)
    }

    /// Whether a row was sampled from the operating distribution by an active stage.
    pub(crate) fn is_uniform_part(&self, row: usize) -> bool {
        self.stages.get(usize::from(self.stage[row])).is_some_and(|stage| stage.name == UNIFORM_PART)
    }

    pub(crate) fn is_focused(&self, row: usize) -> bool {
        self.stages.get(usize::from(self.stage[row])).is_some_and(|stage| stage.focused)
    }
}

/// Valid rows of one population, with their parameter values.
pub(crate) struct Sample {
    /// Indices in [`EpisodeTable`].
    pub(crate) rows: Vec<u32>,
    pub(crate) success: Vec<bool>,
    pub(crate) parameters: Vec<ParameterColumn>,
    pub(crate) identifiers: Vec<ParameterColumn>,
    /// The sampling weight of each row. `None` if all are equal.
    pub(crate) weights: Option<Vec<f64>>,
    /// The clusters of the rows. `None` if the rows are independent as far as known.
    pub(crate) dependence: Option<Dependence>,
    /// The part of each row's campaign in which its values were drawn: values are compared within it. `None` if all were drawn alike.
    pub(crate) strata: Option<Clusters>,
}

impl Sample {
    /// Finds the rows that depend on each other. `groups` are columns that the user names.
    pub(crate) fn depend(
        &mut self,
        table: &EpisodeTable,
        population: Population,
        groups: &[String],
    ) -> Result<(), AnalysisError> {
        self.strata = strata(table, self, population).filter(|_| groups.is_empty());
        self.dependence = Dependence::of(table, self, population, groups, self.strata.is_some())?;
        Ok(())
    }

    /// The cluster of each row, if rows depend on each other.
    pub(crate) fn clusters(&self) -> Option<&Clusters> {
        self.dependence.as_ref().map(Dependence::main)
    }

    pub(crate) fn len(&self) -> usize {
        self.rows.len()
    }

    /// Whether rows count differently: they have weights, or come in clusters. Plain counts say nothing then.
    pub(crate) fn is_plain(&self) -> bool {
        self.weights.is_none() && self.dependence.is_none()
    }

    pub(crate) fn weight(&self, row: usize) -> f64 {
        self.weights.as_ref().map_or(1.0, |weights| weights[row])
    }

    /// Hajek's rate of the rows for which `used` is true. `None` without weights.
    pub(crate) fn weighted_rate(&self, used: impl Fn(usize) -> bool) -> Option<WeightedRate> {
        let weights = self.weights.as_ref()?;
        let (success, weights): (Vec<bool>, Vec<f64>) =
            (0..self.len()).filter(|row| used(*row)).map(|row| (self.success[row], weights[row])).unzip();
        hajek(&success, &weights, Confidence::P95).ok()
    }

    /// Counts of as many independent rows as have the same rate and the same variance.
    pub(crate) fn effective(&self, used: impl Fn(usize) -> bool + Copy) -> Trials {
        if let Some(dependence) = &self.dependence {
            return dependence.rate(self, used).effective_trials();
        }
        match self.weighted_rate(used) {
            Some(found) => rounded(found.rate.unwrap_or(0.0), found.independent),
            None => Trials::count((0..self.len()).filter(|row| used(*row)).map(|row| self.success[row])),
        }
    }

    /// The effective counts of cells: [`Self::effective`] for the rows of each.
    pub(crate) fn effective_cells(&self, cells: usize, cell_of: impl Fn(usize) -> Option<usize>) -> Vec<Trials> {
        let of_row: Vec<Option<usize>> = (0..self.len()).map(cell_of).collect();
        if self.is_plain() {
            let mut counts = vec![(0, 0); cells];
            for (cell, success) in of_row.iter().zip(&self.success) {
                if let Some((k, n)) = cell.and_then(|cell| counts.get_mut(cell)) {
                    *k += u64::from(*success);
                    *n += 1;
                }
            }
            return counts.into_iter().map(|(k, n)| Trials::new(k, n).unwrap_or(Trials::NONE)).collect();
        }
        (0..cells).map(|cell| self.effective(|row| of_row[row] == Some(cell))).collect()
    }

    /// How many independent rows one row counts for, from 0 to 1.
    pub(crate) fn share(&self) -> f64 {
        match (&self.dependence, self.weighted_rate(|_| true)) {
            (Some(dependence), _) => dependence.share(self),
            (None, Some(found)) => (found.independent / self.len().max(1) as f64).clamp(0.0, 1.0),
            (None, None) => 1.0,
        }
    }

    /// The rows for which `kept` is true.
    pub(crate) fn restricted(&self, kept: &[bool]) -> Self {
        let places: Vec<u32> = (0..self.len()).filter(|at| kept[*at]).map(|at| at as u32).collect();
        Self {
            rows: places.iter().map(|at| self.rows[*at as usize]).collect(),
            success: places.iter().map(|at| self.success[*at as usize]).collect(),
            parameters: self.parameters.iter().map(|column| column.take(&places)).collect(),
            identifiers: self.identifiers.iter().map(|column| column.take(&places)).collect(),
            weights: self.weights.as_ref().map(|of| places.iter().map(|at| of[*at as usize]).collect()),
            dependence: self.dependence.as_ref().map(|of| of.take(&places)),
            strata: self.strata.as_ref().map(|of| of.take(places.iter().map(|at| *at as usize))),
        }
    }

    /// The rows of the strata in which a parameter has several values: elsewhere its value says which stratum a row belongs to.
    /// `None` if all rows are comparable.
    pub(crate) fn comparable(&self, parameter: &str) -> Option<Self> {
        let (strata, column) = (self.strata.as_ref()?, self.parameter(parameter)?);
        let varies = varying(strata, column);
        let kept: Vec<bool> = strata.of_row().iter().map(|stratum| varies[*stratum]).collect();
        Some(self.restricted(&kept))
    }

    pub(crate) fn parameter(&self, name: &str) -> Option<&ParameterColumn> {
        self.parameters.iter().find(|p| p.name == name)
    }

    /// Indices of the failures, with their modes.
    pub(crate) fn failures(&self, table: &EpisodeTable) -> (Vec<usize>, Vec<usize>) {
        let modes = self.rows.iter().enumerate().filter_map(|(i, row)| match table.outcome[*row as usize] {
            Ending::Failure(mode) => Some((i, usize::from(mode))),
            Ending::Success | Ending::Invalid => None,
        });
        modes.unzip()
    }
}

impl ParameterColumn {
    fn take(&self, rows: &[u32]) -> Self {
        Self {
            name: self.name.clone(),
            kind: self.kind.clone(),
            values: rows.iter().map(|row| self.values[*row as usize]).collect(),
        }
    }

    pub(crate) fn is_numeric(&self) -> bool {
        !matches!(self.kind, ParameterKind::Categorical { .. })
    }

    /// Whether the values can be compared with those of `other`: both numeric, or both with the same levels.
    pub(crate) fn is_like(&self, other: &Self) -> bool {
        match (&self.kind, &other.kind) {
            (ParameterKind::Categorical { levels }, ParameterKind::Categorical { levels: others }) => levels == others,
            _ => self.is_numeric() && other.is_numeric(),
        }
    }

    /// The values as category codes.
    pub(crate) fn codes(&self) -> Vec<usize> {
        // Codes are indices, hence non-negative integers.
        self.values.iter().map(|v| *v as usize).collect()
    }

    /// A value with all its digits.
    pub(crate) fn exactly(&self, value: f64) -> String {
        match self.kind {
            ParameterKind::Continuous { .. } => value.to_string(),
            ParameterKind::Integer { .. } | ParameterKind::Categorical { .. } => self.show(value),
        }
    }

    /// A value for display.
    pub(crate) fn show(&self, value: f64) -> String {
        self.kind.show(value)
    }
}

/// Counts of a number of trials with a rate, rounded towards fewer trials.
pub(crate) fn rounded(rate: f64, trials: f64) -> Trials {
    let n = trials.floor().max(0.0);
    Trials::new((n * rate).round().clamp(0.0, n) as u64, n as u64).unwrap_or(Trials::NONE)
}

/// Whether a plan runs a suite whose scenarios are new points of a space in each round.
fn fresh_suite(plan: &serde_json::Value) -> bool {
    let suite = plan.get("suite").and_then(|stage| stage.get("suite"));
    suite.is_some_and(|suite| serde_json::from_value::<Suite>(suite.clone()).is_ok_and(|suite| suite.is_fresh()))
}

/// The numbers of case, category and group of each row. `None` unless each row names a case.
/// The words of a column in all rows. `None` if a row has none.
pub(crate) fn words(dictionary: &Dictionary, column: &str) -> Result<Option<Vec<String>>, DictionaryError> {
    let (levels, codes) = categories(dictionary, column)?;
    let word = |code: &Option<u32>| levels.get((*code)? as usize).map(ToString::to_string);
    Ok(codes.iter().map(word).collect::<Option<Vec<String>>>().filter(|words| !words.is_empty()))
}

fn cases(dictionary: &Dictionary) -> Result<Option<Vec<[u32; 3]>>, DictionaryError> {
    let (_, case) = categories(dictionary, "case")?;
    if case.is_empty() || case.iter().any(Option::is_none) {
        return Ok(None);
    }
    let (_, category) = categories(dictionary, "category")?;
    let (_, group) = categories(dictionary, "group")?;
    // A missing word is a word of its own.
    let number = |codes: &[Option<u32>], row: usize| codes.get(row).copied().flatten().map_or(0, |code| code + 1);
    Ok(Some((0..case.len()).map(|row| [number(&case, row), number(&category, row), number(&group, row)]).collect()))
}

/// Parses an outcome. A failure mode that the task does not declare is added to `modes`.
fn ending(outcome: &str, modes: &mut Vec<FailureMode>) -> Ending {
    match outcome {
        "success" => return Ending::Success,
        "invalid" => return Ending::Invalid,
        _ => {}
    }
    let mode = FailureMode::from_foreign(outcome);
    let at = modes.iter().position(|known| *known == mode).unwrap_or_else(|| {
        modes.push(mode);
        modes.len() - 1
    });
    // A file has far fewer modes than rows, so a linear search is fast.
    Ending::Failure(u16::try_from(at).unwrap_or(u16::MAX))
}

fn at<T: Copy>(table: &[T], code: Option<u32>) -> Option<T> {
    table.get(code? as usize).copied()
}

pub(crate) fn categories(
    dictionary: &Dictionary,
    name: &str,
) -> Result<(Vec<String>, Vec<Option<u32>>), DictionaryError> {
    match dictionary.column(name)? {
        Column::Categories { words, codes } => Ok((words, codes)),
        _ => Ok((Vec::new(), Vec::new())),
    }
}

/// The stage whose weights refer to the whole operating distribution.
pub(crate) const ACTIVE: &str = "active";

/// The rows of the active stage that were sampled from the operating distribution.
const UNIFORM_PART: &str = "active (uniform part)";

/// The name of a row's stage, which separates the uniform part of the active stage.
pub(crate) fn stage_of<'a>(stage: &'a str, design: &str) -> &'a str {
    if stage == ACTIVE && design == "uniform" { UNIFORM_PART } else { stage }
}

/// Makes a stage of the rows of the active stage whose points its model did not choose: a sample from the operating
/// distribution.
fn separate_uniform_part(stages: &mut Vec<Stage>, stage: &mut [u8], design_names: &[String], designs: &[Option<u32>]) {
    let Some(active) = stages.iter().position(|stage| stage.name == ACTIVE) else { return };
    let Some(uniform) = design_names.iter().position(|design| design == "uniform") else { return };
    let (Ok(part), Some(of)) = (u8::try_from(stages.len()), stages.get_mut(active)) else { return };
    of.designs.retain(|design| design != "uniform");
    stages.push(Stage { name: UNIFORM_PART.to_owned(), designs: vec!["uniform".to_owned()], focused: false });
    for (stage, design) in stage.iter_mut().zip(designs) {
        if usize::from(*stage) == active && design.is_some_and(|design| design as usize == uniform) {
            *stage = part;
        }
    }
}

/// Whether the points of a stage were not sampled from the operating distribution: those of the boundary and the active stage,
/// and of any unknown stage whose weights are not all 1.
pub(crate) fn is_focused(stage: &str, weighted: bool) -> bool {
    match stage {
        "boundary" | ACTIVE => true,
        "uniform" | "imported" | UNIFORM_PART => false,
        _ => weighted,
    }
}

fn stages(
    names: &[String],
    codes: &[Option<u32>],
    design_names: &[String],
    designs: &[Option<u32>],
    weights: &[f64],
) -> Vec<Stage> {
    let mut stages: Vec<Stage> = names
        .iter()
        .map(|name| Stage { name: name.clone(), designs: Vec::new(), focused: is_focused(name, false) })
        .collect();
    let mut pairs: Vec<(u32, u32)> = Vec::new();
    for row in 0..codes.len() {
        let (Some(stage), Some(design)) = (codes[row], designs[row]) else { continue };
        if pairs.last() != Some(&(stage, design)) && !pairs.contains(&(stage, design)) {
            pairs.push((stage, design));
        }
        let of = &mut stages[stage as usize];
        let even = (weights[row] - 1.0).abs() <= 0.0;
        if !even {
            of.focused = is_focused(&of.name, true);
        }
    }
    for (stage, design) in pairs {
        stages[stage as usize].designs.push(design_names[design as usize].clone());
    }
    stages
}

/// Width of the range of a constant, relative to the larger of its value and 1.
const CONSTANT_WIDTH: f64 = 1e-3;

fn parameter(dictionary: &Dictionary, name: &str, domain: &Domain) -> Result<ParameterColumn, DictionaryError> {
    let (kind, values) = match domain {
        Domain::Continuous { low, high, scale } => {
            let log = *scale == robogate_core::Scale::Log;
            // A constant gets a range of positive width, for axes.
            let high = if domain.is_constant() { low + CONSTANT_WIDTH * low.abs().max(1.0) } else { *high };
            (ParameterKind::Continuous { low: *low, high, log }, numbers(dictionary, name)?)
        }
        Domain::Integer { low, high } => {
            (ParameterKind::Integer { low: *low, high: *high }, numbers(dictionary, name)?)
        }
        Domain::Categorical { choices } => {
            let mut all: Vec<String> = choices.iter().map(|c| c.to_string()).collect();
            let (present, codes) = categories(dictionary, name)?;
            // A value that the space does not declare becomes a level.
            let places: Vec<f64> = present
                .into_iter()
                .map(|level| match all.iter().position(|known| *known == level) {
                    Some(place) => place as f64,
                    None => {
                        all.push(level);
                        (all.len() - 1) as f64
                    }
                })
                .collect();
            let values = codes.iter().map(|code| at(&places, *code).unwrap_or(f64::NAN)).collect();
            (ParameterKind::Categorical { levels: all }, values)
        }
    };
    let column = ParameterColumn { name: name.to_owned(), kind, values };
    Ok(if column.values.iter().any(|value| value.is_nan()) { with_missing_level(column) } else { column })
}

/// The level of rows without a value, as imported rows can be.
const MISSING: &str = "(missing)";

/// Number of ranges into which the known values of a number with missing values are divided.
const RANGES: usize = 5;

/// The column as categories, one of which stands for a missing value. Numbers are divided at their quantiles. All rows
/// are kept, and a rate that differs where the value is missing can be seen.
fn with_missing_level(column: ParameterColumn) -> ParameterColumn {
    let mut known: Vec<f64> = column.values.iter().copied().filter(|value| !value.is_nan()).collect();
    known.sort_by(f64::total_cmp);
    let (mut levels, ends) = match &column.kind {
        ParameterKind::Categorical { levels } => (levels.clone(), None),
        ParameterKind::Continuous { .. } | ParameterKind::Integer { .. } => {
            let place = |i: usize| (known.len() * i / RANGES).saturating_sub(1);
            let mut ends: Vec<f64> = (1..=RANGES).filter_map(|i| known.get(place(i)).copied()).collect();
            ends.dedup_by(|a, b| a.total_cmp(b).is_eq());
            let show = |value: f64| column.show(value);
            let label = |(i, end): (usize, &f64)| match i.checked_sub(1).and_then(|before| ends.get(before)) {
                Some(start) => format!("above {} to {}", show(*start), show(*end)),
                None => format!("up to {}", show(*end)),
            };
            (ends.iter().enumerate().map(label).collect(), Some(ends))
        }
    };
    let missing = levels.len() as f64;
    levels.push(MISSING.to_owned());
    let code = |value: f64| match &ends {
        _ if value.is_nan() => missing,
        Some(ends) => ends.iter().position(|end| value <= *end).unwrap_or(ends.len().saturating_sub(1)) as f64,
        None => value,
    };
    let values = column.values.iter().map(|value| code(*value)).collect();
    ParameterColumn { name: column.name.clone(), kind: ParameterKind::Categorical { levels }, values }
}

fn numbers(dictionary: &Dictionary, name: &str) -> Result<Vec<f64>, DictionaryError> {
    Ok(dictionary.numbers(name)?.into_iter().map(|value| value.unwrap_or(f64::NAN)).collect())
}
