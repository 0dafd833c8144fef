//! Evaluates every requirement and derives the verdict.
//!
//! **Pass** claims that every requirement is met. Each must be shown at error α. The joint claim is then wrong with
//! probability α at most, without adjustment: an intersection-union test (Berger 1982). **Fail** claims that at least
//! one requirement is violated. That is a union of tests, so Holm's procedure divides the error α among them. Both
//! error rates are controlled at the same time.
//!
//! If each "met" must also hold on its own, [`Family::Holm`] adjusts these as well.

use std::collections::BTreeMap;

use robogate_core::{OutsideRange, TaskSpec, is_feasible};
use robogate_dictionary::{Controls, Label, TaskIdentity};
use robogate_stats::multiplicity::holm;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::comparison::{Against, Comparison};
use crate::conditions::changed_settings;
use crate::dependence::mean_over_groups;
use crate::figure::{Extremes, applies, figure};
use crate::next_budget::NextBudget;
use crate::remarks::{clipped_actions, copies, distinct_trajectories};
use crate::requirement_test::{How, success_interval, test};
use crate::rounds::Rounds;
use crate::ruled_out::RuledOut;
use crate::scope::{Scope, expand};
use crate::{
    Baseline, Bound, ConfidenceScore, Ending, Family, ForceLimitResult, GateError, Metric, Mode, NewCases, NominalRate,
    Population, ProductionFigures, RealEvidence, Record, Requirement, Requirements, Trial, Twins, Verdict,
    WarnerEffect,
};

/// How the number of episodes was chosen. It determines which test is valid.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Sampling {
    /// Fixed before the first episode: one exact test.
    Fixed,
    /// Decided while results came in: anytime-valid tests, at the end of each round.
    Sequential,
}

/// The result of one requirement.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Status {
    /// The requirement is met.
    Met,
    /// The requirement is violated.
    Violated,
    /// Neither is shown.
    Undecided,
    /// No episode has a value for its metric.
    NoEvidence,
}

impl Status {
    /// The name in data and reports.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Met => "met",
            Self::Violated => "violated",
            Self::Undecided => "undecided",
            Self::NoEvidence => "no evidence",
        }
    }
}

/// Numbers of episodes.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct Counts {
    /// All episodes that were judged.
    pub episodes: u64,
    /// Valid episodes.
    pub valid: u64,
    /// Invalid episodes.
    pub invalid: u64,
    /// Complete rounds of the suite among them. `None` without a suite.
    pub rounds: Option<u64>,
    /// Episodes after the last complete round, which are not judged.
    pub left_over: u64,
    /// Episodes sampled near the failure boundary, which are not judged.
    pub focused: u64,
}

/// The evaluation of one requirement.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct RequirementResult {
    /// Its name in reports: metric and scope.
    pub id: String,
    /// The requirement.
    pub requirement: Requirement,
    /// The unit of its metric. Empty for rates and counts.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub unit: String,
    /// The requirement with its limit as a number.
    pub bound: Bound,
    /// Episodes in its scope that have a value for the metric.
    pub valid: u64,
    /// Episodes in its scope without a value: invalid ones, and failures whose mode was not recorded.
    pub invalid: u64,
    /// The observed figure.
    pub figure: Extremes,
    /// The mean over the groups of dependent imported episodes, each of which counts once. The requirement is tested for it. `None`
    /// without such groups, and for quantiles.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub over_groups: Option<f64>,
    /// One-sided bounds of the true figure, each at the confidence level of the requirements. They hold for any outcome
    /// of the invalid episodes. `None` in point mode and for quantiles.
    pub interval: Option<[f64; 2]>,
    /// p-value of the hypothesis "not met", for the worst outcome of the invalid episodes. `None` in point mode.
    pub p_met: Option<f64>,
    /// p-value of the hypothesis "met", for the best outcome of the invalid episodes. `None` in point mode.
    pub p_violated: Option<f64>,
    /// The status of the requirement.
    pub status: Status,
    /// The probability that a new gate of the same size decides. `None` if the requirement is decided or is not on a rate.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub next: Option<NextBudget>,
}

/// Success rate of one scenario group. It is informative and does not affect the verdict.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct GroupResult {
    /// The category. Empty if the episodes have none.
    pub category: String,
    /// The group. Empty if the episodes have none.
    pub group: String,
    /// Number of valid episodes.
    pub valid: u64,
    /// Number of invalid episodes.
    pub invalid: u64,
    /// Number of successes.
    pub successes: u64,
    /// 95 % interval of the success rate by the method of the requirements, with 2.5 % on each side: exact (Clopper-Pearson) for a
    /// fixed number of episodes, and that of the sequential test for others. It holds for any outcome of the invalid episodes.
    pub interval_95: [f64; 2],
    /// How the other episodes ended, the most frequent first.
    pub endings: Vec<EndingCount>,
}

/// A requirement that was not evaluated, or only in part.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct Dropped {
    /// Its name in reports.
    pub id: String,
    /// The reason, and what to do, in one sentence.
    pub because: String,
}

/// How often episodes ended in one way.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct EndingCount {
    /// A failure mode, `failure` if it is unknown, or `invalid`.
    pub ending: String,
    /// Number of episodes.
    pub episodes: u64,
}

/// The evaluation of a record as one versioned document.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Evaluation {
    /// Version of the format.
    pub format: u32,
    /// The verdict.
    pub verdict: Verdict,
    /// The reason for the verdict, in one sentence.
    pub because: String,
    /// The task.
    pub task: TaskIdentity,
    /// The robot.
    pub robot: String,
    /// The policy.
    pub policy: String,
    /// SHA-256 (hex) of the rows.
    pub dataset_sha256: String,
    /// The population of the figures.
    pub population: Population,
    /// The estimand, in a few sentences.
    pub estimand: String,
    /// How the number of episodes was chosen.
    pub sampling: Sampling,
    /// The largest number of rounds, if it was fixed before the first: the tests then end earlier.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub planned_rounds: Option<u64>,
    /// Numbers of episodes.
    pub counts: Counts,
    /// The requirements.
    pub requirements: Requirements,
    /// The baseline of relative requirements.
    pub baseline: Option<Baseline>,
    /// Trials of the real robot, for requirements on the real success rate.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub real: Option<RealEvidence>,
    /// Requirements that could not be evaluated on these episodes, or only in part.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub dropped: Vec<Dropped>,
    /// Number of distinct trajectories among the valid episodes. `None` if trajectories were not recorded.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub distinct_trajectories: Option<u64>,
    /// The success rate over the scenarios that some policy may complete. `None` if the task does not check feasibility.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub feasible: Option<FeasibleRate>,
    /// The success rate over new cases. `None` unless imported episodes repeat cases.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub new_cases: Option<NewCases>,
    /// The result of each requirement.
    pub results: Vec<RequirementResult>,
    /// Whether the policy may replace another one, if that was requested.
    pub comparison: Option<Comparison>,
    /// Figures of production. `None` if no duration was recorded.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub production: Option<ProductionFigures>,
    /// Success rates by scenario group.
    pub groups: Vec<GroupResult>,
    /// The confidence score. `None` if the requirements define none.
    pub score: Option<ConfidenceScore>,
    /// The controls of the gate. `None` if it ran none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub controls: Option<Controls>,
    /// Why no further episode can give a pass. `None` if a pass is still possible, or if all planned episodes ran.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub ruled_out: Option<RuledOut>,
    /// Settings of the task that are not those that it has by default, in words.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub changed_settings: Vec<String>,
    /// How often the policy saw states outside of the published range of its checkpoint. The verdict does not depend on it.
    /// `None` if the range is unknown.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub outside_range: Option<OutsideRange>,
    /// The episodes compared with their nominal twins. The verdict does not depend on it. `None` without a control arm.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub twins: Option<Twins>,
    /// The success rate with nothing varied. The verdict does not depend on it. `None` without such episodes.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub nominal: Option<NominalRate>,
    /// What a warner changed. The verdict applies to the policy with the warner. `None` if there was none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub warner: Option<WarnerEffect>,
    /// The mean share of control periods with an action outside of its range. `None` if it is not measured.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub clipped_actions: Option<f64>,
    /// The contacts that exceed each force limit.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub force_limits: Vec<ForceLimitResult>,
}

/// The success rate over the feasible part of the valid episodes.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct FeasibleRate {
    /// The number of valid episodes in the feasible part.
    pub valid: u64,
    /// The number of successes among them.
    pub successes: u64,
    /// The share of the valid episodes that is feasible.
    pub share: f64,
    /// 95 % interval of the success rate by the method of the requirements. [0, 1] without a feasible episode.
    pub interval_95: [f64; 2],
}

impl FeasibleRate {
    fn of(rounds: &Rounds<'_>, how: How) -> Option<Self> {
        let valid = |trial: &&Trial| trial.ending.is_valid();
        let all = rounds.trials().filter(valid).count();
        let mut part = Vec::with_capacity(rounds.rounds.len());
        for round in &rounds.rounds {
            let mut feasible = Vec::new();
            for trial in round.iter().copied().filter(valid) {
                if is_feasible(&trial.measures)? {
                    feasible.push(trial);
                }
            }
            part.push(feasible);
        }
        let valid = part.iter().map(Vec::len).sum::<usize>();
        let successes = part.iter().flatten().filter(|trial| trial.ending == Ending::Success).count() as u64;
        (all > 0).then(|| Self {
            valid: valid as u64,
            successes,
            share: valid as f64 / all as f64,
            interval_95: success_interval(&part, how),
        })
    }

    /// The success rate. `None` without a feasible episode.
    pub fn rate(&self) -> Option<f64> {
        (self.valid > 0).then(|| self.successes as f64 / self.valid as f64)
    }
}

/// The largest number of rounds of a suite that its plan fixes, for a sequential test.
fn budget(record: &Record, sampling: Sampling) -> Option<u64> {
    match (&record.population, record.planned, sampling) {
        (Population::Suite { cases, .. }, Some(planned), Sampling::Sequential) if *cases > 0 => Some(planned / cases),
        _ => None,
    }
}

/// Counts the states outside of the range of the checkpoint.
fn outside_range(record: &Record, rounds: &Rounds<'_>) -> Option<OutsideRange> {
    let mut outside = OutsideRange::of(&record.task)?;
    rounds.trials().for_each(|trial| outside.add(&trial.measures));
    Some(outside.sorted())
}

/// The question that is evaluated on a record.
#[derive(Debug, Clone, Copy)]
pub struct Question<'a> {
    /// The requirements.
    pub requirements: &'a Requirements,
    /// The baseline of relative requirements.
    pub baseline: Option<&'a Baseline>,
    /// The policy that may be replaced.
    pub against: Option<Against<'a>>,
    /// How the number of episodes was chosen. The record can override it ([`Record::sampling`]).
    pub sampling: Sampling,
}

impl Evaluation {
    /// The version of the format.
    pub const FORMAT: u32 = 3;

    /// Whether the trials of the real robot violate a requirement. No further episode changes that.
    pub fn is_violated_by_trials(&self) -> bool {
        let real = |result: &&RequirementResult| result.requirement.metric == Metric::RealSuccess;
        self.results.iter().filter(real).any(|result| result.status == Status::Violated)
    }

    /// Serialises the evaluation. Equal evaluations give equal bytes.
    pub fn to_json(&self) -> String {
        // Every number is finite, so serialisation cannot fail.
        serde_json::to_string_pretty(self).unwrap_or_default() + "\n"
    }
}

impl Question<'_> {
    /// Evaluates a record. Equal records give identical evaluations.
    ///
    /// # Errors
    /// If the question cannot be evaluated on this record: a baseline of another suite, a scope without episodes, or a
    /// requirement that cannot be met at any number of episodes.
    pub fn evaluate(&self, record: &Record) -> Result<Evaluation, GateError> {
        let requirements = self.requirements;
        requirements.check()?;
        let record = &*requirements.fit(record)?;
        if let Some(baseline) = self.baseline {
            baseline.check(record)?;
        }
        if let Some(real) = &record.real {
            real.check_subject(record)?;
        }
        let sampling = record.sampling(self.sampling);
        let rounds = Rounds::of(&record.trials, &record.population)?;
        let valid = rounds.trials().filter(|trial| trial.ending.is_valid()).count() as u64;
        let episodes = rounds.trials().count() as u64;
        let counts = Counts {
            episodes,
            valid,
            invalid: episodes - valid,
            rounds: rounds.suite.then_some(rounds.rounds.len() as u64),
            left_over: rounds.left_over,
            focused: record.focused,
        };
        let comparison = self.against.as_ref().map(|against| against.compare(record, sampling)).transpose()?;
        let (kept, dropped) = self.evaluable()?;
        let mut asked = Vec::new();
        for requirement in &kept {
            for one in expand(requirement, rounds.trials().map(|trial| &trial.label))? {
                asked.push(one);
            }
        }
        let alpha = requirements.alpha();
        // A comparison counts as one more requirement.
        let family = asked.len() + usize::from(comparison.is_some());
        let how = How {
            sampling,
            alpha,
            beta: alpha / family.max(1) as f64,
            suite: rounds.suite,
            mixed: rounds.suite || record.population.repeated_cases().is_some(),
            budget: budget(record, sampling),
            grouped: !record.population.groups().is_empty(),
        };
        let mut results = asked
            .iter()
            .map(|requirement| match requirement.metric {
                Metric::RealSuccess => self.real_result(requirement.clone(), record, how),
                _ => self.result(requirement.clone(), &record.task, &rounds, counts, how),
            })
            .collect::<Result<Vec<RequirementResult>, GateError>>()?;
        let mut comparison = comparison;
        self.decide(&mut results, comparison.as_mut(), alpha);
        let control = record.controls.as_ref().and_then(Controls::failure);
        let distinct = distinct_trajectories(rounds.trials());
        let control = control.or_else(|| copies(rounds.trials(), distinct));
        let (verdict, mut because) = match &control {
            Some(because) => (Verdict::Invalid, because.clone()),
            None => conclude(counts, &results, comparison.as_ref()),
        };
        let ruled_out = match verdict {
            Verdict::Inconclusive | Verdict::Invalid if control.is_none() => {
                self.ruled_out(record, &rounds, &results, how)?
            }
            _ => None,
        };
        if let Some(ruled_out) = &ruled_out {
            because = ruled_out.because(counts, comparison.as_ref());
        } else if requirements.mode == Mode::Confidence {
            results.iter_mut().for_each(|result| result.next = NextBudget::of(result, counts, how));
        }
        Ok(Evaluation {
            format: Evaluation::FORMAT,
            verdict,
            because,
            task: TaskIdentity::of(&record.task),
            robot: record.robot.clone(),
            policy: record.policy.clone(),
            dataset_sha256: record.dataset_sha256.clone(),
            population: record.population.clone(),
            estimand: record.population.estimand_of(counts.valid, distinct),
            sampling,
            planned_rounds: how.budget,
            counts,
            requirements: requirements.clone(),
            baseline: self.baseline.cloned(),
            real: record.real.clone(),
            dropped,
            distinct_trajectories: distinct,
            feasible: FeasibleRate::of(&rounds, how),
            new_cases: NewCases::of(&record.population, &rounds.trials().collect::<Vec<&Trial>>()),
            results,
            comparison,
            production: ProductionFigures::of(&rounds.trials().collect::<Vec<&Trial>>()),
            groups: groups(&rounds, how),
            score: ConfidenceScore::of(&requirements.score, self.baseline, rounds.rounds.iter().flatten().copied()),
            controls: record.controls.clone(),
            ruled_out,
            outside_range: outside_range(record, &rounds),
            changed_settings: changed_settings(&record.task),
            twins: None,
            nominal: None,
            warner: record.warner.as_ref().map(|of| WarnerEffect::of(of, record.trials.iter(), &BTreeMap::new())),
            clipped_actions: clipped_actions(rounds.trials()),
            force_limits: requirements.force_limit.iter().map(|limit| limit.result(rounds.trials())).collect(),
        })
    }

    /// The requirements that can be evaluated, and those that are dropped because they refer to a missing baseline.
    fn evaluable(&self) -> Result<(Vec<Requirement>, Vec<Dropped>), GateError> {
        let (mut kept, mut dropped) = (Vec::new(), Vec::new());
        for requirement in &self.requirements.requirement {
            let id = requirement.id();
            if requirement.at_most_times_baseline.is_none() || self.baseline.is_some() {
                kept.push(requirement.clone());
            } else if let Some(limit) = requirement.at_most {
                let because = format!("without a baseline only its absolute limit {limit} applies: pass --baseline");
                dropped.push(Dropped { id, because });
                kept.push(Requirement { at_most_times_baseline: None, ..requirement.clone() });
            } else {
                let because = "it refers to a baseline, and none was given: pass --baseline".to_owned();
                dropped.push(Dropped { id, because });
            }
        }
        match dropped.first() {
            Some(first) if kept.is_empty() => {
                Err(GateError::NoBaseline { what: format!("requirement `{}`", first.id) })
            }
            _ => Ok((kept, dropped)),
        }
    }

    pub(crate) fn result(
        &self,
        requirement: Requirement,
        task: &TaskSpec,
        rounds: &Rounds<'_>,
        counts: Counts,
        how: How,
    ) -> Result<RequirementResult, GateError> {
        let mode = self.requirements.mode;
        let id = requirement.id();
        let bound = requirement.bound(mode, self.baseline)?;
        let scope = Scope::of(&requirement);
        let scoped: Vec<Vec<&Trial>> = rounds
            .rounds
            .iter()
            .map(|round| round.iter().copied().filter(|trial| scope.holds(trial)).collect())
            .collect();
        let all = scoped.iter().flatten().copied();
        if counts.episodes > 0 && all.clone().next().is_none() {
            return Err(GateError::NoSuchScope { id, scope: scope.to_string(), known: known(rounds.trials()) });
        }
        let all = all.filter(|trial| applies(requirement.metric, trial));
        let over_groups =
            (how.grouped && mode == Mode::Confidence).then(|| mean_over_groups(&requirement, all.clone())).flatten();
        let (valid, invalid, figure) = figure(requirement.metric, all, requirement.range());
        let mut result = RequirementResult {
            id,
            unit: requirement.metric.unit(task),
            requirement,
            bound,
            valid,
            invalid,
            figure,
            over_groups,
            interval: None,
            p_met: None,
            p_violated: None,
            status: if valid == 0 { Status::NoEvidence } else { Status::Undecided },
            next: None,
        };
        if valid == 0 {
            return Ok(result);
        }
        match mode {
            Mode::Point => {
                let ends = [figure.least.unwrap_or(f64::NEG_INFINITY), figure.most.unwrap_or(f64::INFINITY)]
                    .map(|end| bound.holds(end));
                result.status = match ends {
                    [true, true] => Status::Met,
                    [false, false] => Status::Violated,
                    _ => Status::Undecided,
                };
            }
            Mode::Confidence => {
                let tested = test(&result.requirement, bound, &scoped, how)?;
                result.interval = tested.interval;
                result.p_met = Some(tested.p_met);
                result.p_violated = Some(tested.p_violated);
            }
        }
        Ok(result)
    }

    /// The result of a requirement on the real robot.
    fn real_result(&self, requirement: Requirement, record: &Record, how: How) -> Result<RequirementResult, GateError> {
        let mode = self.requirements.mode;
        let bound = requirement.bound(mode, self.baseline)?;
        let nothing = Extremes { observed: None, least: Some(0.0), most: Some(1.0) };
        let real = record.real.as_ref().filter(|real| real.trials() > 0);
        let figure = real.map_or(nothing, RealEvidence::figure);
        let mut result = RequirementResult {
            id: requirement.id(),
            unit: requirement.metric.unit(&record.task),
            requirement,
            bound,
            valid: real.map_or(0, RealEvidence::trials),
            invalid: 0,
            figure,
            over_groups: None,
            interval: None,
            p_met: None,
            p_violated: None,
            status: if real.is_none() { Status::NoEvidence } else { Status::Undecided },
            next: None,
        };
        match (real, mode, figure.observed) {
            (Some(_), Mode::Point, Some(rate)) => {
                result.status = if bound.holds(rate) { Status::Met } else { Status::Violated };
            }
            (Some(real), Mode::Confidence, _) => {
                let tested = real.test(bound, how.alpha);
                result.interval = tested.interval;
                result.p_met = Some(tested.p_met);
                result.p_violated = Some(tested.p_violated);
            }
            _ => {}
        }
        Ok(result)
    }

    /// Converts the p-values of the whole family to statuses.
    fn decide(&self, results: &mut [RequirementResult], comparison: Option<&mut Comparison>, alpha: f64) {
        let other = comparison.as_ref().map(|c| (c.p_met, c.p_violated));
        let point = self.requirements.mode == Mode::Point;
        let met: Vec<f64> = results.iter().map(|f| f.p_met.unwrap_or(1.0)).chain(other.map(|o| o.0)).collect();
        let violated: Vec<f64> =
            results.iter().map(|f| f.p_violated.unwrap_or(1.0)).chain(other.map(|o| o.1)).collect();
        // These are p-values by construction. Otherwise nothing is rejected.
        let adjusted = |p: &[f64]| holm(p).unwrap_or_else(|_| vec![1.0; p.len()]);
        let met = if self.requirements.family == Family::Holm { adjusted(&met) } else { met };
        let violated = adjusted(&violated);
        let status = |i: usize| {
            let below = |p: &[f64]| p.get(i).is_some_and(|p| *p <= alpha);
            // If both hypotheses are rejected, an assumption is violated. The cautious status is used.
            if below(&violated) {
                Status::Violated
            } else if below(&met) {
                Status::Met
            } else {
                Status::Undecided
            }
        };
        let last = results.len();
        for (i, result) in results.iter_mut().enumerate() {
            if !point && result.status != Status::NoEvidence {
                result.status = status(i);
            }
        }
        if let Some(comparison) = comparison
            && comparison.status != Status::NoEvidence
        {
            comparison.status = status(last);
        }
    }
}

fn conclude(counts: Counts, results: &[RequirementResult], comparison: Option<&Comparison>) -> (Verdict, String) {
    if counts.episodes == 0 {
        let because = if counts.left_over > 0 {
            format!("{} episodes are less than one complete round of the suite", counts.left_over)
        } else {
            "nothing was evaluated".to_owned()
        };
        return (Verdict::Invalid, because);
    }
    if counts.valid == 0 {
        return (Verdict::Invalid, format!("all {} episodes are invalid", counts.invalid));
    }
    let all: Vec<(&str, Status)> = results
        .iter()
        .map(|f| (f.id.as_str(), f.status))
        .chain(comparison.map(|c| (Comparison::ID, c.status)))
        .collect();
    let of =
        |status: Status| -> Vec<&str> { all.iter().filter(|(_, found)| *found == status).map(|(id, _)| *id).collect() };
    let (violated, open, none) = (of(Status::Violated), of(Status::Undecided), of(Status::NoEvidence));
    if !violated.is_empty() {
        (Verdict::Fail, format!("violated: {}", violated.join(", ")))
    } else if !none.is_empty() {
        (Verdict::Inconclusive, format!("no evidence about {}", none.join(", ")))
    } else if open.is_empty() && all.len() == 1 {
        (Verdict::Pass, "the requirement is met".to_owned())
    } else if open.is_empty() && !all.is_empty() {
        (Verdict::Pass, format!("all {} requirements are met", all.len()))
    } else {
        (Verdict::Inconclusive, format!("undecided: {}", open.join(", ")))
    }
}

/// The categories and groups of the episodes.
pub(crate) fn known<'a>(trials: impl Iterator<Item = &'a Trial>) -> String {
    let mut words: Vec<String> = Vec::new();
    for Label { category, group, .. } in trials.map(|trial| &trial.label) {
        let parts: Vec<&str> = [category, group].into_iter().flatten().map(String::as_str).collect();
        let word = parts.join("/");
        if !word.is_empty() && !words.contains(&word) {
            words.push(word);
        }
    }
    if words.is_empty() {
        "no categories or groups, because these are not episodes of a suite".to_owned()
    } else {
        words.join(", ")
    }
}

fn groups<'a>(rounds: &Rounds<'a>, how: How) -> Vec<GroupResult> {
    let mut found: Vec<&Label> = Vec::new();
    let same = |a: &Label, b: &Label| (&a.category, &a.group) == (&b.category, &b.group);
    for trial in rounds.trials() {
        let label = &trial.label;
        if (label.category.is_some() || label.group.is_some()) && !found.iter().any(|known| same(known, label)) {
            found.push(label);
        }
    }
    let of = |label: &Label| {
        let part = |round: &Vec<&'a Trial>| -> Vec<&'a Trial> {
            round.iter().copied().filter(|trial| same(&trial.label, label)).collect()
        };
        group(label, &rounds.rounds.iter().map(part).collect::<Vec<Vec<&Trial>>>(), how)
    };
    found.into_iter().map(of).collect()
}

fn group(label: &Label, rounds: &[Vec<&Trial>], how: How) -> GroupResult {
    let trials: Vec<&Trial> = rounds.iter().flatten().copied().collect();
    let valid = trials.iter().filter(|trial| trial.ending.is_valid()).count() as u64;
    GroupResult {
        category: label.category.clone().unwrap_or_default(),
        group: label.group.clone().unwrap_or_default(),
        valid,
        invalid: trials.len() as u64 - valid,
        successes: trials.iter().filter(|trial| trial.ending == Ending::Success).count() as u64,
        interval_95: success_interval(rounds, how),
        endings: endings(&trials),
    }
}

/// How unsuccessful trials ended, the most frequent first.
pub(crate) fn endings(trials: &[&Trial]) -> Vec<EndingCount> {
    let mut endings: Vec<EndingCount> = Vec::new();
    for word in trials.iter().filter(|trial| trial.ending != Ending::Success).map(|trial| trial.ending.as_str()) {
        match endings.iter_mut().find(|known| known.ending == word) {
            Some(known) => known.episodes += 1,
            None => endings.push(EndingCount { ending: word.to_owned(), episodes: 1 }),
        }
    }
    endings.sort_by(|a, b| b.episodes.cmp(&a.episodes).then_with(|| a.ending.cmp(&b.ending)));
    endings
}
