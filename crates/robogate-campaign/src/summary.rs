//! Campaign summary. Each figure names the population that it estimates.

use std::collections::BTreeMap;
use std::sync::Arc;

use robogate_core::{FEASIBLE, FailureMode, FaultKind, Outcome, OutsideRange, ParameterSpace, TaskSpec, is_feasible};
use robogate_dictionary::{Entry, Provenance};
use robogate_stats::weighted::hajek;
use robogate_stats::weighted_events::event_rate;
use robogate_stats::{Confidence, Trials, wilson};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::suite::Groups;
use crate::{Bins, MarginalEffect, OutcomeCounts, Plan, PlanError, RowsError, RunAgain, RunError, Stage, SuiteSummary};

/// Campaign summary.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Summary {
    /// The version of the file format.
    pub version: u32,
    /// The campaign's seed.
    pub seed: u64,
    /// The sampler of the points.
    pub sampler: String,
    /// The content hash of the dictionary's rows. Equal hashes mean equal data.
    pub dataset_hash: String,
    /// Episodes of all stages.
    pub episodes: u64,
    /// The success rate of the policy over the operating space, or over the suite if one was run.
    pub estimate: Estimate,
    /// The rate of the failure mode that the plan seeks. Absent if it seeks none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sought: Option<Sought>,
    /// The completed stages.
    pub stages: Vec<StageSummary>,
    /// The outcomes of the suite's groups, if one was run.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub suite: Option<SuiteSummary>,
    /// Episodes that ran again, because infrastructure faults lost earlier attempts. Absent if there were none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub run_again: Option<RunAgain>,
    /// How often the policy saw states outside of the published range of its checkpoint. Absent if the range is unknown.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub outside_range: Option<OutsideRange>,
}

impl Summary {
    /// The version of the file format that is written, and the newest one that is read.
    pub const VERSION: u32 = 2;

    /// The summary of the rows of a complete campaign. Episodes that ran again are not known from them.
    ///
    /// # Errors
    /// The provenance contains no plan of a campaign, or a row cannot be read.
    pub fn of_rows<E>(
        provenance: &Provenance,
        dataset_hash: String,
        rows: impl Iterator<Item = Result<Entry, E>>,
    ) -> Result<Self, RowsError>
    where
        RowsError: From<E>,
    {
        let plan: Plan = serde_json::from_value(provenance.plan.clone()).map_err(RowsError::NoPlan)?;
        plan.check(&provenance.space).map_err(RunError::from)?;
        let mut summing = Summing::new(&plan, &provenance.task, &provenance.space).map_err(RunError::from)?;
        let mut episodes = 0;
        for row in rows {
            summing.add(&row?);
            episodes += 1;
        }
        let rounds = plan.suite.as_ref().map_or(0, |suite| episodes / suite.scenarios().max(1));
        Ok(summing.finish(&plan, rounds, dataset_hash))
    }
}

/// A success rate with its confidence interval.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Estimate {
    /// The population that it estimates.
    pub population: Population,
    /// The stages whose episodes are used.
    pub stages: Vec<Stage>,
    /// The population as text.
    pub note: String,
    /// The success rate. Absent if no episode is valid.
    pub success_rate: Option<f64>,
    /// Wilson's 95 % interval, with the effective number of episodes if they have weights. [0, 1] if no episode is valid.
    pub interval_95: [f64; 2],
}

/// The rate of one failure mode over the operating space, from all episodes by their weights.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Sought {
    /// The failure mode.
    pub mode: String,
    /// The number of episodes that failed in this way.
    pub failures: u64,
    /// The number of valid episodes.
    pub valid: u64,
    /// The rate. Absent if no episode is valid.
    pub rate: Option<f64>,
    /// The 95 % interval of Fay and Feuer (1997), which covers at few failures as well. [0, 1] if no episode is valid.
    pub interval_95: [f64; 2],
    /// The number of uniform episodes that would give the same standard error. Absent without a failure.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub worth_episodes: Option<f64>,
}

/// The population that a figure estimates.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Population {
    /// The operating space, with every parameter uniform in its scale.
    OperatingSpace,
    /// The points of the boundary or the active stage. They concentrate around the boundary, or where a failure is likely, so a
    /// rate over them does not estimate the operating space.
    FocusedDesign,
    /// The scenarios of a suite, equally weighted. They were chosen, so a rate over them does not estimate an operating
    /// space.
    Suite,
}

impl Population {
    /// The population as text.
    pub fn describe(self) -> &'static str {
        match self {
            Self::OperatingSpace => "the operating space, with every parameter uniform in its scale",
            Self::Suite => "the scenarios of the suite, equally weighted, not an operating space",
            Self::FocusedDesign => "the focused design around the failure boundary, not the operating space",
        }
    }
}

/// The summary of one stage.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct StageSummary {
    /// The stage.
    pub stage: Stage,
    /// The population that its rates estimate.
    pub population: Population,
    /// The population as text.
    pub note: String,
    /// Episodes of the stage.
    pub episodes: u64,
    /// The number of valid episodes.
    pub valid: u64,
    /// The number of invalid episodes, ended by a fault.
    pub invalid: u64,
    /// The number of successes among the valid episodes.
    pub successes: u64,
    /// The share of successes among the valid episodes. Absent if none is valid.
    pub success_rate: Option<f64>,
    /// Wilson's 95 % interval of the success rate. [0, 1] if no episode is valid.
    pub interval_95: [f64; 2],
    /// The feasible part of the episodes. Absent if the task does not check feasibility.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub feasible: Option<FeasiblePart>,
    /// Every failure mode, including those that did not occur.
    pub failure_modes: Vec<ModeCount>,
    /// The faults of invalid episodes.
    pub faults: Vec<FaultCount>,
    /// The marginal effect of each continuous parameter, for the uniform stage only.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub marginal_effects: Vec<MarginalEffect>,
}

/// The episodes whose scenario some policy may complete.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct FeasiblePart {
    /// The number of valid episodes in the feasible part.
    pub valid: u64,
    /// The number of successes among them.
    pub successes: u64,
    /// The share of the stage's valid episodes that is feasible. Absent if none is valid.
    pub share: Option<f64>,
    /// The success rate over the feasible part. Absent if it has no valid episode.
    pub success_rate: Option<f64>,
    /// Wilson's 95 % interval of the success rate. [0, 1] without a valid episode.
    pub interval_95: [f64; 2],
}

/// The count of one failure mode.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ModeCount {
    /// The failure mode.
    #[schemars(with = "String")]
    pub mode: FailureMode,
    /// Whether the task declares the mode. Otherwise the failure has an unknown kind.
    pub declared: bool,
    /// The number of episodes.
    pub episodes: u64,
    /// The share of the failures. Absent if there are none.
    pub share_of_failures: Option<f64>,
}

/// The count of one class of fault.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct FaultCount {
    /// The class of fault (`diverged`, `setup`, `not_applied`, `bad_action`, `unavailable`).
    pub fault: String,
    /// The number of episodes.
    pub episodes: u64,
}

/// Counts the entries of a campaign one at a time, in constant memory.
#[derive(Debug)]
pub(crate) struct Summing {
    uniform: OutcomeCounts,
    boundary: OutcomeCounts,
    active: OutcomeCounts,
    is_active: bool,
    /// Whether the scenarios of the suite are new points of its space in each round.
    is_fresh: bool,
    /// Outcome and weight of every valid episode, if there is an active stage.
    weighted: Vec<(bool, f64)>,
    /// The failure mode that the plan seeks, and whether each of these episodes failed in this way.
    sought: Option<(FailureMode, Vec<bool>)>,
    suite: OutcomeCounts,
    groups: Option<Groups>,
    faults: BTreeMap<(Stage, FaultKind), u64>,
    /// The outcomes of feasible episodes.
    feasible: BTreeMap<Stage, OutcomeCounts>,
    bins: Bins,
    outside_range: Option<OutsideRange>,
    task: Arc<TaskSpec>,
    /// The number of episodes of the uniform stage.
    uniform_episodes: u64,
    has_suite: bool,
}

impl Summing {
    pub(crate) fn new(plan: &Plan, task: &Arc<TaskSpec>, space: &ParameterSpace) -> Result<Self, PlanError> {
        Ok(Self {
            uniform: OutcomeCounts::default(),
            boundary: OutcomeCounts::default(),
            active: OutcomeCounts::default(),
            is_active: plan.active.is_some(),
            is_fresh: plan.suite.as_ref().is_some_and(|stage| stage.suite.is_fresh()),
            weighted: Vec::new(),
            sought: plan
                .active
                .as_ref()
                .and_then(|stage| stage.seek.as_deref())
                .map(|mode| (FailureMode::from_foreign(mode), Vec::new())),
            suite: OutcomeCounts::default(),
            groups: plan.suite.as_ref().map(|stage| Groups::new(&stage.suite)),
            faults: BTreeMap::new(),
            feasible: BTreeMap::new(),
            bins: Bins::of(plan, space)?,
            outside_range: OutsideRange::of(task),
            task: Arc::clone(task),
            uniform_episodes: plan.uniform.episodes,
            has_suite: plan.suite.is_some(),
        })
    }

    pub(crate) fn add(&mut self, entry: &Entry) {
        let stage = match entry.index() {
            _ if self.has_suite => Stage::Suite,
            index if index < self.uniform_episodes => Stage::Uniform,
            _ if self.is_active => Stage::Active,
            _ => Stage::Boundary,
        };
        let outcome = &entry.episode.outcome;
        match stage {
            Stage::Uniform => {
                self.uniform.add(outcome);
                self.bins.add(&entry.episode.scenario.requested, outcome);
            }
            Stage::Boundary => self.boundary.add(outcome),
            Stage::Active => self.active.add(outcome),
            Stage::Suite => {
                self.suite.add(outcome);
                if let Some(groups) = &mut self.groups {
                    groups.add(entry);
                }
            }
        }
        if self.is_active && !matches!(outcome, Outcome::Invalid(_)) {
            self.weighted.push((*outcome == Outcome::Success, entry.weight));
            if let Some((mode, events)) = &mut self.sought {
                events.push(matches!(outcome, Outcome::Failure(failed) if failed == mode));
            }
        }
        if let Some(outside) = &mut self.outside_range {
            outside.add(&entry.episode.measures);
        }
        if is_feasible(&entry.episode.measures) == Some(true) {
            self.feasible.entry(stage).or_default().add(outcome);
        }
        if let Outcome::Invalid(fault) = outcome {
            *self.faults.entry((stage, fault.kind)).or_default() += 1;
        }
    }

    /// Completes the summary. `rounds` is the number of completed rounds of a suite.
    pub(crate) fn finish(mut self, plan: &Plan, rounds: u64, dataset_hash: String) -> Summary {
        let first = if plan.suite.is_some() { Stage::Suite } else { Stage::Uniform };
        let mut stages = vec![self.stage(first)];
        if plan.boundary.episodes > 0 {
            stages.push(self.stage(Stage::Boundary));
        }
        if plan.active.is_some() {
            stages.push(self.stage(Stage::Active));
        }
        let suite = plan.suite.as_ref().zip(self.groups.take()).map(|(stage, groups)| groups.finish(stage, rounds));
        let (counts, population) = (self.counts(first), stages[0].population);
        Summary {
            version: Summary::VERSION,
            seed: plan.seed,
            sampler: plan.sampler.clone(),
            dataset_hash,
            episodes: self.uniform.total() + self.boundary.total() + self.active.total() + self.suite.total(),
            estimate: self.reweighted().unwrap_or_else(|| Estimate {
                population,
                stages: vec![first],
                note: format!("estimates {}; from the {first} stage alone", population.describe()),
                success_rate: counts.success_rate(),
                interval_95: counts.interval_95(),
            }),
            sought: self.sought_rate(),
            stages,
            suite,
            run_again: None,
            outside_range: self.outside_range.map(OutsideRange::sorted),
        }
    }

    /// The success rate from the uniform and the active stage, by their weights. `None` without an active stage.
    fn reweighted(&self) -> Option<Estimate> {
        let (outcomes, weights): (Vec<bool>, Vec<f64>) = self.weighted.iter().copied().unzip();
        // Without an active stage there are no rows. The weights of an active stage are valid.
        let found = hajek(&outcomes, &weights, Confidence::P95).ok().filter(|found| found.rows > 0)?;
        let population = Population::OperatingSpace;
        // Equal weights are none: the interval is that of the same counts in an analysis.
        let equal = weights.windows(2).all(|pair| pair[0].to_bits() == pair[1].to_bits());
        let interval =
            if equal { wilson(Trials::count(outcomes.iter().copied()), Confidence::P95) } else { found.interval };
        Some(Estimate {
            population,
            stages: vec![Stage::Uniform, Stage::Active],
            note: format!("estimates {}; from all episodes, by their weights", population.describe()),
            success_rate: found.rate,
            interval_95: [interval.low, interval.high],
        })
    }

    fn sought_rate(&self) -> Option<Sought> {
        let (mode, events) = self.sought.as_ref()?;
        let weights: Vec<f64> = self.weighted.iter().map(|(_, weight)| *weight).collect();
        // The weights of an active stage are valid.
        let found = event_rate(events, &weights, Confidence::P95).ok()?;
        Some(Sought {
            mode: mode.to_string(),
            failures: found.events,
            valid: found.rows,
            rate: found.rate,
            interval_95: [found.interval.low, found.interval.high],
            worth_episodes: found.worth,
        })
    }

    fn counts(&self, stage: Stage) -> &OutcomeCounts {
        match stage {
            Stage::Uniform => &self.uniform,
            Stage::Boundary => &self.boundary,
            Stage::Active => &self.active,
            Stage::Suite => &self.suite,
        }
    }

    fn feasible_part(&self, stage: Stage, all: &OutcomeCounts) -> FeasiblePart {
        let counts = self.feasible.get(&stage).cloned().unwrap_or_default();
        FeasiblePart {
            valid: counts.valid(),
            successes: counts.success,
            share: (all.valid() > 0).then(|| counts.valid() as f64 / all.valid() as f64),
            success_rate: counts.success_rate(),
            interval_95: counts.interval_95(),
        }
    }

    fn stage(&self, stage: Stage) -> StageSummary {
        let counts = self.counts(stage);
        let population = match stage {
            Stage::Uniform => Population::OperatingSpace,
            Stage::Boundary | Stage::Active => Population::FocusedDesign,
            Stage::Suite if self.is_fresh => Population::OperatingSpace,
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
            feasible: self.task.measure(FEASIBLE.as_str()).map(|_| self.feasible_part(stage, counts)),
            failure_modes: counts.modes(&self.task).map(mode).collect(),
            faults: self
                .faults
                .iter()
                .filter(|((of, _), _)| *of == stage)
                .map(|((_, fault), episodes)| FaultCount { fault: fault.to_string(), episodes: *episodes })
                .collect(),
            marginal_effects: match stage {
                Stage::Uniform => self.bins.marginal_effects(),
                Stage::Boundary | Stage::Active | Stage::Suite => Vec::new(),
            },
        }
    }
}
