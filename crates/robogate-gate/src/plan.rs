//! The plan of a gate: its operating characteristic, computed before a run.
//!
//! For each requirement on a rate and for a range of true rates, the plan states the probabilities of met, violated and
//! undecided, and the expected number of episodes. In confidence mode the figures come from
//! [`robogate_stats::operating`], in point mode from the binomial distribution. All requirements together are simulated. Each requirement is evaluated alone; a
//! gate with several passes at most as often as its least likely requirement.

use robogate_core::Measures;
use robogate_dictionary::Label;
use robogate_stats::Trials;
use robogate_stats::bounded_mean::BoundedMean;
use robogate_stats::budgeted::Budget;
use robogate_stats::compare::at_least;
use robogate_stats::operating::{RateTest, Schedule, characteristics};
use robogate_stats::renewal::rate_of_run;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::joint_plan::{JointOperating, joint};
use crate::scope::{Scope, expand};
use crate::{
    Baseline, Bound, Ending, GateError, Metric, Mode, Production, Requirement, Requirements, Sampling, Sense, Trial,
};

/// True rates of the table, as multiples of the failure rate that the limit allows.
const MULTIPLES: [f64; 11] = [0.0, 0.1, 0.25, 0.5, 0.75, 1.0, 1.25, 1.5, 2.0, 3.0, 5.0];
/// Longer runs are not reported.
const MOST_EPISODES: u64 = 1_000_000;

/// The plan of a gate as one versioned document.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct GatePlan {
    /// Version of the format.
    pub format: u32,
    /// The requirements.
    pub requirements: Requirements,
    /// Whether the gate tests after each round, or once.
    pub sampling: Sampling,
    /// Episodes per round.
    pub per_round: u64,
    /// Maximum number of rounds.
    pub rounds: u64,
    /// The requirements with their probabilities.
    pub demands: Vec<RequirementPlan>,
    /// All requirements together, by simulation. Empty in point mode.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub joint: Vec<JointOperating>,
    /// The requirements that the simulation leaves out: those on means, quantiles and parts of the suite.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub joint_without: Vec<String>,
}

/// The plan of one requirement.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct RequirementPlan {
    /// Its name.
    pub id: String,
    /// The requirement.
    pub requirement: Requirement,
    /// Its limit.
    pub bound: Bound,
    /// Episodes per round in its scope.
    pub per_round: u64,
    /// Smallest number of rounds after which the requirement is met, if no failure happens. `None` if that is too
    /// large, or in point mode.
    pub fewest_rounds: Option<u64>,
    /// Probabilities for several true rates. Empty for a duration, because its distribution is unknown.
    pub at: Vec<Operating>,
}

/// Probabilities for one true rate.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Operating {
    /// The true rate.
    pub rate: f64,
    /// Probability that the requirement is met.
    pub met: f64,
    /// Probability that the requirement is violated.
    pub violated: f64,
    /// Probability that the requirement stays undecided.
    pub open: f64,
    /// Expected number of episodes in its scope until it is decided or the budget is spent.
    pub episodes: f64,
}

impl GatePlan {
    /// The version of the format.
    pub const FORMAT: u32 = 1;

    /// Computes the plan for a suite with these scenarios and at most `rounds` rounds.
    ///
    /// # Errors
    /// A requirement that cannot be met at any number of episodes, or not by a perfect policy within the rounds; a
    /// scope without scenarios; a relative requirement without a baseline.
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
        // The real robot's trials exist before the run, so no plan says how often they decide.
        let real = |requirement: &&Requirement| requirement.metric == Metric::RealSuccess;
        let reals = requirements.requirement.iter().filter(real).count();
        for requirement in requirements.requirement.iter().filter(|requirement| !real(requirement)) {
            demands.extend(expand(requirement, scenarios.iter())?);
        }
        let alpha = requirements.alpha();
        let beta = alpha / (demands.len() + reals).max(1) as f64;
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
                    // Only successful episodes have a cycle time, so the number of values is not known before.
                    Sampling::Sequential if matches!(requirement.metric, Metric::CycleTime(_)) => {
                        Schedule::Rounds { per_round, rounds }
                    }
                    Sampling::Sequential => Schedule::Budget(Budget { per_round, rounds }),
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
        let (joint, joint_without) = match requirements.mode {
            Mode::Confidence => joint(&demands, alpha, per_round, rounds, sampling),
            Mode::Point => (Vec::new(), Vec::new()),
        };
        let requirements = requirements.clone();
        Ok(Self { format: Self::FORMAT, requirements, sampling, per_round, rounds, demands, joint, joint_without })
    }
}

/// A placeholder for an episode that has not run. Only its label is used.
fn blank(label: Label) -> Trial {
    Trial {
        index: 0,
        seed: 0,
        label,
        requested: robogate_core::Assignment::default(),
        ending: Ending::Failure(None),
        time_s: None,
        measures: Measures::default(),
        trajectory: None,
        unseen: Vec::new(),
        groups: Vec::new(),
        forces: Vec::new(),
    }
}

#[expect(clippy::too_many_arguments, reason = "a struct for a single call would only repeat the names")]
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
    if matches!(metric, Metric::Production(figure) if figure.is_per_time()) {
        // It depends on the durations, which are not known before.
        plan.fewest_rounds = Some(1);
        return Ok(plan);
    }
    if metric.is_mean() {
        plan.fewest_rounds = fewest_steady(&plan, alpha, baseline);
        return Ok(plan);
    }
    let n = match schedule {
        Schedule::Fixed { n } => n,
        Schedule::Rounds { per_round, rounds } | Schedule::Budget(Budget { per_round, rounds }) => per_round * rounds,
    };
    // For a quantile, this share of the values must meet the limit.
    let good = match (metric.quantile(), bound.sense) {
        (Some(q), Sense::AtMost) => q,
        (Some(q), Sense::AtLeast) => 1.0 - q,
        (None, Sense::AtLeast) => match metric {
            Metric::Production(Production::CyclesBetweenFailures) => 1.0 - 1.0 / bound.limit,
            Metric::Production(_) => rate_of_run(usize::try_from(n).unwrap_or(usize::MAX), bound.limit as usize),
            _ => bound.limit,
        },
        (None, Sense::AtMost) => 1.0 - bound.limit,
    };
    let test = RateTest { at_least: good, alpha, beta };
    if mode == Mode::Confidence {
        plan.fewest_rounds = test.fewest(schedule, MOST_EPISODES).map(|n| n.div_ceil(per_round));
    }
    // A limit on a count allows this many among n. Its share replaces the rate.
    let allowed = if let Metric::FailureCount(_) = metric { bound.limit / n as f64 } else { 1.0 - good };
    // If no event is allowed, the multiples are those of one event in n.
    let unit = if allowed > 0.0 { allowed } else { 1.0 / n as f64 };
    let bads: Vec<f64> = MULTIPLES.into_iter().map(|m| m * unit).filter(|bad| *bad <= 1.0).collect();
    let goods: Vec<f64> = bads.iter().map(|bad| 1.0 - bad).collect();
    let figures: Vec<(f64, f64, f64, f64)> = match mode {
        Mode::Confidence => {
            characteristics(test, schedule, &goods).into_iter().map(|c| (c.met, c.violated, c.open, c.trials)).collect()
        }
        Mode::Point => goods.iter().map(|p| point(allowed, n, *p)).map(|met| (met, 1.0 - met, 0.0, n as f64)).collect(),
    };
    for ((bad, p), (met, violated, open, episodes)) in bads.into_iter().zip(goods).zip(figures) {
        let rate = if metric.quantile().is_none() && bound.sense == Sense::AtLeast { p } else { bad };
        plan.at.push(Operating { rate, met, violated, open, episodes });
    }
    Ok(plan)
}

/// Probability that the observed share of bad events is at most `allowed`, if `p` is the probability of a good event.
fn point(allowed: f64, n: u64, p: f64) -> f64 {
    // Uses the same comparison of counts as the gate. Otherwise rounding of 1 - 0.92 could remove one event.
    let bad = (allowed * n as f64 + 1e-9).floor() as u64;
    let good = n.saturating_sub(bad);
    at_least(Trials::new(good, n).unwrap_or(Trials::NONE), p).exp()
}

/// Smallest number of rounds after which a requirement on the duration is met, if every episode takes the baseline's
/// mean (half the limit without a baseline).
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
