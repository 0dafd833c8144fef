//! The joint operating characteristic of a gate: how often all requirements together pass or fail.
//!
//! Episodes are simulated with a fixed seed. The failures of a policy are spread over the limited failure modes in
//! proportion to their limits; failures beyond these have no limited mode. Every scenario has the same rates.

use std::collections::BTreeMap;

use robogate_core::{FailureMode, Seed};
use robogate_stats::Trials;
use robogate_stats::budgeted::Budget;
use robogate_stats::operating::{Answer, Boundaries, RateTest};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::plan::RequirementPlan;
use crate::{Metric, Sampling, Sense};

/// Simulated gates for each row.
const RUNS: u64 = 1_000;
/// The true success rates of the table.
const RATES: [f64; 9] = [1.0, 0.99, 0.98, 0.97, 0.96, 0.95, 0.92, 0.9, 0.85];

/// Joint probabilities of the verdicts for one true success rate.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct JointOperating {
    /// The true success rate.
    pub success: f64,
    /// Probability that the gate passes.
    pub pass: f64,
    /// Probability that it fails.
    pub fail: f64,
    /// Probability that it stays inconclusive.
    pub open: f64,
    /// Mean number of episodes.
    pub episodes: f64,
}

/// A requirement on a rate of all scenarios.
struct Limit {
    /// The failure mode. `None` for success.
    mode: Option<FailureMode>,
    test: RateTest,
    boundaries: Boundaries,
    known: BTreeMap<(u64, u64), Answer>,
}

impl Limit {
    fn answer(&mut self, good: u64, n: u64, sampling: Sampling) -> Answer {
        let (test, boundaries) = (self.test, &self.boundaries);
        *self.known.entry((good, n)).or_insert_with(|| {
            let trials = Trials::new(good, n).unwrap_or(Trials::NONE);
            match sampling {
                Sampling::Fixed => test.fixed(trials),
                Sampling::Sequential => boundaries.look(trials),
            }
        })
    }
}

/// Simulates the gate. Also returns the requirements that are left out: those on means, quantiles and parts of a suite.
pub(crate) fn joint(
    demands: &[RequirementPlan],
    alpha: f64,
    per_round: u64,
    rounds: u64,
    sampling: Sampling,
) -> (Vec<JointOperating>, Vec<String>) {
    let beta = alpha / demands.len().max(1) as f64;
    let (mut limits, mut without) = (Vec::new(), Vec::new());
    for demand in demands {
        let whole = demand.per_round == per_round;
        let mode = match (demand.requirement.metric, demand.bound.sense) {
            (Metric::Success, Sense::AtLeast) if whole => None,
            (Metric::Failure(mode), Sense::AtMost) if whole => Some(mode),
            _ => {
                without.push(demand.id.clone());
                continue;
            }
        };
        let at_least = if mode.is_some() { 1.0 - demand.bound.limit } else { demand.bound.limit };
        let test = RateTest { at_least, alpha, beta };
        let boundaries = Boundaries::new(test, Budget { per_round, rounds });
        limits.push(Limit { mode, test, boundaries, known: BTreeMap::new() });
    }
    if limits.is_empty() {
        return (Vec::new(), without);
    }
    let rows = RATES.map(|success| simulate(&mut limits, success, per_round, rounds, sampling));
    (rows.into(), without)
}

fn simulate(limits: &mut [Limit], success: f64, per_round: u64, rounds: u64, sampling: Sampling) -> JointOperating {
    let allowed = |limit: &Limit| 1.0 - limit.test.at_least;
    let of_modes: f64 = limits.iter().filter(|limit| limit.mode.is_some()).map(allowed).sum();
    let of_success = limits.iter().filter(|limit| limit.mode.is_none()).map(allowed).fold(0.0, f64::max);
    let scale = (1.0 - success) / of_modes.max(of_success).max(f64::MIN_POSITIVE);
    let shares: Vec<f64> =
        limits.iter().map(|limit| if limit.mode.is_some() { scale * allowed(limit) } else { 0.0 }).collect();
    let (mut passed, mut failed, mut episodes) = (0_u64, 0_u64, 0_u64);
    for run in 0..RUNS {
        let mut stream = Seed::campaign(11).episode(run).stream("joint plan");
        let mut bad = vec![0_u64; limits.len()];
        let mut met = vec![false; limits.len()];
        let mut n = 0;
        for round in 1..=rounds {
            for _ in 0..per_round {
                let mut u = stream.uniform();
                if u >= 1.0 - success {
                    continue;
                }
                let mut mode = None;
                for (at, share) in shares.iter().enumerate() {
                    if mode.is_none() && u < *share {
                        mode = Some(at);
                    }
                    u -= share;
                }
                for (at, count) in bad.iter_mut().enumerate() {
                    *count += u64::from(limits[at].mode.is_none() || mode == Some(at));
                }
            }
            n = round * per_round;
            if sampling == Sampling::Fixed && round < rounds {
                continue;
            }
            let mut violated = false;
            for ((limit, bad), met) in limits.iter_mut().zip(&bad).zip(&mut met) {
                match limit.answer(n - bad, n, sampling) {
                    Answer::Met => *met = true,
                    Answer::Violated => violated = true,
                    Answer::Open => {}
                }
            }
            if violated {
                failed += 1;
                break;
            }
            if met.iter().all(|met| *met) {
                passed += 1;
                break;
            }
        }
        episodes += n;
    }
    let share = |count: u64| count as f64 / RUNS as f64;
    JointOperating {
        success,
        pass: share(passed),
        fail: share(failed),
        open: share(RUNS - passed - failed),
        episodes: episodes as f64 / RUNS as f64,
    }
}
