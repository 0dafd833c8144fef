//! Sequential tests of a success rate, valid for any number of looks at the data.
//!
//! The hypothesis "the rate is at most p₀" is compared with each larger rate q, with equal weights. After k successes
//! in n trials the evidence is the mean likelihood ratio
//!
//! ```text
//! E(p₀) = 1/(1-p₀) ∫ (q/p₀)^k ((1-q)/(1-p₀))^(n-k) dq,  q from p₀ to 1
//!       = F(k; n+1, p₀) / ((n+1) (1-p₀) f(k; n, p₀))
//! ```
//!
//! with the binomial distribution function F and mass f. For every true rate up to p₀, E is a non-negative
//! supermartingale that starts at 1: the probability that it ever reaches 1/α is at most α (Ville). The test may
//! therefore stop as soon as E reaches 1/α, and min(1, 1/max E) is a p-value at any time.
//!
//! **Rounds of different scenarios.** If every round runs the same scenarios, the tested rate is their mean, and each
//! scenario may have a different rate. For each q the ratio of one trial is 1 + λ(x - p₀) with λ = (q-p₀)/(p₀(1-p₀)).
//! Over a round, the means 1 + λ(pᵢ - p₀) multiply to at most 1 if the average of pᵢ is at most p₀ (the geometric mean
//! never exceeds the arithmetic mean). All statements then hold for the mean rate, **if the looks are at the end of
//! complete rounds**.
//!
//! E decreases in p₀ wherever it is at least e. The p₀ that are not rejected therefore form an interval ([`Bounds`])
//! for every level above 1 - 1/e.
//!
//! Limit: trials are independent given their scenario, and p₀ is strictly between 0 and 1. Sources: Robbins (1970),
//! Annals of Mathematical Statistics 41; Howard, Ramdas, McAuliffe and Sekhon (2021), Annals of Statistics 49
//! (beta-binomial mixture); Ville (1939).

use crate::interval::{Interval, Trials};
use robogate_maths::beta::{ln_beta_cdf, ln_binomial_pmf};

/// ln of the evidence against the hypothesis "the rate is at most `p0`".
///
/// Without trials it is 0. For `p0` = 0 any success is infinite evidence, and for `p0` = 1 the evidence is never
/// positive.
pub fn ln_evidence_above(trials: Trials, p0: f64) -> f64 {
    let (k, n) = (trials.successes() as f64, trials.n() as f64);
    if p0.is_nan() || p0 >= 1.0 || n <= 0.0 {
        return 0.0;
    }
    if p0 <= 0.0 {
        return if k > 0.0 { f64::INFINITY } else { -(n + 1.0).ln() };
    }
    let q0 = 1.0 - p0;
    ln_beta_cdf(n - k + 1.0, k + 1.0, q0, p0) - (n + 1.0).ln() - q0.ln() - ln_binomial_pmf(k, n, p0)
}

/// The same with equal weights on the alternatives whose failure rate is `shares[0]` to `shares[1]` times that of
/// `p0`, where 0 <= `shares[0]` < `shares[1]` <= 1. `p0` is strictly between 0 and 1.
///
/// With q = 1 - u (1-p₀), the ratio (q/p₀)^k u^(n-k) decreases in p₀ for each u, so this evidence does too.
pub fn ln_evidence_of_shares(trials: Trials, p0: f64, shares: [f64; 2]) -> f64 {
    let (k, n) = (trials.successes() as f64, trials.n() as f64);
    if n <= 0.0 {
        return 0.0;
    }
    let failure = 1.0 - p0;
    let [low, high] = shares.map(|share| share * failure);
    // Both tails of the same beta distribution. The difference of the smaller ones keeps its digits.
    let below = [low, high].map(|x| ln_beta_cdf(n - k + 1.0, k + 1.0, x, 1.0 - x));
    let above = [low, high].map(|x| ln_beta_cdf(k + 1.0, n - k + 1.0, 1.0 - x, x));
    let (large, small) = if below[1] < above[0] { (below[1], below[0]) } else { (above[0], above[1]) };
    let between = large + (-(small - large).exp()).ln_1p();
    between - (n + 1.0).ln() - (high - low).ln() - ln_binomial_pmf(k, n, p0)
}

/// ln of the evidence against the hypothesis "the rate is at least `p0`".
pub fn ln_evidence_below(trials: Trials, p0: f64) -> f64 {
    ln_evidence_above(mirrored(trials), 1.0 - p0)
}

fn mirrored(trials: Trials) -> Trials {
    Trials::new(trials.failures(), trials.n()).unwrap_or(Trials::NONE)
}

/// The confidence sequence of a rate: the rates that no look has rejected so far.
///
/// It contains the true rate at all looks simultaneously with probability 1 - 2 tail.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Bounds {
    tail: f64,
    interval: Interval,
}

impl Bounds {
    /// Creates bounds without trials. Each side has the error probability `tail`, clamped to [1e-300, 1/e].
    pub fn new(tail: f64) -> Self {
        Self { tail: tail.clamp(1e-300, (-1.0_f64).exp()), interval: Interval::UNIT }
    }

    /// Adds a look at all trials so far.
    pub fn look(&mut self, trials: Trials) {
        let low = lower_end(trials, self.tail);
        let high = 1.0 - lower_end(mirrored(trials), self.tail);
        self.interval = Interval { low: low.max(self.interval.low), high: high.min(self.interval.high) };
    }

    /// The interval that is not rejected. `low` exceeds `high` with probability at most 2 tail; this indicates a
    /// violated assumption.
    pub fn interval(&self) -> Interval {
        self.interval
    }
}

/// The largest p₀ with evidence of at least 1/tail against "at most p₀". 0 if there is none.
fn lower_end(trials: Trials, tail: f64) -> f64 {
    let Some(rate) = trials.rate() else { return 0.0 };
    if trials.successes() == 0 {
        return 0.0;
    }
    let wanted = -tail.ln();
    let (mut low, mut high) = (0.0_f64, rate);
    for _ in 0..200 {
        let middle = 0.5 * (low + high);
        if middle <= low || middle >= high {
            break;
        }
        if ln_evidence_above(trials, middle) >= wanted { low = middle } else { high = middle }
    }
    low
}

#[cfg(test)]
mod tests {
    use super::*;

    fn t(k: u64, n: u64) -> Trials {
        Trials::new(k, n).unwrap()
    }

    #[test]
    fn no_trials_give_no_evidence() {
        assert_eq!((ln_evidence_above(Trials::NONE, 0.5), ln_evidence_below(Trials::NONE, 0.5)), (0.0, 0.0));
        let mut bounds = Bounds::new(0.05);
        bounds.look(Trials::NONE);
        assert_eq!(bounds.interval(), Interval::UNIT);
    }

    #[test]
    fn expected_evidence_is_at_most_one() {
        for n in [1, 7, 68, 300] {
            for p0 in [0.02, 0.5, 0.92] {
                let expected = |p: f64| -> f64 {
                    (0..=n)
                        .map(|k| (ln_binomial_pmf(k as f64, n as f64, p) + ln_evidence_above(t(k, n), p0)).exp())
                        .sum()
                };
                assert!((expected(p0) - 1.0).abs() < 1e-9, "n {n} p0 {p0}: {}", expected(p0));
                assert!(expected(0.9 * p0) < 1.0);
            }
        }
    }

    #[test]
    fn all_shares_are_the_mixture() {
        for (k, n) in [(0, 5), (40, 68), (300, 300), (995, 1000), (90, 1000)] {
            for p0 in [0.6, 0.92, 0.99] {
                let (shares, mixture) =
                    (ln_evidence_of_shares(t(k, n), p0, [0.0, 1.0]), ln_evidence_above(t(k, n), p0));
                assert!((shares - mixture).abs() < 1e-9, "{k} {n} {p0}: {shares} {mixture}");
                let parts: f64 = [[0.0, 0.3], [0.3, 0.7], [0.7, 1.0]]
                    .map(|part| (part[1] - part[0]) * ln_evidence_of_shares(t(k, n), p0, part).exp())
                    .iter()
                    .sum();
                assert!((parts.ln() - mixture).abs() < 1e-6, "{k} {n} {p0}: {} {mixture}", parts.ln());
            }
        }
    }

    #[test]
    fn mixed_rounds_keep_expected_evidence() {
        // Half of the scenarios always succeed and the others never: the mean rate is one half, and the count is fixed.
        let even = ln_evidence_above(t(34, 68), 0.5);
        assert!(even < 0.0, "{even}");
    }

    #[test]
    fn evidence_decreases_in_the_limit() {
        for n in 1..=60_u64 {
            for k in 0..=n {
                let mut last = f64::INFINITY;
                for i in 1..400 {
                    let e = ln_evidence_above(t(k, n), f64::from(i) / 400.0);
                    assert!(e < 1.0 || e <= last + 1e-12, "k {k} n {n} at {i}: {e} after {last}");
                    last = e;
                }
            }
        }
    }

    #[test]
    fn bounds_match_the_evidence_level() {
        let mut bounds = Bounds::new(0.05);
        bounds.look(t(60, 68));
        let Interval { low, high } = bounds.interval();
        assert!((ln_evidence_above(t(60, 68), low) - 20.0_f64.ln()).abs() < 1e-9);
        assert!((ln_evidence_below(t(60, 68), high) - 20.0_f64.ln()).abs() < 1e-9);
    }

    #[test]
    fn looks_never_widen_bounds() {
        let mut bounds = Bounds::new(0.05);
        bounds.look(t(68, 68));
        let first = bounds.interval();
        bounds.look(t(120, 136));
        assert!(bounds.interval().low >= first.low && bounds.interval().high <= first.high);
    }
}
