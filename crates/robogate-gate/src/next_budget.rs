//! What another gate of the same size would decide.
//!
//! The number of episodes "at which the observed rate decides" is a point estimate from an interval that contains the limit, so
//! it has no upper bound. The probability that a new gate of the same size decides has one: it is stated at the observed rate and
//! over the interval.

use robogate_stats::budgeted::Budget;
use robogate_stats::operating::{RateTest, Schedule, characteristics};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::requirement_test::How;
use crate::{Counts, Metric, RequirementResult, Sampling, Sense, Status};

/// The probability that a new gate of the same size decides an undecided requirement on a rate.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct NextBudget {
    /// Episodes of the new gate in the scope of the requirement.
    pub episodes: u64,
    /// The probability if the observed rate is the true one.
    pub at_observed: f64,
    /// The smallest and the largest probability over the interval of the rate.
    pub over_interval: [f64; 2],
}

impl NextBudget {
    /// `None` for a requirement that is decided or is not on a rate, and without an interval.
    pub(crate) fn of(result: &RequirementResult, counts: Counts, how: How) -> Option<Self> {
        let (metric, limit) = (result.requirement.metric, result.bound.limit);
        let is_rate = !metric.is_mean() && metric.quantile().is_none() && (0.0..=1.0).contains(&limit);
        // A new gate does not repeat the trials of the real robot.
        let is_rate = is_rate && !matches!(metric, Metric::RealSuccess | Metric::Production(_));
        // Of episodes in groups, more groups are needed, and how much these differ is not known.
        if result.status != Status::Undecided || !is_rate || how.grouped {
            return None;
        }
        let good = |rate: f64| if result.bound.sense == Sense::AtLeast { rate } else { 1.0 - rate };
        let [low, high] = result.interval?;
        let test = RateTest { at_least: good(limit), alpha: how.alpha, beta: how.beta };
        let episodes = result.valid + result.invalid;
        let schedule = match (how.sampling, counts.rounds) {
            (Sampling::Sequential, Some(rounds)) if rounds > 0 => {
                Schedule::Budget(Budget { per_round: episodes / rounds, rounds })
            }
            _ => Schedule::Fixed { n: episodes },
        };
        // The probability is smallest at the limit and grows with the distance from it. If as many episodes are invalid again, each of
        // them counts as bad for "met" and as good for "violated".
        let valid = result.valid as f64 / episodes.max(1) as f64;
        let rates = [result.figure.observed?, low, limit.clamp(low, high), high].map(good);
        let worst = characteristics(test, schedule, &rates.map(|rate| rate * valid));
        let best = characteristics(test, schedule, &rates.map(|rate| 1.0 - (1.0 - rate) * valid));
        let decided: Vec<f64> = worst.into_iter().zip(best).map(|(w, b)| (w.met + b.violated).min(1.0)).collect();
        let least = decided.iter().copied().fold(1.0, f64::min);
        let most = decided.iter().copied().fold(0.0, f64::max);
        Some(Self { episodes, at_observed: decided[0], over_interval: [least, most] })
    }
}
