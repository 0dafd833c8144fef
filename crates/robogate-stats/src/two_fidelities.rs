//! A rate of a fine simulator from few fine episodes and many cheap, coarse ones.
//!
//! N scenarios run in the coarse simulator, and n of them, chosen before any result, run in the fine one with the same seeds. With
//! the rate q of the coarse outcome and the fine rates s₁ and s₀ where the coarse outcome occurs and where it does not, the
//! fine rate is p = q s₁ + (1 - q) s₀. All N episodes estimate q, and the n pairs s₁ and s₀. For yes-or-no outcomes this is
//! the control variate ȳ - β (x̄ₙ - x̄_N) with the fitted coefficient β = cov(x, y) / var(x) = s₁ - s₀: two-level Monte Carlo
//! with the best coefficient.
//!
//! **What is unbiased**: given the coarse outcomes, the expectation of the estimate is q̂ s₁ + (1 - q̂) s₀, and that of q̂ is q. So
//! the estimate is unbiased for the fine simulator, for any relation of both simulators, if both coarse outcomes occur among the
//! pairs. Otherwise the fine outcome is taken to be the coarse one where no pair shows it (β = 1 or less), which has a bias of at most
//! the share of the scenarios with that coarse outcome.
//!
//! **Interval**: q, s₁ and s₀ have independent binomial likelihoods. With Jeffreys' prior on each, the first two moments of p
//! follow in closed form, and the interval has the quantiles of the beta distribution with these moments. It never has zero
//! width. In simulations its coverage is 94 to 97 % where at least four pairs with different outcomes are expected, and higher
//! with fewer, because their rate is then hardly known (test `coverage_is_near_the_level`, docs/results/discovery.md).
//!
//! **Cost**: with correlation ρ of both outcomes, a coarse episode that costs c fine ones, and the share r = n/N, the same
//! precision costs (1 - ρ² + ρ² r) (1 + c/r) of fine episodes alone ([`relative_cost`]). It is least at r = √(c (1 - ρ²)) / ρ
//! ([`best_share`]), and above 1 if the correlation is low.
//!
//! Limits: the n scenarios are a random subset of the N, and these are independent samples of the population. A Latin hypercube
//! makes the interval conservative. Sources: Giles (2015), Acta Numerica 24 (multilevel Monte Carlo); Peherstorfer, Willcox and
//! Gunzburger (2016), SIAM J. Sci. Comput. 38(5) (allocation); Cochran (1977), Sampling Techniques, chapter 12 (double sampling for
//! stratification); Brown, Cai and DasGupta (2001), Statistical Science 16(2) (Jeffreys' interval).

use robogate_maths::beta::beta_quantile;

use crate::interval::{Confidence, Interval, Trials, wilson};

/// Fewest pairs. Below, the relation of both simulators is unknown.
pub const FEWEST: u64 = 10;

/// The outcomes of episodes that ran in both simulators.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Pairs {
    /// The outcome occurred in both.
    pub both: u64,
    /// It occurred in the fine simulator only.
    pub fine_only: u64,
    /// It occurred in the coarse simulator only.
    pub coarse_only: u64,
    /// It occurred in neither.
    pub neither: u64,
}

impl Pairs {
    /// Counts pairs of a fine and a coarse outcome.
    pub fn count(outcomes: impl IntoIterator<Item = (bool, bool)>) -> Self {
        let mut pairs = Self::default();
        for (fine, coarse) in outcomes {
            let cell = match (fine, coarse) {
                (true, true) => &mut pairs.both,
                (true, false) => &mut pairs.fine_only,
                (false, true) => &mut pairs.coarse_only,
                (false, false) => &mut pairs.neither,
            };
            *cell += 1;
        }
        pairs
    }

    /// The number of pairs.
    pub fn n(&self) -> u64 {
        self.both + self.fine_only + self.coarse_only + self.neither
    }

    /// The number of pairs with different outcomes.
    pub fn changed(&self) -> u64 {
        self.fine_only + self.coarse_only
    }

    /// The fine outcomes alone.
    pub fn fine(&self) -> Trials {
        Trials::new(self.both + self.fine_only, self.n()).unwrap_or(Trials::NONE)
    }

    /// The fine outcomes of the pairs in which the coarse outcome occurred.
    fn with_coarse(&self) -> Trials {
        Trials::new(self.both, self.both + self.coarse_only).unwrap_or(Trials::NONE)
    }

    /// The fine outcomes of the other pairs.
    fn without_coarse(&self) -> Trials {
        Trials::new(self.fine_only, self.fine_only + self.neither).unwrap_or(Trials::NONE)
    }

    /// Pearson's correlation of both outcomes. `None` if either does not vary.
    pub fn correlation(&self) -> Option<f64> {
        let [a, b, c, d] = [self.both, self.fine_only, self.coarse_only, self.neither].map(|count| count as f64);
        let spread = (a + b) * (c + d) * (a + c) * (b + d);
        (spread > 0.0).then(|| (a * d - b * c) / spread.sqrt())
    }
}

/// A rate of the fine simulator.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TwoFidelityRate {
    /// The estimate.
    pub rate: f64,
    /// Its interval.
    pub interval: Interval,
    /// The coefficient β of the control variate.
    pub control: f64,
    /// Correlation of both outcomes. `None` if either does not vary among the pairs.
    pub correlation: Option<f64>,
    /// The number of fine episodes alone that would have the same standard error.
    pub worth: f64,
    /// The interval of the fine outcomes of the pairs alone (Wilson).
    pub alone: Interval,
}

/// The reason why there is no estimate.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum TwoFidelityError {
    /// Too few pairs.
    #[error("{0} episodes ran in both simulators. Expected at least {FEWEST}")]
    Few(u64),
    /// The coarse episodes do not contain those of the pairs.
    #[error("the pairs have more coarse episodes of one outcome than there are coarse episodes")]
    Mismatch,
}

/// The rate of an outcome in the fine simulator. `coarse` counts it in all coarse episodes, those of the pairs included.
///
/// # Errors
/// Too few pairs, or coarse episodes that do not contain those of the pairs.
pub fn rate(pairs: &Pairs, coarse: Trials, confidence: Confidence) -> Result<TwoFidelityRate, TwoFidelityError> {
    if pairs.n() < FEWEST {
        return Err(TwoFidelityError::Few(pairs.n()));
    }
    let (with, without) = (pairs.with_coarse(), pairs.without_coarse());
    if with.n() > coarse.successes() || without.n() > coarse.failures() {
        return Err(TwoFidelityError::Mismatch);
    }
    let q = coarse.rate().unwrap_or(0.5);
    // Where no pair shows it, the fine outcome is taken to be the coarse one.
    let (s1, s0) = (with.rate().unwrap_or(1.0), without.rate().unwrap_or(0.0));
    let rate = q * s1 + (1.0 - q) * s0;
    let [(q1, q2), (a1, a2), (b1, b2)] = [coarse, with, without].map(moments);
    let mean = q1 * a1 + (1.0 - q1) * b1;
    let square = q2 * a2 + 2.0 * (q1 - q2) * a1 * b1 + (1.0 - 2.0 * q1 + q2) * b2;
    let spread = mean * (1.0 - mean);
    // The sum of both parameters of the beta distribution with these moments. Rounding must not make it infinite.
    let size = spread / (square - mean * mean).max(1e-300) - 1.0;
    let quantile = |p: f64| beta_quantile(mean * size, (1.0 - mean) * size, p);
    let interval =
        Interval { low: quantile(confidence.tail()).min(rate), high: quantile(1.0 - confidence.tail()).max(rate) };
    let alone = wilson(pairs.fine(), confidence);
    // Jeffreys' prior counts as one episode.
    let worth = (size - 1.0).max(1.0);
    Ok(TwoFidelityRate { rate, interval, control: s1 - s0, correlation: pairs.correlation(), worth, alone })
}

/// The first two moments of a rate after these trials, with Jeffreys' prior.
fn moments(trials: Trials) -> (f64, f64) {
    let (a, n) = (trials.successes() as f64 + 0.5, trials.n() as f64 + 1.0);
    (a / n, a * (a + 1.0) / (n * (n + 1.0)))
}

/// The cost of both simulators relative to fine episodes alone with the same precision. `cost` is that of a coarse episode
/// relative to a fine one, `share` the share of scenarios that also run in the fine simulator.
pub fn relative_cost(correlation: f64, cost: f64, share: f64) -> f64 {
    let explained = correlation * correlation;
    (1.0 - explained + explained * share) * (1.0 + cost / share)
}

/// The share of the scenarios that should also run in the fine simulator: the one with the least cost, at most 1.
pub fn best_share(correlation: f64, cost: f64) -> f64 {
    let explained = correlation * correlation;
    if explained <= 0.0 {
        return 1.0;
    }
    (cost * (1.0 - explained) / explained).sqrt().min(1.0)
}

#[cfg(test)]
mod tests {
    use rand_chacha::ChaCha8Rng;
    use rand_core::{Rng, SeedableRng};

    use super::*;

    fn unit(random: &mut ChaCha8Rng) -> f64 {
        ((random.next_u64() >> 11) as f64 + 0.5) / (1_u64 << 53) as f64
    }

    /// The figures of simulated campaigns.
    struct Simulated {
        covered: f64,
        bias: f64,
        worth: f64,
        /// Variance of p (1 - p) / n' over that of the estimate.
        variance: f64,
        /// Coverage of the normal interval of the same estimate.
        normal: f64,
    }

    /// Campaigns of `n` pairs among `5 n` coarse episodes. Both outcomes have the rate `p` and this correlation.
    fn simulated(n: u64, p: f64, correlation: f64, sets: u64) -> Simulated {
        let both = p * p + correlation * p * (1.0 - p);
        let mut sums = [0.0; 6];
        for set in 0..sets {
            let random = &mut ChaCha8Rng::seed_from_u64(set);
            let mut outcome = || {
                let u = unit(random);
                (u < p, u < both || (p..2.0 * p - both).contains(&u))
            };
            let pairs = Pairs::count((0..n).map(|_| outcome()));
            let coarse = Trials::count((0..4 * n).map(|_| outcome().1));
            let coarse =
                Trials::new(coarse.successes() + pairs.both + pairs.coarse_only, coarse.n() + pairs.n()).unwrap();
            let found = rate(&pairs, coarse, Confidence::P95).unwrap();
            let normal = {
                let q = coarse.rate().unwrap();
                let part = |trials: Trials, empty: f64| {
                    let s = trials.rate().unwrap_or(empty);
                    s * (1.0 - s) / trials.n().max(1) as f64
                };
                let variance = q * q * part(pairs.with_coarse(), 1.0)
                    + (1.0 - q).powi(2) * part(pairs.without_coarse(), 0.0)
                    + found.control.powi(2) * q * (1.0 - q) / coarse.n() as f64;
                (found.rate - p).abs() <= 1.96 * variance.sqrt()
            };
            let error = found.rate - p;
            for (sum, term) in sums.iter_mut().zip([
                f64::from(u8::from(found.interval.contains(p))),
                error,
                found.worth,
                error * error,
                p * (1.0 - p) / found.worth,
                f64::from(u8::from(normal)),
            ]) {
                *sum += term / sets as f64;
            }
        }
        let [covered, bias, worth, square, variance, normal] = sums;
        Simulated { covered, bias, worth, variance: variance / square, normal }
    }

    /// Prints the table of docs/results/discovery.md.
    #[test]
    fn coverage_is_near_the_level() {
        const SETS: u64 = 1_000;
        for n in [40, 120, 400] {
            for p in [0.05, 0.5, 0.95] {
                for correlation in [0.0, 0.5, 0.9, 0.97] {
                    let found = simulated(n, p, correlation, SETS);
                    let changed = 2.0 * n as f64 * (1.0 - correlation) * p * (1.0 - p);
                    println!(
                        "| {n} | {:.0} % | {correlation} | {changed:.1} | {:.1} % | {:.1} % | {:+.2} % | {:.0} |",
                        100.0 * p,
                        100.0 * found.covered,
                        100.0 * found.normal,
                        100.0 * found.bias,
                        found.worth
                    );
                    // The standard deviation of a coverage of 95 % is 0.7 %.
                    assert!(found.covered >= 0.928, "{n} {p} {correlation}: {}", found.covered);
                    if changed >= 4.0 {
                        assert!(found.covered <= 0.974, "{n} {p} {correlation}: {}", found.covered);
                    }
                    // At n = 40 and 5 %, one campaign in eight has no pair with the rare outcome.
                    let error = 4.0 * (p * (1.0 - p) / (found.worth * SETS as f64)).sqrt();
                    assert!(found.bias.abs() < error + if n == 40 { 0.006 } else { 0.0 }, "{n} {p}: {}", found.bias);
                    if n == 400 {
                        assert!((0.85..1.45).contains(&found.variance), "{p} {correlation}: {}", found.variance);
                    }
                }
            }
        }
    }

    #[test]
    fn estimate_is_the_regression_estimator() {
        let pairs = Pairs { both: 61, fine_only: 4, coarse_only: 7, neither: 28 };
        let coarse = Trials::new(331, 500).unwrap();
        let found = rate(&pairs, coarse, Confidence::P95).unwrap();
        let (n, y, x) = (100.0, 0.65, 0.68);
        let control = (61.0 / n - x * y) / (x * (1.0 - x));
        assert!((found.control - control).abs() < 1e-12);
        assert!((found.rate - (y - control * (x - 331.0 / 500.0))).abs() < 1e-12);
        let correlation = (61.0 / n - x * y) / (x * (1.0 - x) * y * (1.0 - y)).sqrt();
        assert!((found.correlation.unwrap() - correlation).abs() < 1e-12);
        assert!(found.interval.contains(found.rate) && found.interval.width() < found.alone.width());
    }

    #[test]
    fn equal_simulators_count_as_many_episodes() {
        // Without a difference among 200 pairs, 1,000 coarse episodes are worth most of 1,000 fine ones, and never more.
        let pairs = Pairs { both: 120, neither: 80, ..Pairs::default() };
        let found = rate(&pairs, Trials::new(610, 1_000).unwrap(), Confidence::P95).unwrap();
        assert!((found.rate - 0.61).abs() < 1e-12 && (found.control - 1.0).abs() < 1e-12);
        assert!((800.0..1_000.0).contains(&found.worth), "{}", found.worth);
        // Coarse episodes that say nothing are worth nothing.
        let pairs = Pairs { both: 50, fine_only: 50, coarse_only: 50, neither: 50 };
        let found = rate(&pairs, Trials::new(500, 1_000).unwrap(), Confidence::P95).unwrap();
        assert!((found.worth - 200.0).abs() < 3.0, "{}", found.worth);
    }

    #[test]
    fn best_share_has_the_least_cost() {
        for (correlation, cost) in [(0.96, 0.44), (0.9, 0.4), (0.7, 0.1)] {
            let best = best_share(correlation, cost);
            let at = |share: f64| relative_cost(correlation, cost, share);
            assert!(at(best) < at(0.9 * best) && at(best) < at(1.1 * best), "{correlation} {cost}");
            let least = ((1.0 - correlation * correlation).sqrt() + correlation * cost.sqrt()).powi(2);
            assert!((at(best) - least).abs() < 1e-12);
        }
        assert!(relative_cost(0.5, 0.44, 0.2) > 1.0 && best_share(0.0, 0.44) >= 1.0);
    }

    #[test]
    fn unusable_pairs_are_rejected() {
        let of = |pairs: Pairs, k: u64, n: u64| rate(&pairs, Trials::new(k, n).unwrap(), Confidence::P95);
        assert_eq!(of(Pairs { both: 9, ..Pairs::default() }, 9, 9), Err(TwoFidelityError::Few(9)));
        assert_eq!(of(Pairs { both: 20, ..Pairs::default() }, 19, 40), Err(TwoFidelityError::Mismatch));
        // One outcome only: the interval still has a width.
        let found = of(Pairs { both: 20, ..Pairs::default() }, 100, 100).unwrap();
        assert!(found.rate >= 1.0 && found.interval.low < 0.98 && found.correlation.is_none());
    }
}
