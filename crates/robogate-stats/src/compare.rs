//! Comparison of two success rates, for example of two robots, policies or simulators.
//!
//! - [`z_test`]: pooled two-sample test of equal rates, z = (p̂₁ - p̂₂) / sqrt(p̄(1-p̄)(1/n₁ + 1/n₂)). Approximate;
//!   needs at least some successes and failures.
//! - [`newcombe`]: interval for p₁ - p₂ from two Wilson intervals (his method 10). Accurate at small counts.
//! - [`newcombe_paired`]: the interval for runs of the same scenarios, with the correlation φ of the pairs (his
//!   method 10 for paired data, φ corrected for continuity).
//! - [`mcnemar_exact`]: exact test for the same scenarios: given b + c discordant pairs, b is binomial(b + c, ½).
//! - [`fisher_exact`]: exact test of equal rates, given the successes of both samples together.
//! - [`at_most`], [`at_least`]: exact one-sided binomial tests against a fixed rate (for example a danger zone of 30
//!   %).
//!
//! Limit: scenarios are independent. Rates of two samples are comparable only if both were sampled from the same
//! population. Sources: Newcombe (1998), Statistics in Medicine 17, 873-890 (unpaired) and 2635-2650 (paired); McNemar
//! (1947).

use crate::interval::{Confidence, Interval, Trials, wilson};
use robogate_maths::beta::{ln_beta_cdf, ln_binomial_pmf};
use robogate_maths::normal::ln_two_sided;

/// The result of a test with a normal statistic.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ZTest {
    /// First rate minus second, in standard errors under equality.
    pub z: f64,
    /// ln of the two-sided p-value.
    pub ln_p: f64,
}

/// The difference of two rates.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Difference {
    /// First rate minus second. `None` if one has no trials.
    pub estimate: Option<f64>,
    /// The confidence interval, within [-1, 1].
    pub interval: Interval,
}

/// Tests whether two rates are equal. `None` if one has no trials, or if both always or never succeeded.
pub fn z_test(first: Trials, second: Trials) -> Option<ZTest> {
    let (p1, p2) = (first.rate()?, second.rate()?);
    let (n1, n2) = (first.n() as f64, second.n() as f64);
    let pooled = (first.successes() as f64 + second.successes() as f64) / (n1 + n2);
    let variance = pooled * (1.0 - pooled) * (1.0 / n1 + 1.0 / n2);
    (variance > 0.0).then(|| {
        let z = (p1 - p2) / variance.sqrt();
        ZTest { z, ln_p: ln_two_sided(z) }
    })
}

/// Newcombe's interval for the difference of two independent rates, within [-1, 1].
pub fn newcombe(first: Trials, second: Trials, confidence: Confidence) -> Difference {
    let (Some(p1), Some(p2)) = (first.rate(), second.rate()) else {
        return Difference { estimate: None, interval: Interval { low: -1.0, high: 1.0 } };
    };
    let (w1, w2) = (wilson(first, confidence), wilson(second, confidence));
    let d = p1 - p2;
    Difference {
        estimate: Some(d),
        interval: Interval {
            low: (d - (p1 - w1.low).hypot(w2.high - p2)).max(-1.0),
            high: (d + (w1.high - p1).hypot(p2 - w2.low)).min(1.0),
        },
    }
}

/// Outcomes of the same scenarios under two conditions.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Pairs {
    /// Both succeeded.
    pub both: u64,
    /// Only the first succeeded.
    pub first_only: u64,
    /// Only the second succeeded.
    pub second_only: u64,
    /// Neither succeeded.
    pub neither: u64,
}

impl Pairs {
    /// Counts two lists of outcomes of the same scenarios in the same order. `None` if their lengths differ.
    pub fn count(first: &[bool], second: &[bool]) -> Option<Self> {
        if first.len() != second.len() {
            return None;
        }
        let mut pairs = Self::default();
        for outcome in first.iter().zip(second) {
            match outcome {
                (true, true) => pairs.both += 1,
                (true, false) => pairs.first_only += 1,
                (false, true) => pairs.second_only += 1,
                (false, false) => pairs.neither += 1,
            }
        }
        Some(pairs)
    }

    /// Number of scenarios.
    pub fn n(self) -> u64 {
        self.both + self.first_only + self.second_only + self.neither
    }
}

/// Newcombe's interval for the difference of two rates on the same scenarios.
pub fn newcombe_paired(pairs: Pairs, confidence: Confidence) -> Difference {
    let n = pairs.n();
    let first = Trials::new(pairs.both + pairs.first_only, n);
    let second = Trials::new(pairs.both + pairs.second_only, n);
    let (Ok(first), Ok(second)) = (first, second) else {
        return newcombe(Trials::NONE, Trials::NONE, confidence);
    };
    let (Some(p1), Some(p2)) = (first.rate(), second.rate()) else {
        return newcombe(first, second, confidence);
    };
    let (w1, w2) = (wilson(first, confidence), wilson(second, confidence));
    let (a, b, c, d) = (pairs.both as f64, pairs.first_only as f64, pairs.second_only as f64, pairs.neither as f64);
    let margins = (a + b) * (c + d) * (a + c) * (b + d);
    let cross = a * d - b * c;
    let phi = if margins <= 0.0 {
        0.0
    } else if cross > 0.0 {
        (cross - 0.5 * n as f64).max(0.0) / margins.sqrt()
    } else {
        cross / margins.sqrt()
    };
    let join = |x: f64, y: f64| (x * x - 2.0 * phi * x * y + y * y).max(0.0).sqrt();
    let difference = p1 - p2;
    Difference {
        estimate: Some(difference),
        interval: Interval {
            low: (difference - join(p1 - w1.low, w2.high - p2)).max(-1.0),
            high: (difference + join(w1.high - p1, p2 - w2.low)).min(1.0),
        },
    }
}

/// ln of McNemar's exact two-sided p-value for equal success rates. 0 (p = 1) without discordant pairs.
pub fn mcnemar_exact(pairs: Pairs) -> f64 {
    let (b, c) = (pairs.first_only, pairs.second_only);
    sign_test(b, c)
}

/// ln of the exact two-sided p-value for two counts with equal probabilities.
pub(crate) fn sign_test(b: u64, c: u64) -> f64 {
    let smaller = b.min(c);
    let Ok(trials) = Trials::new(smaller, b + c) else { return 0.0 };
    (at_most(trials, 0.5) + std::f64::consts::LN_2).min(0.0)
}

/// The two-sided exact test of equal rates (Fisher), given the successes of both samples together: the probability of all
/// tables that are at most as likely as this one. 1 if a sample is empty.
pub fn fisher_exact(first: Trials, second: Trials) -> f64 {
    let (n, m) = (first.n(), second.n());
    let successes = first.successes() + second.successes();
    let (least, most) = (successes.saturating_sub(m), successes.min(n));
    if n == 0 || m == 0 || least == most {
        return 1.0;
    }
    // The hypergeometric distribution is that of two binomial counts of any equal rate, given their sum.
    let rate = successes as f64 / (n + m) as f64;
    let ln =
        |k: u64| ln_binomial_pmf(k as f64, n as f64, rate) + ln_binomial_pmf((successes - k) as f64, m as f64, rate);
    let observed = ln(first.successes());
    let all: Vec<f64> = (least..=most).map(ln).collect();
    let top = all.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let sum = |of: &dyn Fn(f64) -> bool| all.iter().filter(|ln| of(**ln)).map(|ln| (ln - top).exp()).sum::<f64>();
    // Tables of equal probability may differ by rounding.
    (sum(&|ln| ln <= observed + 1e-9) / sum(&|_| true)).min(1.0)
}

/// ln P(at most this many successes | rate `p0`). Small if the true rate is below `p0`. 0 (p = 1) without trials.
///
/// `p0` is clamped to [0, 1]. A NaN gives 0 (p = 1).
pub fn at_most(trials: Trials, p0: f64) -> f64 {
    let (k, n) = (trials.successes() as f64, trials.n() as f64);
    if k >= n || p0.is_nan() {
        return 0.0;
    }
    let p0 = p0.clamp(0.0, 1.0);
    ln_beta_cdf(n - k, k + 1.0, 1.0 - p0, p0)
}

/// ln P(at least this many successes | rate `p0`). Small if the true rate is above `p0`. 0 (p = 1) without trials.
///
/// `p0` is clamped to [0, 1]. A NaN gives 0 (p = 1).
pub fn at_least(trials: Trials, p0: f64) -> f64 {
    let (k, n) = (trials.successes() as f64, trials.n() as f64);
    if k <= 0.0 || p0.is_nan() {
        return 0.0;
    }
    let p0 = p0.clamp(0.0, 1.0);
    ln_beta_cdf(k, n - k + 1.0, p0, 1.0 - p0)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn t(k: u64, n: u64) -> Trials {
        Trials::new(k, n).unwrap()
    }

    #[test]
    fn no_trials_give_no_result() {
        assert_eq!(z_test(t(3, 5), Trials::NONE), None);
        let d = newcombe(t(3, 5), Trials::NONE, Confidence::P95);
        assert_eq!((d.estimate, d.interval), (None, Interval { low: -1.0, high: 1.0 }));
        assert_eq!(newcombe_paired(Pairs::default(), Confidence::P95).estimate, None);
        assert_eq!(mcnemar_exact(Pairs::default()), 0.0);
        assert_eq!((at_most(Trials::NONE, 0.3), at_least(Trials::NONE, 0.3)), (0.0, 0.0));
    }

    #[test]
    fn exact_test_sums_tables() {
        // Sums of binomial coefficients as exact fractions.
        for (first, second, p) in [
            (t(8, 10), t(1, 6), 0.034_965_034_965_034_97),
            (t(3, 20), t(420, 1500), 0.313_450_038_444_203),
            (t(0, 30), t(61, 1200), 0.396_321_019_565_571_36),
            (t(19, 40), t(283, 1000), 0.012_267_090_860_423_237),
            (t(5, 5), t(0, 7), 0.001_262_626_262_626_262_7),
            (t(30, 30), t(700, 1200), 1.421_039_632_565_08e-7),
        ] {
            assert!((fisher_exact(first, second) / p - 1.0).abs() < 1e-9, "{first:?} {second:?}");
            assert!((fisher_exact(second, first) / p - 1.0).abs() < 1e-9, "{first:?} {second:?}");
        }
        assert_eq!(fisher_exact(t(3, 5), Trials::NONE), 1.0);
        assert_eq!(fisher_exact(t(5, 5), t(9, 9)), 1.0);
    }

    #[test]
    fn perfect_scores_have_an_interval() {
        assert_eq!(z_test(t(5, 5), t(9, 9)), None);
        let d = newcombe(t(5, 5), t(9, 9), Confidence::P95);
        assert!(d.interval.low < -0.3 && d.interval.high > 0.2);
    }

    #[test]
    fn swapping_inputs_mirrors_results() {
        let (a, b) = (t(31, 50), t(12, 47));
        let (x, y) = (newcombe(a, b, Confidence::P95), newcombe(b, a, Confidence::P95));
        assert!((x.interval.low + y.interval.high).abs() < 1e-15);
        let pairs = Pairs { both: 20, first_only: 9, second_only: 3, neither: 11 };
        let swapped = Pairs { first_only: 3, second_only: 9, ..pairs };
        assert_eq!(mcnemar_exact(pairs), mcnemar_exact(swapped));
        let (x, y) = (newcombe_paired(pairs, Confidence::P95), newcombe_paired(swapped, Confidence::P95));
        assert!((x.interval.low + y.interval.high).abs() < 1e-15);
    }

    #[test]
    fn agreeing_pairs_narrow_the_interval() {
        let pairs = Pairs { both: 60, first_only: 6, second_only: 2, neither: 32 };
        let paired = newcombe_paired(pairs, Confidence::P95).interval.width();
        let unpaired = newcombe(t(66, 100), t(62, 100), Confidence::P95).interval.width();
        assert!(paired < 0.7 * unpaired);
    }

    #[test]
    fn unpaired_interval_has_nominal_coverage() {
        let pmf = |n: u64, p: f64| {
            let mut mass = vec![(1.0 - p).powi(n as i32)];
            for k in 0..n {
                mass.push(mass[k as usize] * (n - k) as f64 / (k + 1) as f64 * p / (1.0 - p));
            }
            mass
        };
        for (p1, p2) in [(0.5, 0.5), (0.1, 0.2), (0.9, 0.35), (0.05, 0.05)] {
            let (a, b) = (pmf(25, p1), pmf(40, p2));
            let mut covered = 0.0;
            for (i, x) in a.iter().enumerate() {
                for (j, y) in b.iter().enumerate() {
                    let d = newcombe(t(i as u64, 25), t(j as u64, 40), Confidence::P95);
                    if d.interval.contains(p1 - p2) {
                        covered += x * y;
                    }
                }
            }
            assert!((0.93..0.995).contains(&covered), "p1 {p1} p2 {p2}: {covered}");
        }
    }
}
