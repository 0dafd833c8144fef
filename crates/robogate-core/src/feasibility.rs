//! Feasibility: scenarios that no policy can complete.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::{DesignError, Environment, ParameterSpace, Sampler, Seed, Word, samplers};
use std::sync::Arc;

/// The measure that is 1 for an episode that some policy may complete, and 0 for an infeasible one. An environment that
/// checks feasibility declares and reports it.
pub const FEASIBLE: Word = Word::constant("feasible");

/// The reason why no policy can complete a scenario.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, JsonSchema)]
pub struct Infeasibility {
    /// The violated condition in one clause, the same for all scenarios that violate it.
    pub condition: String,
    /// The limit of the robot or cell that causes it, as text (`80 mm`).
    pub limit: String,
}

/// The share of a parameter space that no policy can complete, by condition.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct SpaceFeasibility {
    /// The number of sampled points.
    pub points: u64,
    /// The share of feasible points.
    pub feasible: f64,
    /// The violated conditions with their shares of the points, the largest first. A point counts for one condition.
    pub infeasible: Vec<InfeasibleShare>,
}

/// The share of a space that violates one condition.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct InfeasibleShare {
    /// The condition.
    #[serde(flatten)]
    pub reason: Infeasibility,
    /// The share of the points.
    pub share: f64,
}

/// The number of points of a check. The standard error of a share is below 0.8 percentage points.
const POINTS: usize = 4096;

impl SpaceFeasibility {
    /// Checks points of this space that are sampled uniformly. The result depends only on the space and the environment.
    pub fn of(environment: &dyn Environment, space: &ParameterSpace) -> Result<Self, DesignError> {
        let stream = Seed::campaign(0).stream("feasibility");
        let design = samplers::Uniform.design(&Arc::new(space.clone()), POINTS, stream)?;
        let points = (0..design.len()).filter_map(|i| design.assignment(i));
        Ok(Self::count(points.map(|values| environment.infeasibility(&values))))
    }

    /// Counts the reasons of points.
    fn count(points: impl Iterator<Item = Option<Infeasibility>>) -> Self {
        let mut counts: Vec<(Infeasibility, u64)> = Vec::new();
        let (mut all, mut feasible) = (0_u64, 0_u64);
        for reason in points {
            all += 1;
            match reason {
                None => feasible += 1,
                Some(reason) => match counts.iter_mut().find(|(known, _)| *known == reason) {
                    Some((_, count)) => *count += 1,
                    None => counts.push((reason, 1)),
                },
            }
        }
        counts.sort_by(|(a, n), (b, m)| m.cmp(n).then_with(|| a.cmp(b)));
        let share = |n: u64| n as f64 / all.max(1) as f64;
        let infeasible = counts.into_iter().map(|(reason, n)| InfeasibleShare { reason, share: share(n) }).collect();
        Self { points: all, feasible: share(feasible), infeasible }
    }
}

/// Whether the measures of an episode mark it as feasible. `None` if its task does not check feasibility.
pub fn is_feasible(measures: &crate::Measures) -> Option<bool> {
    measures.get(FEASIBLE.as_str()).map(|value| value > 0.5)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shares_are_sorted_and_sum_to_one() {
        let reason = |condition: &str| Some(Infeasibility { condition: condition.to_owned(), limit: "1 m".to_owned() });
        let check = SpaceFeasibility::count([reason("a"), None, reason("b"), reason("b")].into_iter());
        assert_eq!((check.points, check.feasible), (4, 0.25));
        let shares: Vec<(&str, f64)> =
            check.infeasible.iter().map(|part| (part.reason.condition.as_str(), part.share)).collect();
        assert_eq!(shares, [("b", 0.5), ("a", 0.25)]);
    }
}
