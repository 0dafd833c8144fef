//! The episodes that are judged, and what they speak of.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt;

use robogate_core::{FailureMode, Suite};
use robogate_dictionary::{Dictionary, Entry, Label, Provenance};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

use crate::{GateError, Trial};

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
                "Each figure is the mean over the {cases} scenarios of {name}, each counted alike, over fresh seeds: \
                 it speaks of that mix and of no other."
            ),
            Self::Drawn { space, .. } => format!(
                "Each figure is that of episodes drawn from {space}, as its rows were drawn: it speaks of that \
                 distribution and of no other."
            ),
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
    pub fn begun(provenance: &Provenance) -> Self {
        let population = population(provenance, &[]);
        Self {
            population,
            robot: provenance.robot.name.clone(),
            policy: provenance.policy.clone(),
            dataset_sha256: String::new(),
            trials: Vec::new(),
            focused: 0,
        }
    }

    fn collect(
        provenance: &Provenance,
        dataset_sha256: &str,
        entries: impl Iterator<Item = Result<Entry, GateError>>,
    ) -> Result<Self, GateError> {
        let not_recorded = provenance.source.iter().flat_map(|source| &source.not_recorded);
        let unseen: Vec<FailureMode> =
            not_recorded.filter_map(|word| FailureMode::ALL.into_iter().find(|mode| mode.word() == word)).collect();
        let mut rows = Vec::new();
        let mut uneven = BTreeMap::new();
        for entry in entries {
            let entry = entry?;
            let named = ["uniform", "imported", "suite"].contains(&entry.stage.as_str());
            let focused = entry.stage == "boundary" || (!named && (entry.weight - 1.0).abs() > 0.0);
            *uneven.entry(entry.stage.clone()).or_insert(false) |= focused;
            rows.push((entry.stage.clone(), Trial::of(&entry, &unseen)));
        }
        let all = rows.len();
        let trials: Vec<Trial> = rows
            .into_iter()
            .filter_map(|(stage, trial)| (!uneven.get(&stage).copied().unwrap_or(false)).then_some(trial))
            .collect();
        Ok(Self {
            population: population(provenance, &trials),
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
    sha256: String,
    suite: Suite,
}

impl SuitePlan {
    fn of(plan: &serde_json::Value) -> Option<Self> {
        serde_json::from_value(plan.get("suite")?.clone()).ok()
    }
}

fn population(provenance: &Provenance, trials: &[Trial]) -> Population {
    match SuitePlan::of(&provenance.plan) {
        Some(SuitePlan { sha256, suite }) => Population::Suite {
            name: format!("{} {}", suite.name(), suite.version()),
            sha256,
            cases: suite.cases().len() as u64,
        },
        None => drawn(provenance, trials),
    }
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
    let text =
        if labels.is_empty() { serde_json::to_string(&provenance.space) } else { serde_json::to_string(&labels) };
    Population::Drawn { space, sha256: hex(&Sha256::digest(text.unwrap_or_default())) }
}

pub(crate) fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}
