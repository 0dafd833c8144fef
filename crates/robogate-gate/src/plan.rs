//! What a gate will do, before anything runs: its operating characteristic.
//!
//! For each demand on a rate, and for a range of true rates: how likely it is found met, found violated or left open, and
//! how many episodes that takes. In confidence mode the figures come from [`robogate_stats::operating`], in point mode from
//! the binomial law alone. Each demand is looked at by itself: a gate with several passes no more often than its least
//! likely one.

use robogate_core::Measures;
use robogate_dictionary::Label;
use robogate_stats::Trials;
use robogate_stats::bounded_mean::BoundedMean;
use robogate_stats::compare::at_least;
use robogate_stats::operating::{RateTest, Schedule, characteristic};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::scope::{Scope, expand};
use crate::{Baseline, Bound, Ending, GateError, Metric, Mode, Requirement, Requirements, Sampling, Sense, Trial};

/// True rates that are planned for, as multiples of the bad rate that the limit allows.
const MULTIPLES: [f64; 11] = [0.0, 0.1, 0.25, 0.5, 0.75, 1.0, 1.25, 1.5, 2.0, 3.0, 5.0];
/// Beyond this nobody waits for a verdict.
const MOST_EPISODES: u64 = 1_000_000;

/// What a gate will do: one versioned document.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct GatePlan {
    /// Version of this form.
    pub format: u32,
    /// What is demanded.
    pub requirements: Requirements,
    /// Whether it looks after each round, or once.
    pub sampling: Sampling,
    /// Episodes in a round.
    pub per_round: u64,
    /// Rounds at most.
    pub rounds: u64,
    /// Each demand.
    pub demands: Vec<RequirementPlan>,
}

/// What the gate will find about one demand.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct RequirementPlan {
    /// Its name.
    pub id: String,
    /// The demand.
    pub requirement: Requirement,
    /// Its limit.
    pub bound: Bound,
    /// Episodes in a round that speak of it.
    pub per_round: u64,
    /// Rounds after which it is met at the earliest, in a run without a single bad event; absent where that is beyond reason,
    /// or in point mode.
    pub fewest_rounds: Option<u64>,
    /// What happens at which true rate; empty for a duration, whose law nobody knows beforehand.
    pub at: Vec<Operating>,
}

/// What happens at one true rate.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Operating {
    /// The true rate.
    pub rate: f64,
    /// Probability that the demand is found met.
    pub met: f64,
    /// Probability that it is found violated.
    pub violated: f64,
    /// Probability that it is left open.
    pub open: f64,
    /// Expected number of episodes in its scope until it is decided or the budget is spent.
    pub episodes: f64,
}

impl GatePlan {
    /// The version of the form.
    pub const FORMAT: u32 = 1;

    /// The plan for a suite with these scenarios, and at most `rounds` rounds of it.
    ///
    /// # Errors
    /// A demand that can't be met at any number of episodes, or not by a perfect policy within the rounds; a scope
    /// that no scenario has; a demand relative to a baseline that is not there.
    pub fn of(
        requirements: &Requirements,
        baseline: Option<&Baseline>,
        scenarios: &[Label],
        sampling: Sampling,
        rounds: u64,
    ) -> Result<Self, GateError> {
        requirements.check()?;
        let trials: Vec<Trial> = scenarios.iter().cloned().map(blank).collect();
        let mut demands = Vec::new();
        for requirement in &requirements.requirement {
            demands.extend(expand(requirement, scenarios.iter())?);
        }
        let alpha = requirements.alpha();
        let beta = alpha / demands.len().max(1) as f64;
        let demands = demands
            .into_iter()
            .map(|requirement| {
                let scope = Scope::of(&requirement);
                let per_round = trials.iter().filter(|trial| scope.holds(trial)).count() as u64;
                if per_round == 0 {
                    let known = crate::evaluation::known(trials.iter());
                    return Err(GateError::NoSuchScope { id: requirement.id(), scope: scope.to_string(), known });
                }
                let bound = requirement.bound(requirements.mode, baseline)?;
                let schedule = match sampling {
                    Sampling::Fixed => Schedule::Fixed { n: per_round * rounds },
                    Sampling::Sequential => Schedule::Rounds { per_round, rounds },
                };
                demand(requirement, bound, requirements.mode, alpha, beta, per_round, schedule, baseline)
            })
            .collect::<Result<Vec<RequirementPlan>, GateError>>()?;
        let per_round = trials.len() as u64;
        for demand in &demands {
            if requirements.mode == Mode::Confidence && demand.fewest_rounds.is_none_or(|fewest| fewest > rounds) {
                let fewest = demand.fewest_rounds.unwrap_or(MOST_EPISODES / per_round.max(1)) * per_round;
                return Err(GateError::BudgetTooSmall { id: demand.id.clone(), fewest, budget: rounds * per_round });
            }
        }
        Ok(Self { format: Self::FORMAT, requirements: requirements.clone(), sampling, per_round, rounds, demands })
    }
}

/// An episode that has not happened: only its label is looked at.
fn blank(label: Label) -> Trial {
    Trial {
        index: 0,
        seed: 0,
        label,
        requested: robogate_core::Assignment::default(),
        ending: Ending::Failure(None),
        time_s: None,
        measures: Measures::default(),
        unseen: Vec::new(),
    }
}

#[expect(clippy::too_many_arguments, reason = "one call, right above; a struct of its own would only repeat the names")]
fn demand(
    requirement: Requirement,
    bound: Bound,
    mode: Mode,
    alpha: f64,
    beta: f64,
    per_round: u64,
    schedule: Schedule,
    baseline: Option<&Baseline>,
) -> Result<RequirementPlan, GateError> {
    let id = requirement.id();
    let metric = requirement.metric;
    let mut plan = RequirementPlan { id, requirement, bound, per_round, fewest_rounds: None, at: Vec::new() };
    if metric.is_mean() {
        plan.fewest_rounds = fewest_steady(&plan, alpha, baseline);
        return Ok(plan);
    }
    // Of a quantile, so large a share of the values must keep the limit.
    let good = match (metric.quantile(), bound.sense) {
        (Some(q), Sense::AtMost) => q,
        (Some(q), Sense::AtLeast) => 1.0 - q,
        (None, Sense::AtLeast) => bound.limit,
        (None, Sense::AtMost) => 1.0 - bound.limit,
    };
    let test = RateTest { at_least: good, alpha, beta };
    if mode == Mode::Confidence {
        plan.fewest_rounds = test.fewest(schedule, MOST_EPISODES).map(|n| n.div_ceil(per_round));
    }
    let n = match schedule {
        Schedule::Fixed { n } => n,
        Schedule::Rounds { per_round, rounds } => per_round * rounds,
    };
    // A count allows so many among n; its share stands in for the rate.
    let allowed = if let Metric::FailureCount(_) = metric { bound.limit / n as f64 } else { 1.0 - good };
    // Where nothing bad is allowed, the multiples are of one event in n.
    let unit = if allowed > 0.0 { allowed } else { 1.0 / n as f64 };
    for bad in MULTIPLES.into_iter().map(|m| m * unit).filter(|bad| *bad <= 1.0) {
        let p = 1.0 - bad;
        let (met, violated, open, episodes) = match mode {
            Mode::Confidence => {
                let c = characteristic(test, schedule, p);
                (c.met, c.violated, c.open, c.trials)
            }
            Mode::Point => {
                let met = point(allowed, n, p);
                (met, 1.0 - met, 0.0, n as f64)
            }
        };
        let rate = if metric.quantile().is_none() && bound.sense == Sense::AtLeast { p } else { bad };
        plan.at.push(Operating { rate, met, violated, open, episodes });
    }
    Ok(plan)
}

/// Probability that the observed share of bad events is at most `allowed`, the chance of a good one being `p`.
fn point(allowed: f64, n: u64, p: f64) -> f64 {
    // The comparison of counts as the gate makes it: 1 - 0.92 must not turn into one event fewer.
    let bad = (allowed * n as f64 + 1e-9).floor() as u64;
    let good = n.saturating_sub(bad);
    at_least(Trials::new(good, n).unwrap_or(Trials::NONE), p).exp()
}

/// Rounds after which a demand on the duration is met at the earliest, every episode as long as the baseline's mean (half
/// the limit, where there is none).
fn fewest_steady(plan: &RequirementPlan, alpha: f64, baseline: Option<&Baseline>) -> Option<u64> {
    let [floor, ceiling] = plan.requirement.range();
    let floor = floor?;
    let (ceiling, limit) = (ceiling? - floor, plan.bound.limit - floor);
    let time = match plan.bound.sense {
        Sense::AtMost => baseline
            .and_then(|b| b.figure(plan.requirement.metric))
            .map(|t| t - floor)
            .filter(|t| *t < limit)
            .unwrap_or(0.5 * limit),
        Sense::AtLeast => 0.5 * (limit + ceiling),
    };
    (1..=200).find(|rounds| {
        let n = (*rounds * plan.per_round) as usize;
        let values = vec![time; n];
        BoundedMean::new(&values, &[n], ceiling).is_ok_and(|mean| {
            let ln = match plan.bound.sense {
                Sense::AtMost => mean.ln_evidence_below(limit),
                Sense::AtLeast => mean.ln_evidence_above(limit),
            };
            ln >= -alpha.ln()
        })
    })
}
