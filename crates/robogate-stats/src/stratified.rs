//! Sequential test of the mean success rate over scenarios, each with its own rate.
//!
//! A suite runs every scenario once per round. The hypothesis is "the mean of the scenarios' rates is at most p₀". Its
//! evidence is a weighted mean of three e-processes, so it is one itself: for every mix of rates, the probability that
//! it ever reaches 1/α is at most α (Ville), and the test may stop at the end of any round.
//!
//! 1. **Pooled**: the number of successes in complete rounds, with three sets of alternatives: all larger rates, as in
//!    [`crate::anytime`]; rates whose share of failures is a typical fraction of the allowed share; and "every episode
//!    succeeds". It is the strongest if the scenarios have similar rates.
//! 2. **Stratified**, twice: scenario s bets on its own next result. From the second round on, the predicted rate q of
//!    scenario s comes from its earlier results, and one episode multiplies its evidence against the rate m by q/m for a
//!    success and (1-q)/(1-m) for a failure. The evidence against the hypothesis is the least product over all rates m
//!    with a mean of at most p₀. It is the strongest if scenarios are deterministic: 64 of 68 that always succeed are
//!    shown to exceed 92 %. One version trusts each scenario's own history, the other shrinks it to the mean.
//!
//! The least product is a convex problem: with k successes in n bets of a scenario, k/m - (n-k)/(1-m) = λ for every
//! scenario, and λ ≥ 0 is found by bisection. The first round makes no bet, because it would have to guess which
//! scenarios fail.
//!
//! The weights depend on the limit alone. If at most [`TIGHT`] may fail, the requirement is on a rare event, and half of
//! the weight is on "it never happens". A test of "at most 1 %" at error 5 % needs at least 299 episodes without the
//! event whatever its form, because 0.99²⁹⁸ > 0.05; this one needs 340 in rounds of 68. A linear program over the
//! alternatives shows that 0.52 is the least weight with which it does. The rest is placed such that within the first
//! 1,360 episodes the test of 1 % passes no later than equal weights on all larger rates would, for every number of
//! events that these accept.
//!
//! Limit: results of one scenario are independent, with one rate. Sources: Spertus, Sridhar and Stark (2024),
//! "Sequential stratified inference for the mean", arXiv 2409.06680 (the least product over the hypothesis); Ville
//! (1939); Robbins (1970).

use std::collections::BTreeMap;

use crate::anytime;
use crate::interval::{Interval, Trials};

/// Largest share of failures for which a limit counts as one on a rare event.
pub const TIGHT: f64 = 0.015;

/// The pseudo-counts with which the two versions shrink the history of a scenario.
const SHRINKAGE: [f64; 2] = [0.01, 1.0];
/// The shares of the two versions in the weight of the stratified processes.
const VERSIONS: [f64; 2] = [0.7, 0.3];

/// The weights of the parts for one limit. The stratified processes share the rest.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Weights {
    /// "Every episode succeeds".
    always: f64,
    /// All larger rates.
    broad: f64,
    /// Rates whose share of failures lies in `shares`, relative to the limit's.
    typical: f64,
    shares: [f64; 2],
}

impl Weights {
    fn of(p0: f64) -> Self {
        // 1 - 0.985 is slightly more than 0.015 in floating point.
        if 1.0 - p0 <= TIGHT + 1e-9 {
            Self { always: 0.52, broad: 0.22, typical: 0.24, shares: [0.15, 0.35] }
        } else if p0 < 0.5 {
            // A limit on failures that must be exceeded: the rates of interest are just above it.
            Self { always: 0.02, broad: 0.90, typical: 0.03, shares: [0.2, 0.7] }
        } else {
            Self { always: 0.05, broad: 0.60, typical: 0.30, shares: [0.2, 0.7] }
        }
    }

    /// The weight of all pooled parts.
    fn pooled(self) -> f64 {
        self.always + self.broad + self.typical
    }
}

/// ln of the pooled evidence against "the rate is at most `p0`", for one rate.
pub fn ln_pooled_above(trials: Trials, p0: f64) -> f64 {
    let mixture = anytime::ln_evidence_above(trials, p0);
    if !(p0 > 0.0 && p0 < 1.0) || trials.n() == 0 {
        return mixture;
    }
    let weights = Weights::of(p0);
    let always = if trials.failures() == 0 { -(trials.n() as f64) * p0.ln() } else { f64::NEG_INFINITY };
    let typical = anytime::ln_evidence_of_shares(trials, p0, weights.shares);
    let parts = [weights.always.ln() + always, weights.broad.ln() + mixture, weights.typical.ln() + typical];
    ln_sum(parts) - weights.pooled().ln()
}

/// ln of the pooled evidence against "the rate is at least `p0`", for one rate.
pub fn ln_pooled_below(trials: Trials, p0: f64) -> f64 {
    ln_pooled_above(mirrored(trials), 1.0 - p0)
}

/// ln of the pooled part of the evidence of a suite: a lower bound of [`Strata::ln_evidence_above`] that needs only the
/// counts.
pub fn ln_pooled_part_above(trials: Trials, p0: f64) -> f64 {
    Weights::of(p0).pooled().ln() + ln_pooled_above(trials, p0)
}

/// The same against "the rate is at least `p0`".
pub fn ln_pooled_part_below(trials: Trials, p0: f64) -> f64 {
    ln_pooled_part_above(mirrored(trials), 1.0 - p0)
}

fn mirrored(trials: Trials) -> Trials {
    Trials::new(trials.failures(), trials.n()).unwrap_or(Trials::NONE)
}

fn ln_sum(terms: impl IntoIterator<Item = f64> + Clone) -> f64 {
    let top = terms.clone().into_iter().fold(f64::NEG_INFINITY, f64::max);
    if !top.is_finite() {
        return top;
    }
    top + terms.into_iter().map(|term| (term - top).exp()).sum::<f64>().ln()
}

/// The results of one scenario.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
struct Stratum {
    /// Successes and episodes.
    all: (u64, u64),
    /// Successes and episodes on which it bet.
    bets: (u64, u64),
}

/// The results of all scenarios, round by round.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Strata {
    strata: Vec<Stratum>,
    /// ln of the predicted probabilities of all results, for each version.
    predicted: [f64; SHRINKAGE.len()],
}

impl Strata {
    /// Adds a complete round: the scenario of each episode, numbered from 0, and whether it was good.
    pub fn round(&mut self, results: &[(usize, bool)]) {
        let most = results.iter().map(|(stratum, _)| stratum + 1).max().unwrap_or(0);
        self.strata.resize(self.strata.len().max(most), Stratum::default());
        let (k, n) = self.strata.iter().fold((0, 0), |(k, n), s| (k + s.all.0, n + s.all.1));
        let mean = (k as f64 + 0.5) / (n as f64 + 1.0);
        for (at, good) in results {
            let stratum = &mut self.strata[*at];
            let (k, n) = stratum.all;
            if n > 0 {
                for ((ln, shrinkage), towards) in self.predicted.iter_mut().zip(SHRINKAGE).zip([0.5, mean]) {
                    let q = (k as f64 + shrinkage * towards) / (n as f64 + shrinkage);
                    *ln += if *good { q.ln() } else { (-q).ln_1p() };
                }
                stratum.bets = (stratum.bets.0 + u64::from(*good), stratum.bets.1 + 1);
            }
            stratum.all = (k + u64::from(*good), n + 1);
        }
    }

    /// All results together.
    pub fn trials(&self) -> Trials {
        let (k, n) = self.strata.iter().fold((0, 0), |(k, n), s| (k + s.all.0, n + s.all.1));
        Trials::new(k, n).unwrap_or(Trials::NONE)
    }

    /// ln of the evidence against "the mean rate is at most `p0`".
    pub fn ln_evidence_above(&self, p0: f64) -> f64 {
        let pooled = ln_pooled_above(self.trials(), p0);
        if !(p0 > 0.0 && p0 < 1.0 && pooled.is_finite()) {
            return pooled;
        }
        let weights = Weights::of(p0);
        let stratified = (1.0 - weights.pooled()).ln() - self.ln_largest_likelihood(p0);
        let [own, shrunk] = [0, 1].map(|i| stratified + VERSIONS[i].ln() + self.predicted[i]);
        ln_sum([weights.pooled().ln() + pooled, own, shrunk])
    }

    /// ln of the largest probability of all bet results, over all rates with a mean of at most `p0`.
    fn ln_largest_likelihood(&self, p0: f64) -> f64 {
        // Scenarios with equal counts have equal rates at the optimum.
        let mut groups: BTreeMap<(u64, u64), f64> = BTreeMap::new();
        for stratum in &self.strata {
            *groups.entry(stratum.bets).or_default() += 1.0;
        }
        let budget = self.strata.len() as f64 * p0;
        let rate = |(k, n): (u64, u64), lambda: f64| -> f64 {
            let (k, n) = (k as f64, n as f64);
            if k <= 0.0 {
                0.0
            } else if lambda <= 0.0 {
                k / n
            } else {
                let sum = n + lambda;
                // The smaller root of λ m² - (n + λ) m + k = 0, in the form that does not cancel.
                (2.0 * k / (sum + (sum * sum - 4.0 * lambda * k).max(0.0).sqrt())).min(1.0)
            }
        };
        let total = |lambda: f64| groups.iter().map(|(bets, count)| count * rate(*bets, lambda)).sum::<f64>();
        let mut lambda = 0.0;
        if total(0.0) > budget {
            let (mut low, mut high) = (1e-9_f64, 1.0_f64);
            while total(high) > budget && high < 1e15 {
                high *= 4.0;
            }
            for _ in 0..50 {
                let middle = (low * high).sqrt();
                if total(middle) > budget { low = middle } else { high = middle }
            }
            // At the lower end the mean slightly exceeds p₀, which makes the likelihood larger and the test stricter.
            lambda = low;
        }
        let ln = |x: f64, count: f64| if count > 0.0 { count * x.max(f64::MIN_POSITIVE).ln() } else { 0.0 };
        let one = |bets: (u64, u64)| {
            let m = rate(bets, lambda);
            ln(m, bets.0 as f64) + ln(1.0 - m, (bets.1 - bets.0) as f64)
        };
        groups.iter().map(|(bets, count)| count * one(*bets)).sum()
    }
}

/// The means that the last look does not reject: `above` are the good results after each round, `below` the bad ones. Each
/// side has the error `tail`. The ends lie on the side of `limit` that the tests of `limit` at all looks decide.
pub fn bounds(above: &[Strata], below: &[Strata], tail: f64, limit: f64) -> Interval {
    let low = lower_end(above, tail, limit);
    let high = 1.0 - lower_end(below, tail, 1.0 - limit);
    Interval { low, high }
}

fn lower_end(looks: &[Strata], tail: f64, limit: f64) -> f64 {
    let wanted = -tail.ln();
    let Some(rate) = looks.last().and_then(|last| last.trials().rate()) else { return 0.0 };
    let last = |p0: f64| looks.last().is_some_and(|look| look.ln_evidence_above(p0) >= wanted);
    let rejected = looks.iter().any(|look| look.ln_evidence_above(limit) >= wanted);
    let (mut low, mut high) = if rejected { (limit, rate.max(limit)) } else { (0.0, limit.min(rate)) };
    for _ in 0..22 {
        let middle = 0.5 * (low + high);
        if last(middle) { low = middle } else { high = middle }
    }
    low
}

#[cfg(test)]
mod tests {
    use super::*;

    fn deterministic(good: usize, of: usize, rounds: usize) -> Strata {
        let mut strata = Strata::default();
        let round: Vec<(usize, bool)> = (0..of).map(|at| (at, at < good)).collect();
        (0..rounds).for_each(|_| strata.round(&round));
        strata
    }

    #[test]
    fn deterministic_scenarios_are_decided() {
        let wanted = 20.0_f64.ln();
        let first = (1..=20).find(|rounds| deterministic(64, 68, *rounds).ln_evidence_above(0.92) >= wanted);
        assert_eq!(first, Some(6));
        // The pooled test alone does not decide within twenty rounds.
        assert!(anytime::ln_evidence_above(deterministic(64, 68, 20).trials(), 0.92) < wanted);
    }

    #[test]
    fn no_rare_event_needs_five_rounds() {
        let wanted = 20.0_f64.ln();
        let first = (1..=20).find(|rounds| deterministic(68, 68, *rounds).ln_evidence_above(0.99) >= wanted);
        assert_eq!(first, Some(5));
    }

    #[test]
    fn expected_evidence_is_at_most_one() {
        // Two scenarios with all pairs of rates whose mean is 0.6 or less, and every result of three rounds.
        for (p, q) in [(0.6, 0.6), (1.0, 0.2), (0.9, 0.3), (0.5, 0.5), (0.2, 1.0)] {
            let mut expected = 0.0;
            for code in 0..64_u32 {
                let mut strata = Strata::default();
                let mut chance = 1.0;
                for round in 0..3 {
                    let bits = [code >> (2 * round) & 1 == 1, code >> (2 * round + 1) & 1 == 1];
                    chance *= if bits[0] { p } else { 1.0 - p };
                    chance *= if bits[1] { q } else { 1.0 - q };
                    strata.round(&[(0, bits[0]), (1, bits[1])]);
                }
                expected += chance * strata.ln_evidence_above(0.6).exp();
            }
            assert!(expected <= 1.0 + 1e-9, "{p} {q}: {expected}");
        }
    }

    #[test]
    fn pooled_part_is_a_lower_bound() {
        for good in [60, 64, 66, 68] {
            for rounds in [1, 3, 7] {
                let strata = deterministic(good, 68, rounds);
                assert!(strata.ln_evidence_above(0.92) >= ln_pooled_part_above(strata.trials(), 0.92) - 1e-12);
            }
        }
    }

    #[test]
    fn bounds_agree_with_the_test() {
        for (good, limit) in [(64, 0.92), (60, 0.92), (66, 0.92), (68, 0.99), (50, 0.92)] {
            let above: Vec<Strata> = (1..=8).map(|rounds| deterministic(good, 68, rounds)).collect();
            let below: Vec<Strata> = (1..=8)
                .map(|rounds| {
                    let mut strata = Strata::default();
                    let round: Vec<(usize, bool)> = (0..68).map(|at| (at, at >= good)).collect();
                    (0..rounds).for_each(|_| strata.round(&round));
                    strata
                })
                .collect();
            let interval = bounds(&above, &below, 0.05, limit);
            let met = above.iter().any(|look| look.ln_evidence_above(limit) >= 20.0_f64.ln());
            assert_eq!(met, interval.low >= limit, "{good}: {interval:?}");
            let rate = good as f64 / 68.0;
            assert!(interval.low <= rate + 1e-6 && interval.high >= rate - 1e-6, "{good}: {interval:?}");
        }
    }
}
