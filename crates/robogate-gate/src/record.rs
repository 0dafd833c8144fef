//! The episodes that are judged, and what they speak of.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt;
use std::sync::Arc;

use robogate_core::{FailureMode, Suite, TaskSpec, Value};
use robogate_dictionary::results::{SOURCE_ROW, SOURCE_SEED};
use robogate_dictionary::{Dictionary, Entry, Label, Provenance, hex, suite_sha256};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

use crate::{GateError, Sampling, Trial};

/// What a set of episodes speaks of.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case", tag = "kind")]
pub enum Population {
    /// The scenarios of a suite, each as often as the others: every rate is the mean over them.
    Suite {
        /// Its name.
        name: String,
        /// SHA-256 (hex) over its scenarios: ids, categories, groups and parameters.
        sha256: String,
        /// How many scenarios.
        cases: u64,
    },
    /// The distribution that the rows were drawn from.
    Drawn {
        /// The parameter space's name.
        space: String,
        /// SHA-256 (hex) over the space.
        sha256: String,
    },
}

impl Population {
    /// Whether both are the same scenarios or the same space, whatever they are called.
    pub fn is_that_of(&self, other: &Self) -> bool {
        match (self, other) {
            (Self::Suite { sha256: a, .. }, Self::Suite { sha256: b, .. })
            | (Self::Drawn { sha256: a, .. }, Self::Drawn { sha256: b, .. }) => a == b,
            _ => false,
        }
    }

    /// What a figure is, as a sentence: the estimand.
    pub fn estimand(&self) -> String {
        match self {
            Self::Suite { name, cases, .. } => format!(
                "Each figure is the mean over the {cases} scenarios of {name} with equal weights, over fresh seeds. It holds \
                 for this mix of scenarios only. Gates with the same seed run the same scenarios: repeating one gives no \
                 new evidence."
            ),
            Self::Drawn { space, .. } => {
                format!("Each figure is that of episodes sampled from {space}. It holds for this distribution only.")
            }
        }
    }
}

impl fmt::Display for Population {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (what, name, sha256) = match self {
            Self::Suite { name, sha256, .. } => ("suite", name, sha256),
            Self::Drawn { space, sha256 } => ("space", space, sha256),
        };
        let short = sha256.get(..12).unwrap_or(sha256);
        write!(f, "{what} {name} ({short})")
    }
}

/// The episodes that are judged, and where they come from.
#[derive(Debug, Clone, PartialEq)]
pub struct Record {
    /// What they speak of.
    pub population: Population,
    /// The task.
    pub task: Arc<TaskSpec>,
    /// The robot.
    pub robot: String,
    /// The policy.
    pub policy: String,
    /// The dictionary's data set hash (SHA-256, hex).
    pub dataset_sha256: String,
    /// The episodes, in order of their index.
    pub trials: Vec<Trial>,
    /// Rows that were left out because they were drawn where success turns into failure: no operating rate.
    pub focused: u64,
    /// How many episodes the plan of a suite has in all; `None` where no suite was run.
    pub planned: Option<u64>,
    /// Whether the episodes were imported: their index then is a row's number and says nothing of the world.
    pub imported: bool,
}

impl Record {
    /// The rows of a dictionary that speak of its suite or its space.
    ///
    /// # Errors
    /// A row that cannot be read.
    pub fn of(dictionary: &Dictionary) -> Result<Self, GateError> {
        let hash = dictionary.dataset_hash();
        Self::collect(dictionary.provenance(), hash, dictionary.entries().map(|entry| entry.map_err(GateError::from)))
    }

    /// The record of a campaign that has no row yet; `provenance` holds its plan.
    ///
    /// # Errors
    /// A plan whose suite is not what it says.
    pub fn begun(provenance: &Provenance) -> Result<Self, GateError> {
        let (population, planned) = population(provenance, &[])?;
        Ok(Self {
            population,
            task: Arc::clone(&provenance.task),
            robot: provenance.robot.name.clone(),
            policy: provenance.policy.clone(),
            dataset_sha256: String::new(),
            trials: Vec::new(),
            focused: 0,
            planned,
            imported: provenance.source.is_some(),
        })
    }

    /// How the number of episodes came about, where `stated` is what is said of it: fewer episodes than the plan has are
    /// a run that somebody stopped, whatever is said.
    pub fn sampling(&self, stated: Sampling) -> Sampling {
        let stopped = self.planned.is_some_and(|planned| (self.trials.len() as u64) < planned);
        if stopped { Sampling::Sequential } else { stated }
    }

    /// The same record, where no episode says whether it failed in one of these ways.
    #[must_use]
    pub(crate) fn without(&self, modes: &[FailureMode]) -> Self {
        let mut record = self.clone();
        record.trials.iter_mut().for_each(|trial| trial.unseen.extend_from_slice(modes));
        record
    }

    fn collect(
        provenance: &Provenance,
        dataset_sha256: &str,
        entries: impl Iterator<Item = Result<Entry, GateError>>,
    ) -> Result<Self, GateError> {
        let not_recorded = provenance.source.iter().flat_map(|source| &source.not_recorded);
        let unseen: Vec<FailureMode> = not_recorded
            .filter_map(|name| FailureMode::new(name).ok())
            .filter(|mode| provenance.task.declares(*mode))
            .collect();
        let mut rows = Vec::new();
        let mut uneven = BTreeMap::new();
        for entry in entries {
            let entry = entry?;
            let named = ["uniform", "imported", "suite"].contains(&entry.stage.as_str());
            let focused = entry.stage == "boundary" || (!named && (entry.weight - 1.0).abs() > 0.0);
            *uneven.entry(entry.stage.clone()).or_insert(false) |= focused;
            rows.push((entry.stage.clone(), Trial::of(&entry, &unseen, provenance.schema_version)));
        }
        let all = rows.len();
        let trials: Vec<Trial> = rows
            .into_iter()
            .filter_map(|(stage, trial)| (!uneven.get(&stage).copied().unwrap_or(false)).then_some(trial))
            .collect();
        let imported = provenance.source.is_some();
        if imported {
            no_copies(&trials)?;
        }
        let (population, planned) = population(provenance, &trials)?;
        Ok(Self {
            population,
            planned,
            imported,
            task: Arc::clone(&provenance.task),
            robot: provenance.robot.name.clone(),
            policy: provenance.policy.clone(),
            dataset_sha256: dataset_sha256.to_owned(),
            focused: (all - trials.len()) as u64,
            trials,
        })
    }
}

/// What a run's plan says about the suite that it runs.
#[derive(Deserialize)]
struct SuitePlan {
    rounds: u64,
    sha256: String,
    suite: Suite,
}

impl SuitePlan {
    fn of(plan: &serde_json::Value) -> Result<Option<Self>, GateError> {
        let Some(suite) = plan.get("suite").filter(|suite| !suite.is_null()) else { return Ok(None) };
        let wrong = |reason: String| GateError::PlannedSuite { reason };
        let planned: Self =
            serde_json::from_value(suite.clone()).map_err(|error| wrong(format!("cannot be read: {error}")))?;
        let found = suite_sha256(&planned.suite);
        if found != planned.sha256 {
            return Err(wrong(format!("has SHA-256 {found}, and the plan says {}", planned.sha256)));
        }
        Ok(Some(planned))
    }
}

fn population(provenance: &Provenance, trials: &[Trial]) -> Result<(Population, Option<u64>), GateError> {
    Ok(match SuitePlan::of(&provenance.plan)? {
        Some(SuitePlan { rounds, sha256, suite }) => {
            let cases = suite.cases().len() as u64;
            let name = format!("{} {}", suite.name(), suite.version());
            (Population::Suite { name, sha256, cases }, Some(rounds.saturating_mul(cases)))
        }
        None => (drawn(provenance, trials), None),
    })
}

/// The seed that each row records for its world; `None` where one does not, or where it is one for all of several.
pub(crate) fn recorded_seeds(trials: &[Trial]) -> Option<Vec<i64>> {
    let seeds: Option<Vec<i64>> = trials
        .iter()
        .map(|trial| match trial.requested.get(SOURCE_SEED) {
            Some(Value::Integer(seed)) => Some(*seed),
            _ => None,
        })
        .collect();
    seeds.filter(|seeds| seeds.len() < 2 || seeds.iter().any(|seed| Some(seed) != seeds.first()))
}

/// Refuses the same episode twice, as far as rows say which episode they are.
fn no_copies(trials: &[Trial]) -> Result<(), GateError> {
    let Some(seeds) = recorded_seeds(trials) else { return Ok(()) };
    let mut seen: BTreeMap<String, u64> = BTreeMap::new();
    for (trial, seed) in trials.iter().zip(seeds) {
        let parameters: Vec<_> = trial.requested.iter().filter(|(name, _)| *name != SOURCE_ROW).collect();
        let Label { case, category, group } = &trial.label;
        let identity = format!("{seed} {case:?} {category:?} {group:?} {parameters:?}");
        if let Some(first) = seen.insert(identity, trial.index) {
            return Err(GateError::Copies { first, second: trial.index });
        }
    }
    Ok(())
}

/// The population of rows that are no suite's: their space, or the scenarios that their source names.
fn drawn(provenance: &Provenance, trials: &[Trial]) -> Population {
    let space = provenance.space.name().to_owned();
    let labels: BTreeSet<[&str; 3]> = trials
        .iter()
        .filter(|trial| !trial.label.is_empty())
        .map(|Trial { label: Label { case, category, group }, .. }| {
            [case, category, group].map(|word| word.as_deref().unwrap_or_default())
        })
        .collect();
    let nothing_known = provenance.space.parameters().iter().all(|parameter| &*parameter.name == SOURCE_ROW);
    let text = match &provenance.source {
        // Rows of which only their number is known are those of their file, and of no other.
        Some(source) if labels.is_empty() && nothing_known => serde_json::to_string(&source.sha256),
        _ if labels.is_empty() => serde_json::to_string(&provenance.space),
        _ => serde_json::to_string(&labels),
    };
    Population::Drawn { space, sha256: hex(&Sha256::digest(text.unwrap_or_default())) }
}
