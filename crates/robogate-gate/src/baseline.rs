//! The baseline that relative requirements refer to.

use std::collections::BTreeMap;
use std::path::Path;

use robogate_core::budget::{Budget, JsonError};
use robogate_dictionary::{Tool, read_text};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::figure::{applies, figure};
use crate::rounds::Rounds;
use crate::{GateError, Metric, Population, Record};

/// One figure of a baseline.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct BaselineFigure {
    /// The metric.
    pub metric: Metric,
    /// Its value over the valid episodes.
    pub value: f64,
}

/// The recorded figures of a policy, stored as JSON. Other runs are compared with them.
///
/// A relative limit takes the baseline's figure as exact: the requirement is "at most 1.1 times this number", not "at
/// most 1.1 times the true value of the other policy". For the second question, compare the two runs
/// ([`crate::Against`]).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Baseline {
    /// Version of the format.
    pub format: u32,
    /// The program that wrote it, with its version.
    pub tool: Tool,
    /// The population of the figures. They cannot be compared with those of another population.
    pub population: Population,
    /// The robot.
    pub robot: String,
    /// The policy.
    pub policy: String,
    /// SHA-256 (hex) of the rows that the figures were computed from.
    pub dataset_sha256: String,
    /// Number of valid episodes.
    pub valid: u64,
    /// Number of invalid episodes. They do not contribute to the figures.
    pub invalid: u64,
    /// The figures. A metric without a value is absent.
    pub figures: Vec<BaselineFigure>,
    /// Settings of the task, engine and robot, which decide what a figure means. Those of a run that is compared must be equal where both
    /// are known.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub conditions: BTreeMap<String, String>,
}

impl Baseline {
    /// The version that this build writes, and the newest that it reads.
    pub const FORMAT: u32 = 1;

    /// Computes the figures of `record` over its complete rounds.
    ///
    /// # Errors
    /// [`GateError::EmptyBaseline`] if there is no valid episode.
    pub fn of(record: &Record) -> Result<Self, GateError> {
        let rounds = Rounds::of(&record.trials, &record.population)?;
        let valid = rounds.trials().filter(|trial| trial.ending.is_valid()).count() as u64;
        if valid == 0 {
            return Err(GateError::EmptyBaseline);
        }
        let figures = Metric::of_task(&record.task).into_iter().filter_map(|metric| {
            let range = [Some(0.0).filter(|_| metric == Metric::MEAN_CYCLE_TIME), None];
            let (_, _, extremes) = figure(metric, rounds.trials().filter(|trial| applies(metric, trial)), range);
            extremes.observed.map(|value| BaselineFigure { metric, value })
        });
        Ok(Self {
            format: Self::FORMAT,
            tool: Tool::robogate(),
            population: record.population.clone(),
            robot: record.robot.clone(),
            policy: record.policy.clone(),
            dataset_sha256: record.dataset_sha256.clone(),
            valid,
            invalid: rounds.trials().count() as u64 - valid,
            figures: figures.collect(),
            conditions: record.conditions.fixed(),
        })
    }

    /// The figure of a metric, if the baseline has it.
    pub fn figure(&self, metric: Metric) -> Option<f64> {
        self.figures.iter().find(|figure| figure.metric == metric).map(|figure| figure.value)
    }

    /// Reads a baseline file.
    ///
    /// # Errors
    /// If the file is not a baseline, or has a newer format.
    pub fn open(path: &Path) -> Result<Self, GateError> {
        let text = read_text(path).map_err(|source| GateError::Unreadable { path: path.to_owned(), source })?;
        Self::from_json(&text).map_err(|error| GateError::InFile { path: path.to_owned(), error: Box::new(error) })
    }

    /// Parses a baseline.
    ///
    /// # Errors
    /// If the text is not a baseline, or has a newer format.
    pub fn from_json(text: &str) -> Result<Self, GateError> {
        #[derive(Deserialize)]
        struct Form {
            format: u32,
        }
        let syntax = |error: JsonError| {
            GateError::Syntax(format!(
                "not a baseline: {error}\nHint: create one with `robogate gate --run RUN --write-baseline FILE`"
            ))
        };
        let Form { format } = Budget::FILE.json(text.as_bytes()).map_err(syntax)?;
        if format > Self::FORMAT {
            return Err(GateError::NewerBaseline { found: format, known: Self::FORMAT });
        }
        let baseline: Self = Budget::FILE.json(text.as_bytes()).map_err(syntax)?;
        if baseline.valid == 0
            || baseline
                .figures
                .iter()
                .any(|f| !f.value.is_finite() || (f.value < 0.0 && !matches!(f.metric, Metric::Measure(..))))
        {
            return Err(GateError::EmptyBaseline);
        }
        Ok(baseline)
    }

    /// Serialises the baseline. Equal baselines give equal bytes.
    pub fn to_json(&self) -> String {
        // Strings and finite numbers always serialise.
        serde_json::to_string_pretty(self).unwrap_or_default() + "\n"
    }

    /// Returns an error if the population or the conditions of the episodes differ.
    pub(crate) fn check(&self, record: &Record) -> Result<(), GateError> {
        let population = &record.population;
        if !self.population.is_that_of(population) {
            let (baseline, run) = (self.population.to_string(), population.to_string());
            return Err(GateError::ForeignBaseline { baseline, run });
        }
        match record.conditions.other_than(&self.conditions) {
            Some(differences) => Err(GateError::OtherConditions { differences }),
            None => Ok(()),
        }
    }
}
