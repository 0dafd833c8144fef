//! The figures that relative demands refer to.

use std::path::Path;

use robogate_dictionary::Tool;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::figure::figure;
use crate::rounds::Rounds;
use crate::{GateError, Metric, Population, Record};

/// One figure of a baseline.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct BaselineFigure {
    /// Of which metric.
    pub metric: Metric,
    /// Over the valid episodes.
    pub value: f64,
}

/// The figures of a policy that others are held against, stored as JSON.
///
/// A limit that refers to it takes its figure as given: the demand is "at most 1.1 times this number", not "at most 1.1
/// times whatever the other policy would do in the long run". For that question, compare the two runs ([`crate::Against`]).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Baseline {
    /// Version of this form.
    pub format: u32,
    /// What wrote it.
    pub tool: Tool,
    /// What the figures speak of: a baseline of another population is no baseline.
    pub population: Population,
    /// The robot.
    pub robot: String,
    /// The policy.
    pub policy: String,
    /// Identity of the rows that the figures were computed from (SHA-256, hex).
    pub dataset_sha256: String,
    /// Valid episodes.
    pub valid: u64,
    /// Invalid episodes, which entered no figure.
    pub invalid: u64,
    /// The figures; a metric without evidence is not there.
    pub figures: Vec<BaselineFigure>,
}

impl Baseline {
    /// The version of the form that is written here, and the newest that is read.
    pub const FORMAT: u32 = 1;

    /// The figures of `record` over its whole rounds.
    ///
    /// # Errors
    /// [`GateError::EmptyBaseline`] without a valid episode.
    pub fn of(record: &Record) -> Result<Self, GateError> {
        let rounds = Rounds::of(&record.trials, &record.population)?;
        let valid = rounds.trials().filter(|trial| trial.ending.is_valid()).count() as u64;
        if valid == 0 {
            return Err(GateError::EmptyBaseline);
        }
        let figures = Metric::of_task(&record.task).into_iter().filter_map(|metric| {
            let (_, _, extremes) =
                figure(metric, rounds.trials(), [Some(0.0).filter(|_| metric == Metric::MEAN_CYCLE_TIME), None]);
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
        })
    }

    /// The figure of a metric, where there is one.
    pub fn figure(&self, metric: Metric) -> Option<f64> {
        self.figures.iter().find(|figure| figure.metric == metric).map(|figure| figure.value)
    }

    /// Reads a stored baseline.
    ///
    /// # Errors
    /// A file that is none, or in a later form.
    pub fn open(path: &Path) -> Result<Self, GateError> {
        let text =
            std::fs::read_to_string(path).map_err(|source| GateError::Unreadable { path: path.to_owned(), source })?;
        Self::from_json(&text).map_err(|error| GateError::InFile { path: path.to_owned(), error: Box::new(error) })
    }

    /// Reads a stored baseline.
    ///
    /// # Errors
    /// A text that is none, or in a later form.
    pub fn from_json(text: &str) -> Result<Self, GateError> {
        #[derive(Deserialize)]
        struct Form {
            format: u32,
        }
        let syntax = |error: serde_json::Error| {
            GateError::Syntax(format!("not a baseline: {error}\nhint: `robogate baseline RUN -o FILE` makes one"))
        };
        let Form { format } = serde_json::from_str(text).map_err(syntax)?;
        if format > Self::FORMAT {
            return Err(GateError::NewerBaseline { found: format, known: Self::FORMAT });
        }
        let baseline: Self = serde_json::from_str(text).map_err(syntax)?;
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

    /// As a file holds it: the same baseline gives the same bytes.
    pub fn to_json(&self) -> String {
        // A tree of strings and finite numbers cannot fail to serialise.
        serde_json::to_string_pretty(self).unwrap_or_default() + "\n"
    }

    /// Refuses to speak of another population.
    pub(crate) fn check(&self, population: &Population) -> Result<(), GateError> {
        if self.population.is_that_of(population) {
            Ok(())
        } else {
            Err(GateError::ForeignBaseline { baseline: self.population.to_string(), run: population.to_string() })
        }
    }
}
