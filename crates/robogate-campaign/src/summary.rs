//! Campaign summary. Each figure names the population that it estimates.

use std::collections::BTreeMap;
use std::sync::Arc;

use robogate_core::{FailureMode, FaultKind, Outcome, ParameterSpace, TaskSpec};
use robogate_dictionary::Entry;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::suite::Groups;
use crate::{Bins, MarginalEffect, OutcomeCounts, Plan, PlanError, Stage, SuiteSummary};

/// Campaign summary.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Summary {
    /// The version of this form.
    pub version: u32,
    /// The campaign's seed.
    pub seed: u64,
    /// What drew the points.
    pub sampler: String,
    /// The content hash of the dictionary's rows: equal hashes, equal data.
    pub dataset_hash: String,
    /// Episodes of all stages.
    pub episodes: u64,
    /// The success rate of the policy over the operating space, or over the suite where one was run.
    pub estimate: Estimate,
    /// The stages that were run.
    pub stages: Vec<StageSummary>,
    /// How the groups of the suite went, where one was run.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub suite: Option<SuiteSummary>,
}

impl Summary {
    /// The version of this form that is written here, and the newest that is read.
    pub const VERSION: u32 = 2;
}

/// A success rate and how far it can be trusted.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Estimate {
    /// The population that it estimates.
    pub population: Population,
    /// The stages whose episodes it is made from.
    pub stages: Vec<Stage>,
    /// The same in words.
    pub note: String,
    /// The rate; absent where no episode is valid.
    pub success_rate: Option<f64>,
    /// Wilson's 95 % interval; [0, 1] where no episode is valid.
    pub interval_95: [f64; 2],
}

/// The population that a figure estimates.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Population {
    /// The operating space, every parameter uniform in its own scale.
    OperatingSpace,
    /// The points of the boundary stage, crowded where success turns into failure: no rate over them is
    /// one of the operating space.
    FocusedDesign,
    /// The scenarios of a suite, each as often as any other: they were chosen, and no rate over them is one of
    /// an operating space.
    Suite,
}

impl Population {
    /// The population in words.
    pub fn describe(self) -> &'static str {
        match self {
            Self::OperatingSpace => "the operating space, every parameter uniform in its own scale",
            Self::Suite => "the scenarios of the suite, each as often as any other, not an operating space",
            Self::FocusedDesign => "the focused design around the failure boundary, not the operating space",
        }
    }
}

/// How one stage went.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct StageSummary {
    /// The stage.
    pub stage: Stage,
    /// The population that its rates estimate.
    pub population: Population,
    /// The same in words.
    pub note: String,
    /// Its episodes.
    pub episodes: u64,
    /// How many of them are evidence.
    pub valid: u64,
    /// How many are not, because the infrastructure failed.
    pub invalid: u64,
    /// How many of the valid ones succeeded.
    pub successes: u64,
    /// Their share; absent where no episode is valid.
    pub success_rate: Option<f64>,
    /// Wilson's 95 % interval of it; [0, 1] where no episode is valid.
    pub interval_95: [f64; 2],
    /// Every failure mode, also those that did not happen.
    pub failure_modes: Vec<ModeCount>,
    /// Why episodes are invalid.
    pub faults: Vec<FaultCount>,
    /// The marginal effect of each continuous parameter; of the uniform stage only.
    #[serde(default, skip_serializing_if = "Vec::is_empty", alias = "along")]
    pub marginal_effects: Vec<MarginalEffect>,
}

/// How often the policy failed in one way.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ModeCount {
    /// The failure mode.
    #[schemars(with = "String")]
    pub mode: FailureMode,
    /// Whether the task declares it; else the failure is of unknown kind.
    #[serde(default = "declared")]
    pub declared: bool,
    /// How often.
    pub episodes: u64,
    /// Its share of the failures; absent where nothing failed.
    pub share_of_failures: Option<f64>,
}

/// Summaries of earlier versions know declared modes alone.
fn declared() -> bool {
    true
}

/// How often one class of fault occurred.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct FaultCount {
    /// The class of fault (`diverged`, `setup`, `not_applied`, `bad_action`, `unavailable`).
    pub fault: String,
    /// How often.
    pub episodes: u64,
}

/// Counts a campaign's entries, one at a time, in memory that does not grow with their number.
#[derive(Debug)]
pub(crate) struct Summing {
    uniform: OutcomeCounts,
    boundary: OutcomeCounts,
    suite: OutcomeCounts,
    groups: Option<Groups>,
    faults: BTreeMap<(Stage, FaultKind), u64>,
    bins: Bins,
    task: Arc<TaskSpec>,
}

impl Summing {
    pub(crate) fn new(plan: &Plan, task: &Arc<TaskSpec>, space: &ParameterSpace) -> Result<Self, PlanError> {
        Ok(Self {
            uniform: OutcomeCounts::default(),
            boundary: OutcomeCounts::default(),
            suite: OutcomeCounts::default(),
            groups: plan.suite.as_ref().map(|stage| Groups::new(&stage.suite)),
            faults: BTreeMap::new(),
            bins: Bins::of(plan, space)?,
            task: Arc::clone(task),
        })
    }

    pub(crate) fn add(&mut self, stage: Stage, entry: &Entry) {
        let outcome = &entry.episode.outcome;
        match stage {
            Stage::Uniform => {
                self.uniform.add(outcome);
                self.bins.add(&entry.episode.scenario.requested, outcome);
            }
            Stage::Boundary => self.boundary.add(outcome),
            Stage::Suite => {
                self.suite.add(outcome);
                if let Some(groups) = &mut self.groups {
                    groups.add(entry);
                }
            }
        }
        if let Outcome::Invalid(fault) = outcome {
            *self.faults.entry((stage, fault.kind)).or_default() += 1;
        }
    }

    /// `rounds` of a suite were run.
    pub(crate) fn finish(mut self, plan: &Plan, rounds: u64, dataset_hash: String) -> Summary {
        let first = if plan.suite.is_some() { Stage::Suite } else { Stage::Uniform };
        let mut stages = vec![self.stage(first)];
        if plan.boundary.episodes > 0 {
            stages.push(self.stage(Stage::Boundary));
        }
        let suite = plan.suite.as_ref().zip(self.groups.take()).map(|(stage, groups)| groups.finish(stage, rounds));
        let (counts, population) = (self.counts(first), stages[0].population);
        Summary {
            version: Summary::VERSION,
            seed: plan.seed,
            sampler: plan.sampler.clone(),
            dataset_hash,
            episodes: self.uniform.total() + self.boundary.total() + self.suite.total(),
            estimate: Estimate {
                population,
                stages: vec![first],
                note: format!("estimates {}; from the {first} stage alone", population.describe()),
                success_rate: counts.success_rate(),
                interval_95: counts.interval_95(),
            },
            stages,
            suite,
        }
    }

    fn counts(&self, stage: Stage) -> &OutcomeCounts {
        match stage {
            Stage::Uniform => &self.uniform,
            Stage::Boundary => &self.boundary,
            Stage::Suite => &self.suite,
        }
    }

    fn stage(&self, stage: Stage) -> StageSummary {
        let counts = self.counts(stage);
        let population = match stage {
            Stage::Uniform => Population::OperatingSpace,
            Stage::Boundary => Population::FocusedDesign,
            Stage::Suite => Population::Suite,
        };
        let failures = counts.valid() - counts.success;
        let mode = |(mode, episodes)| {
            let share_of_failures = (failures > 0).then(|| episodes as f64 / failures as f64);
            ModeCount { mode, declared: self.task.declares(mode), episodes, share_of_failures }
        };
        StageSummary {
            stage,
            population,
            note: format!("estimates {}", population.describe()),
            episodes: counts.total(),
            valid: counts.valid(),
            invalid: counts.invalid,
            successes: counts.success,
            success_rate: counts.success_rate(),
            interval_95: counts.interval_95(),
            failure_modes: counts.modes(&self.task).map(mode).collect(),
            faults: self
                .faults
                .iter()
                .filter(|((of, _), _)| *of == stage)
                .map(|((_, fault), episodes)| FaultCount { fault: fault.to_string(), episodes: *episodes })
                .collect(),
            marginal_effects: match stage {
                Stage::Uniform => self.bins.marginal_effects(),
                Stage::Boundary | Stage::Suite => Vec::new(),
            },
        }
    }
}
