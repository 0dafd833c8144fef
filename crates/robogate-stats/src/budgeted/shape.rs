//! The shape of the boundary: how the error is divided among the looks.
//!
//! After round r of R the normal score of the tail probability is compared with c m(r), where m(r) = (r/R)^(Δ - 1/2) before the last
//! round (Wang and Tsiatis) and m(R) = γ. Δ = 0 and γ = 1 is the boundary of O'Brien and Fleming. Counts are integers, so the last
//! look may use less of the error than it could: a γ below 1 gives it one success more. Δ and γ are chosen for each limit by the exact
//! recursion: the fewest trials at two and four standard errors from the limit, with nearly the power of the fixed test at two.

use std::collections::BTreeMap;
use std::sync::{Mutex, PoisonError};

use robogate_maths::beta::ln_binomial_pmf;

use super::{Budget, EVIDENCE, Tails, USED};

/// The error for which the shape is chosen. Tests at other errors have the same shape, so that p-values and intervals agree.
const REFERENCE: f64 = 0.05;
/// The wanted share of the power of the fixed test.
const SHARE: f64 = 0.955;
/// The cost of a missing share of power, in budgets.
const COST: f64 = 40.0;
/// Above this number of trials, single successes hardly matter, and the shape is not searched.
const MOST_TRIALS: u64 = 6_000;
/// Shapes that are kept for later calls.
const KEPT: usize = 4_096;

/// Δ and γ.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Shape {
    pub(super) delta: f64,
    pub(super) last: f64,
}

impl Shape {
    /// The shape that is nearly best for large numbers of trials.
    const USUAL: Self = Self { delta: 0.1, last: 1.0 };

    /// The factor m of a round, numbered from 1.
    pub(super) fn factor(self, round: u64, rounds: u64) -> f64 {
        if round >= rounds { self.last } else { (round as f64 / rounds as f64).powf(self.delta - 0.5) }
    }

    /// The shape of the test of "above `p0`". It depends on nothing but the budget and the limit.
    pub(super) fn of(budget: Budget, p0: f64) -> Self {
        static KNOWN: Mutex<BTreeMap<(u64, u64, u64), Shape>> = Mutex::new(BTreeMap::new());
        let trials = budget.per_round.saturating_mul(budget.rounds);
        if !(p0 > 0.0 && p0 < 1.0) || trials == 0 || trials > MOST_TRIALS {
            return Self::USUAL;
        }
        let key = (budget.per_round, budget.rounds, p0.to_bits());
        if let Some(shape) = KNOWN.lock().unwrap_or_else(PoisonError::into_inner).get(&key) {
            return *shape;
        }
        let shape = Self::best(budget, p0);
        let mut known = KNOWN.lock().unwrap_or_else(PoisonError::into_inner);
        if known.len() >= KEPT {
            known.clear();
        }
        known.insert(key, shape);
        shape
    }

    fn best(budget: Budget, p0: f64) -> Self {
        let all = budget.per_round * budget.rounds;
        let unit = (p0 * (1.0 - p0) / all as f64).sqrt();
        // Beside a limit near 1 no rate is that far away.
        let near = (p0 + 2.0 * unit).min(1.0 - 0.25 * (1.0 - p0));
        let far = (p0 + 4.0 * unit).min(1.0 - 0.1 * (1.0 - p0));
        let tails = Tails::new(budget, p0);
        let fixed = upper_tail(all, tails.least(budget.rounds, REFERENCE), near);
        let evidence = budget.evidence_boundary(p0, EVIDENCE * REFERENCE);
        let mut best = (f64::INFINITY, Self::USUAL);
        for delta in [0.0, 0.1, 0.2, 0.3] {
            for last in [1.0, 0.96, 0.92, 0.88, 0.84] {
                let shape = Self { delta, last };
                let boundary = budget.calibrated(p0, USED * REFERENCE, shape, &tails, &evidence, 14);
                let (power, episodes) = budget.course(near, &boundary);
                let missing = (SHARE - power / fixed.max(1e-9)).max(0.0);
                let cost = (episodes + budget.course(far, &boundary).1) / all as f64 + COST * missing;
                if cost < best.0 - 1e-9 {
                    best = (cost, shape);
                }
            }
        }
        best.1
    }
}

/// The probability of at least `k` successes in `n` trials.
fn upper_tail(n: u64, k: u64, p: f64) -> f64 {
    (k..=n).map(|k| ln_binomial_pmf(k as f64, n as f64, p).exp()).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shape_depends_on_the_limit_alone() {
        let budget = Budget { per_round: 40, rounds: 8 };
        let first = Shape::of(budget, 0.9);
        assert_eq!(Shape::of(budget, 0.9), first);
        assert_eq!(Shape::best(budget, 0.9), first);
        assert_eq!(Shape::of(Budget { per_round: 1_000, rounds: 20 }, 0.9), Shape::USUAL);
        assert_eq!(Shape::of(budget, 1.0), Shape::USUAL);
        let factors: Vec<f64> = (1..=8).map(|round| first.factor(round, 8)).collect();
        assert!(factors.windows(2).all(|pair| pair[0] > pair[1]) && factors[7] == first.last, "{factors:?}");
    }
}
