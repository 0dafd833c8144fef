//! Confidence intervals for a success probability.
//!
//! With k successes in n independent trials, p̂ = k/n and z the two-sided normal point of the level:
//!
//! - [`wilson`]: the p with (p̂ - p)² = z² p (1 - p) / n. Coverage is near the level on average over p, and can be
//!   below it for a given p (most where p is near 0 or 1). The interval never leaves [0, 1] and never has
//!   zero width at finite n.
//! - [`clopper_pearson`]: Beta quantiles B(α/2; k, n-k+1) and B(1-α/2; k+1, n-k), 0 at k = 0 and 1 at k = n.
//!   Coverage is at least the level for every n and p; the interval is wide when n is small.
//!
//! Without trials the interval is [0, 1].
//!
//! Limit: both assume independent draws from the population of interest and an n fixed in advance. A Latin hypercube is
//! dependent (usually conservative here), a boundary-focused design is not representative (see [`crate::weighted`]),
//! and repeated looks during sampling invalidate the level.
//! Sources: Wilson (1927), JASA 22; Clopper and Pearson (1934), Biometrika 26(4); Brown, Cai and DasGupta
//! (2001), Statistical Science 16(2), on their coverage.

use robogate_maths::{beta::beta_quantile, normal};

/// The reason why counts or a confidence level are invalid.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum IntervalError {
    /// More successes than trials.
    #[error("{successes} successes exceed {n} trials")]
    MoreSuccessesThanTrials {
        /// Successes as given.
        successes: u64,
        /// Trials as given.
        n: u64,
    },
    /// A confidence level that is not strictly between 0 and 1.
    #[error("the confidence level {level} is out of range. Expected a number in (0, 1). Hint: write 95 % as 0.95")]
    LevelOutsideUnit {
        /// Level as given.
        level: f64,
    },
}

/// A number of successes out of a number of trials.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct Trials {
    successes: u64,
    n: u64,
}

impl Trials {
    /// No trials.
    pub const NONE: Self = Self { successes: 0, n: 0 };

    /// Creates a count with `successes` ≤ `n`.
    ///
    /// # Errors
    /// [`IntervalError::MoreSuccessesThanTrials`] otherwise.
    pub fn new(successes: u64, n: u64) -> Result<Self, IntervalError> {
        if successes > n {
            Err(IntervalError::MoreSuccessesThanTrials { successes, n })
        } else {
            Ok(Self { successes, n })
        }
    }

    /// Counts the `true` among `outcomes`.
    pub fn count(outcomes: impl IntoIterator<Item = bool>) -> Self {
        let mut trials = Self::NONE;
        for success in outcomes {
            trials.n += 1;
            trials.successes += u64::from(success);
        }
        trials
    }

    /// Number of successes, k.
    pub fn successes(self) -> u64 {
        self.successes
    }

    /// Number of trials, n.
    pub fn n(self) -> u64 {
        self.n
    }

    /// Number of failed trials, n - k.
    pub fn failures(self) -> u64 {
        self.n - self.successes
    }

    /// Observed rate k/n. `None` without trials.
    pub fn rate(self) -> Option<f64> {
        (self.n > 0).then(|| self.successes as f64 / self.n as f64)
    }
}

/// Two-sided confidence level, strictly between 0 and 1.
#[derive(Debug, Clone, Copy, PartialEq, PartialOrd)]
pub struct Confidence(f64);

impl Confidence {
    /// The usual level of 95 %.
    pub const P95: Self = Self(0.95);

    /// Creates a level with 0 < `level` < 1.
    ///
    /// # Errors
    /// [`IntervalError::LevelOutsideUnit`] otherwise, NaN included.
    pub fn new(level: f64) -> Result<Self, IntervalError> {
        if level > 0.0 && level < 1.0 { Ok(Self(level)) } else { Err(IntervalError::LevelOutsideUnit { level }) }
    }

    /// The level, for example 0.95 for 95 %.
    pub fn level(self) -> f64 {
        self.0
    }

    /// Error probability on each side, (1 - level) / 2.
    pub fn tail(self) -> f64 {
        0.5 * (1.0 - self.0)
    }

    /// Two-sided quantile of the standard normal distribution: 1.95996 at 95 %.
    pub fn z(self) -> f64 {
        -normal::quantile(self.tail())
    }

    /// The level per statement at which `comparisons` statements hold simultaneously (Bonferroni).
    ///
    /// Zero comparisons count as one.
    pub fn shared_by(self, comparisons: usize) -> Self {
        // If the share is too small to represent, the largest double below 1 keeps the level valid.
        let level = 1.0 - (1.0 - self.0) / comparisons.max(1) as f64;
        Self(level.min(1.0 - f64::EPSILON / 2.0))
    }
}

/// A closed interval of the real line, `low` ≤ `high`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Interval {
    /// Lower end.
    pub low: f64,
    /// Upper end.
    pub high: f64,
}

impl Interval {
    /// The interval [0, 1] of all probabilities.
    pub const UNIT: Self = Self { low: 0.0, high: 1.0 };

    /// Length, high - low.
    pub fn width(self) -> f64 {
        self.high - self.low
    }

    /// Whether `value` is in the interval, ends included.
    pub fn contains(self, value: f64) -> bool {
        self.low <= value && value <= self.high
    }
}

/// Wilson's score interval for the success probability.
pub fn wilson(trials: Trials, confidence: Confidence) -> Interval {
    if trials.n == 0 {
        return Interval::UNIT;
    }
    let z = confidence.z();
    wilson_real(trials.successes as f64, trials.n as f64, z)
}

/// Wilson's interval for real-valued counts 0 ≤ k ≤ n (weighted data use an effective n).
pub(crate) fn wilson_real(k: f64, n: f64, z: f64) -> Interval {
    if n.is_nan() || n <= 0.0 {
        return Interval::UNIT;
    }
    let k = k.max(0.0).min(n);
    Interval { low: wilson_low(k, n, z), high: 1.0 - wilson_low(n - k, n, z) }
}

/// Smaller root of the score equation, computed from the product of both roots: exact at k = 0 and without cancellation
/// near it.
fn wilson_low(k: f64, n: f64, z: f64) -> f64 {
    let zz = z * z;
    let larger = (2.0 * k + zz + z * (zz + 4.0 * k * (n - k) / n).sqrt()) / (2.0 * (n + zz));
    k * k / (n * (n + zz)) / larger
}

/// Exact (Clopper-Pearson) interval for the success probability.
pub fn clopper_pearson(trials: Trials, confidence: Confidence) -> Interval {
    let tail = confidence.tail();
    let (k, n) = (trials.successes as f64, trials.n as f64);
    Interval { low: exact_low(k, n, tail), high: 1.0 - exact_low(n - k, n, tail) }
}

/// The p at which k or more successes in n trials have probability `tail`. 0 at k = 0.
fn exact_low(k: f64, n: f64, tail: f64) -> f64 {
    if k <= 0.0 { 0.0 } else { beta_quantile(k, n - k + 1.0, tail) }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn trials(k: u64, n: u64) -> Trials {
        Trials::new(k, n).unwrap()
    }

    /// Probability that the interval from a Binomial(n, p) count contains p, as an exact sum.
    fn coverage(n: u64, p: f64, make: fn(Trials, Confidence) -> Interval) -> f64 {
        let mut probability = (n as f64 * (1.0 - p).ln()).exp();
        let mut covered = 0.0;
        for k in 0..=n {
            if make(trials(k, n), Confidence::P95).contains(p) {
                covered += probability;
            }
            probability *= (n - k) as f64 / (k + 1) as f64 * p / (1.0 - p);
        }
        covered
    }

    #[test]
    fn no_trials_give_unit_interval() {
        assert_eq!(wilson(Trials::NONE, Confidence::P95), Interval::UNIT);
        assert_eq!(clopper_pearson(Trials::NONE, Confidence::P95), Interval::UNIT);
        assert_eq!(Trials::NONE.rate(), None);
    }

    #[test]
    fn extreme_counts_reach_the_ends() {
        for make in [wilson, clopper_pearson] {
            for n in [1, 7, 1_000_000] {
                let none = make(trials(0, n), Confidence::P95);
                let all = make(trials(n, n), Confidence::P95);
                assert_eq!((none.low, all.high), (0.0, 1.0));
                assert!(none.high > 0.0 && none.high < 1.0 && all.low > 0.0 && all.low < 1.0);
            }
        }
    }

    #[test]
    fn successes_and_failures_are_symmetric() {
        for make in [wilson, clopper_pearson] {
            let a = make(trials(3, 41), Confidence::P95);
            let b = make(trials(38, 41), Confidence::P95);
            assert!((a.low - (1.0 - b.high)).abs() < 1e-15 && (a.high - (1.0 - b.low)).abs() < 1e-15);
        }
    }

    #[test]
    fn clopper_pearson_is_conservative() {
        for n in [1, 2, 5, 20, 60] {
            for i in 1..100 {
                let p = f64::from(i) / 100.0;
                assert!(coverage(n, p, clopper_pearson) >= 0.95 - 1e-12, "n {n} p {p}");
            }
        }
    }

    #[test]
    fn wilson_covers_on_average() {
        for n in [5, 20, 60] {
            let all: Vec<f64> = (1..200).map(|i| coverage(n, f64::from(i) / 200.0, wilson)).collect();
            let mean = all.iter().sum::<f64>() / all.len() as f64;
            assert!((0.945..0.965).contains(&mean), "n {n} mean {mean}");
            assert!(all.iter().all(|&c| c > 0.82), "n {n}");
        }
    }

    #[test]
    fn invalid_counts_and_levels_are_rejected() {
        assert!(Trials::new(2, 1).is_err());
        for level in [0.0, 1.0, -0.1, 95.0, f64::NAN] {
            assert!(Confidence::new(level).is_err());
        }
    }

    #[test]
    fn shared_level_stays_below_one() {
        assert!((Confidence::P95.shared_by(5).level() - 0.99).abs() < 1e-15);
        assert!(Confidence::P95.shared_by(usize::MAX).z().is_finite());
        assert_eq!(Confidence::P95.shared_by(0), Confidence::P95);
    }
}
