//! The episodes that are judged, and their population.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt;
use std::path::Path;
use std::sync::Arc;

use robogate_core::{FailureMode, Fault, FaultKind, Suite, TaskSpec, Value};
use robogate_dictionary::results::{SOURCE_EPISODE, SOURCE_ROW, recorded_seed};
use robogate_dictionary::{
    Controls, Dictionary, Entry, Label, LostEpisode, PolicyRecord, Provenance, Repeats, RowSampling, Stopping, hex,
    read_regular_text, suite_sha256,
};
use robogate_stats::format::counted;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

use crate::cases::repeated;
use crate::conditions::Conditions;
use crate::dependence::{RowGroups, divide};
use crate::figure::STAGE_SHARE;
use crate::{ActingWarner, Ending, GateError, RealEvidence, Sampling, Trial};

/// The file with what repeats of the first episodes of a gate, which run again after the last one.
pub const REPEATED: &str = "repeats.json";

/// The population that a set of episodes represents.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case", tag = "kind")]
pub enum Population {
    /// The scenarios of a suite with equal weights. Every rate is a mean over them.
    Suite {
        /// Its name.
        name: String,
        /// SHA-256 (hex) over its scenarios: ids, categories, groups and parameters.
        sha256: String,
        /// Number of scenarios.
        cases: u64,
        /// Whether each round draws new points of a space, whose name this is. The figures are then those of the space.
        #[serde(default, skip_serializing_if = "std::ops::Not::not")]
        fresh: bool,
    },
    /// The distribution that the rows were sampled from.
    Drawn {
        /// The parameter space's name.
        space: String,
        /// SHA-256 (hex) over the space.
        sha256: String,
    },
    /// The episodes of an imported file.
    Imported {
        /// SHA-256 (hex) over its scenarios, or over the file if its rows do not identify their scenarios.
        sha256: String,
        /// How the scenarios were chosen, as the user stated.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        sampling: Option<RowSampling>,
        /// Number of cases, if some have several episodes. Every figure then applies to exactly these cases. Absent if each
        /// episode has its own case, or if the file does not identify cases.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        cases: Option<u64>,
        /// What divides the episodes into groups that depend on each other. Every figure then applies to new groups.
        #[serde(default, skip_serializing_if = "Vec::is_empty")]
        groups: Vec<RowGroups>,
    },
}

impl Population {
    /// Whether both are the same scenarios or the same space. Names are ignored.
    pub fn is_that_of(&self, other: &Self) -> bool {
        match (self, other) {
            (Self::Suite { sha256: a, .. }, Self::Suite { sha256: b, .. })
            | (Self::Drawn { sha256: a, .. }, Self::Drawn { sha256: b, .. })
            | (Self::Imported { sha256: a, .. }, Self::Imported { sha256: b, .. }) => a == b,
            _ => false,
        }
    }

    /// The number of cases of imported episodes, if some have several.
    pub(crate) fn repeated_cases(&self) -> Option<u64> {
        match self {
            Self::Imported { cases, .. } => *cases,
            Self::Suite { .. } | Self::Drawn { .. } => None,
        }
    }

    /// What divides imported episodes into groups that depend on each other. Empty for others.
    pub fn groups(&self) -> &[RowGroups] {
        match self {
            Self::Imported { groups, .. } => groups,
            Self::Suite { .. } | Self::Drawn { .. } => &[],
        }
    }

    /// The estimand of this many valid episodes, of which some have a distinct trajectory, in a few sentences.
    pub(crate) fn estimand_of(&self, valid: u64, distinct: Option<u64>) -> String {
        let Some(distinct) = distinct else { return self.estimand() };
        let text = self.estimand();
        let text = if distinct < valid { text.replace(", over fresh seeds", "") } else { text };
        format!("{text} {distinct} of {valid} valid episodes have a distinct trajectory.")
    }

    /// The estimand in a few sentences.
    pub fn estimand(&self) -> String {
        if !self.groups().is_empty() {
            return format!(
                "The imported episodes come from {}, and those of one value or block are not independent. Each of them counts as one \
                 observation, the mean of its episodes. Each figure applies to new ones, of which these must be a random sample.",
                RowGroups::text(self.groups())
            );
        }
        match self {
            Self::Suite { name, cases, fresh: true, .. } => format!(
                "Each figure is that of episodes sampled from {name}, of which each round draws {cases} new points. It applies to this \
                 distribution only. Gates with the same seed draw the same points: repeating one gives no new evidence."
            ),
            Self::Suite { name, cases, .. } => format!(
                "Each figure is the mean over the {cases} scenarios of {name} with equal weights, over fresh seeds. It applies \
                 to this mix of scenarios only. Gates with the same seed run the same scenarios: repeating one gives no new \
                 evidence."
            ),
            Self::Drawn { space, .. } => {
                format!(
                    "Each figure estimates that of episodes sampled from {space}. It applies to this distribution only."
                )
            }
            Self::Imported { cases: Some(cases), .. } => {
                let these = if *cases == 1 { "this case" } else { "exactly these cases, in the same proportions" };
                format!(
                    "The imported episodes repeat {}. Each figure applies to new episodes of {these}, and to no other case. For a \
                     verdict on new cases, import one episode of each.",
                    counted(*cases, "case")
                )
            }
            Self::Imported { sampling, .. } => {
                let chosen = match sampling {
                    Some(RowSampling::Uniform) => "uniformly over the observed ranges, as stated at the import",
                    Some(RowSampling::Observed) => "as they occurred, as stated at the import",
                    None => "in a way that the file does not record",
                };
                format!(
                    "Each figure is that of the imported episodes, whose scenarios were chosen {chosen}. It applies to scenarios chosen \
                     in the same way only."
                )
            }
        }
    }
}

impl fmt::Display for Population {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (what, name, sha256) = match self {
            Self::Suite { name, sha256, fresh: true, .. } => ("space", name, sha256),
            Self::Suite { name, sha256, .. } => ("suite", name, sha256),
            Self::Drawn { space, sha256 } => ("space", space, sha256),
            Self::Imported { sha256, cases, groups, .. } => {
                let short = sha256.get(..12).unwrap_or(sha256);
                if !groups.is_empty() {
                    return write!(f, "imported episodes from {} ({short})", RowGroups::text(groups));
                }
                return match cases {
                    Some(cases) => write!(f, "imported episodes of {} ({short})", counted(*cases, "case")),
                    None => write!(f, "imported scenarios ({short})"),
                };
            }
        };
        let short = sha256.get(..12).unwrap_or(sha256);
        write!(f, "{what} {name} ({short})")
    }
}

/// The episodes that are judged, with their origin.
#[derive(Debug, Clone, PartialEq)]
pub struct Record {
    /// The population of the episodes.
    pub population: Population,
    /// The task.
    pub task: Arc<TaskSpec>,
    /// The robot.
    pub robot: String,
    /// SHA-256 (hex) over the files of the robot. `None` if it is unknown.
    pub robot_sha256: Option<String>,
    /// The policy.
    pub policy: String,
    /// SHA-256 (hex) of the policy. `None` if it is unknown, and for a policy that is built into RoboGate.
    pub policy_sha256: Option<String>,
    /// The dictionary's data set hash (SHA-256, hex).
    pub dataset_sha256: String,
    /// The episodes, in order of their index.
    pub trials: Vec<Trial>,
    /// Number of excluded rows that were sampled near the failure boundary. They do not estimate the operating rate.
    pub focused: u64,
    /// Number of episodes in the plan of a suite. `None` if no suite was run.
    pub planned: Option<u64>,
    /// Whether the episodes were imported. Their index is then a row number and does not identify a scenario.
    pub imported: bool,
    /// How the number of imported episodes was chosen, as the user stated. `None` if unknown.
    pub stopping: Option<Stopping>,
    /// Trials of the real robot. `None` if there are none.
    pub real: Option<RealEvidence>,
    /// The controls of the gate that ran the episodes. `None` if it ran none.
    pub controls: Option<Controls>,
    /// Whether a server answers for the policy.
    pub served: bool,
    /// What a success depends on besides the policy.
    pub conditions: Conditions,
    /// The warner that acted in the episodes. `None` if there was none.
    pub warner: Option<ActingWarner>,
}

impl Record {
    /// The rows of a dictionary that represent its suite or its space.
    ///
    /// # Errors
    /// If a row cannot be read.
    pub fn of(dictionary: &Dictionary) -> Result<Self, GateError> {
        let hash = dictionary.dataset_hash();
        Self::collect(dictionary.provenance(), hash, dictionary.entries().map(|entry| entry.map_err(GateError::from)))
    }

    /// The record of a campaign without rows. `provenance` contains its plan.
    ///
    /// # Errors
    /// If the suite of the plan does not match its hash.
    pub fn begun(provenance: &Provenance) -> Result<Self, GateError> {
        let (population, planned) = population(provenance, &[])?;
        Ok(Self {
            population,
            task: Arc::clone(&provenance.task),
            robot: provenance.robot.name.clone(),
            robot_sha256: provenance.robot.sha256.clone(),
            policy: provenance.policy.clone(),
            policy_sha256: provenance.policy_sha256(),
            dataset_sha256: String::new(),
            trials: Vec::new(),
            focused: 0,
            planned,
            imported: provenance.source.is_some(),
            stopping: provenance.source.as_ref().and_then(|source| source.stopping),
            real: None,
            controls: provenance.controls().cloned(),
            served: is_served(provenance),
            conditions: Conditions::of(provenance),
            warner: ActingWarner::of(provenance),
        })
    }

    /// Makes the episodes invalid whose earlier attempts an external policy began and lost. The policy may answer differently the
    /// second time: if it loses the episodes that it would have failed, the others look like successes.
    pub fn count_lost(&mut self, lost: &[LostEpisode]) {
        let begun: BTreeMap<u64, &str> =
            lost.iter().filter(|of| of.began && self.served).map(|of| (of.index, of.fault.as_str())).collect();
        for trial in self.trials.iter_mut().filter(|trial| trial.ending.is_valid()) {
            if let Some(fault) = begun.get(&trial.index) {
                let why = format!("an earlier attempt of this episode was lost after it began: {fault}");
                trial.ending = Ending::Invalid(Fault::new(FaultKind::Unavailable, why));
            }
        }
    }

    /// The same record with what the run's folder says about faults: the file [`REPEATED`], and attempts that were lost.
    ///
    /// # Errors
    /// A file that cannot be read.
    pub fn with_faults_in(mut self, folder: &Path) -> Result<Self, GateError> {
        let unreadable = |source| GateError::Unreadable { path: folder.join(LostEpisode::FILE), source };
        self.count_lost(&LostEpisode::all(folder).map_err(unreadable)?);
        let path = folder.join(REPEATED);
        if !path.exists() {
            return Ok(self);
        }
        let text = read_regular_text(&path).map_err(|source| GateError::Unreadable { path: path.clone(), source })?;
        let later: Repeats =
            serde_json::from_str(&text).map_err(|error| GateError::Syntax(format!("{}: {error}", path.display())))?;
        let mut controls = self.controls.unwrap_or_default();
        controls.repeats = Some(controls.repeats.map_or(later, |earlier| earlier.and(later)));
        self.controls = Some(controls);
        Ok(self)
    }

    /// How the number of episodes was chosen. `stated` is what the user says. Fewer episodes than planned mean that the
    /// run was stopped, so the sampling was sequential even if the user states otherwise. If it is not known how the
    /// number of imported episodes was chosen, the sequential test is used, because it is valid for any number.
    pub fn sampling(&self, stated: Sampling) -> Sampling {
        let planned = self.planned.is_some_and(|planned| (self.trials.len() as u64) < planned);
        let stopped = planned || (self.imported && self.stopping != Some(Stopping::Fixed));
        if stopped { Sampling::Sequential } else { stated }
    }

    /// The same record, with the result of these failure modes unknown for every episode.
    #[must_use]
    pub(crate) fn without(&self, modes: &[FailureMode]) -> Self {
        let mut record = self.clone();
        record.trials.iter_mut().for_each(|trial| trial.unseen.extend_from_slice(modes));
        record
    }

    /// The same record, with the share of the way to success as a measure of every valid trial.
    #[must_use]
    pub(crate) fn with_stages(&self) -> Self {
        let mut record = self.clone();
        for trial in record.trials.iter_mut().filter(|trial| trial.ending.is_valid()) {
            let share = self.task.stage_share(trial.ending == Ending::Success, &trial.measures);
            trial.measures.set(STAGE_SHARE, share);
        }
        record
    }

    /// The same record, whose imported episodes depend on each other within equal values of these columns.
    ///
    /// # Errors
    /// If the episodes were not imported, or have no such column. The text says what is wrong.
    pub(crate) fn grouped_by(&self, columns: &[String]) -> Result<Self, String> {
        let mut record = self.clone();
        let Population::Imported { groups, .. } = &mut record.population else {
            return Err("`groups` names columns of imported episodes, and these were run by RoboGate".to_owned());
        };
        let unknown = |name: String| {
            format!(
                "the episodes have no column `{name}`, which `groups` names\nHint: a column that was imported as the group is named group"
            )
        };
        *groups = divide(&mut record.trials, columns, true).map_err(unknown)?;
        Ok(record)
    }

    /// The same record, whose rows are fewer than those that were divided into groups.
    #[must_use]
    pub(crate) fn divided_again(mut self) -> Self {
        if let Population::Imported { cases, groups, .. } = &mut self.population {
            *groups = divide(&mut self.trials, &[], cases.is_some()).unwrap_or_default();
        }
        self
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
            // The episodes of an active stage that its model did not choose are a sample from the operating space.
            let sampled = entry.stage == "active" && entry.design == "uniform";
            let focused = entry.is_chosen() || (!sampled && !named && (entry.weight - 1.0).abs() > 0.0);
            let part = (entry.stage.clone(), sampled);
            *uneven.entry(part.clone()).or_insert(false) |= focused;
            rows.push((part, Trial::of(&entry, &unseen)));
        }
        let all = rows.len();
        let trials: Vec<Trial> = rows
            .into_iter()
            .filter_map(|(part, trial)| (!uneven.get(&part).copied().unwrap_or(false)).then_some(trial))
            .collect();
        let imported = provenance.source.is_some();
        if imported {
            no_copies(&trials)?;
        }
        let (population, planned) = population(provenance, &trials)?;
        let record = Self {
            population,
            planned,
            imported,
            stopping: provenance.source.as_ref().and_then(|source| source.stopping),
            real: None,
            task: Arc::clone(&provenance.task),
            robot: provenance.robot.name.clone(),
            robot_sha256: provenance.robot.sha256.clone(),
            policy: provenance.policy.clone(),
            policy_sha256: provenance.policy_sha256(),
            dataset_sha256: dataset_sha256.to_owned(),
            focused: (all - trials.len()) as u64,
            controls: provenance.controls().cloned(),
            served: is_served(provenance),
            conditions: Conditions::of(provenance),
            warner: ActingWarner::of(provenance),
            trials,
        };
        Ok(record.divided_again())
    }
}

/// Whether a server answers for the policy: another process, which may answer differently the second time.
fn is_served(provenance: &Provenance) -> bool {
    let policy = provenance.world.as_ref().and_then(|world| world.policy.as_ref());
    matches!(policy, Some(PolicyRecord::External(policy)) if !policy.is_file())
}

/// The suite of a run's plan.
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
            return Err(wrong(format!("has the SHA-256 {found}, but the plan states {}", planned.sha256)));
        }
        Ok(Some(planned))
    }
}

fn population(provenance: &Provenance, trials: &[Trial]) -> Result<(Population, Option<u64>), GateError> {
    Ok(match SuitePlan::of(&provenance.plan)? {
        Some(SuitePlan { rounds, sha256, suite }) => {
            let cases = suite.cases().len() as u64;
            let episodes = Some(rounds.saturating_mul(cases));
            let fresh = suite.is_fresh();
            let name = if fresh { suite.name().to_owned() } else { format!("{} {}", suite.name(), suite.version()) };
            (Population::Suite { name, sha256, cases, fresh }, episodes)
        }
        None => (space_or_cases(provenance, trials), None),
    })
}

/// The scenario seed of each row. `None` if a row has none, or if several rows share one.
pub(crate) fn recorded_seeds(trials: &[Trial]) -> Option<Vec<i64>> {
    let seeds: Option<Vec<i64>> = trials.iter().map(|trial| recorded_seed(&trial.requested)).collect();
    seeds.filter(|seeds| seeds.len() < 2 || seeds.iter().any(|seed| Some(seed) != seeds.first()))
}

/// The number of the episode within its case, for sources without seeds. `None` if a row has none.
pub(crate) fn recorded_numbers(trials: &[Trial]) -> Option<Vec<i64>> {
    let number = |trial: &Trial| match trial.requested.get(SOURCE_EPISODE) {
        Some(Value::Integer(number)) => Some(*number),
        _ => None,
    };
    trials.iter().map(number).collect()
}

/// Returns an error if an episode occurs twice, as far as rows identify their episode.
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

/// The population of rows without a suite: their space, or the scenarios that their source names.
fn space_or_cases(provenance: &Provenance, trials: &[Trial]) -> Population {
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
        // Rows that are identified only by their number represent their own file and no other.
        Some(source) if labels.is_empty() && nothing_known => serde_json::to_string(&source.sha256),
        _ if labels.is_empty() => serde_json::to_string(&provenance.space),
        _ => serde_json::to_string(&labels),
    };
    let sha256 = hex(&Sha256::digest(text.unwrap_or_default()));
    match &provenance.source {
        Some(source) => {
            let cases = repeated(&provenance.space, trials);
            Population::Imported { sha256, sampling: source.sampling, cases, groups: Vec::new() }
        }
        None => Population::Drawn { space, sha256 },
    }
}
