//! Exact inference of a success rate from trials in two strata of known shares.
//!
//! A model that never saw the trials divides the population into settings that it expects to be easier and harder. Both
//! shares are known. Given the number of trials in each stratum, the successes are binomial in each, also if
//! settings differ within a stratum. The hypothesis "the population's rate, Σ share · rate, is at most p₀" is tested with the
//! signed likelihood ratio of both counts. Its p-value is the largest over all pairs of rates with this mean, so the
//! error is at most α for any number of trials and any quality of the model. The better the model separates, the smaller
//! the interval.
//!
//! The ratio grows with both counts, so the largest p-value lies on the boundary of the hypothesis.
//!
//! Limit: trials are independent, and a random sample of the population in each stratum. Sources: Suissa and Shuster
//! (1985), JRSS A 148(4) (largest p-value over a nuisance parameter); Chan and Zhang (1999), Biometrics 55(4).

use robogate_maths::beta::ln_binomial_pmf;

use crate::interval::{Interval, Trials};

/// Most trials. The time of the tests grows with their number, and files of others must not take long.
pub const MOST_TRIALS: u64 = 20_000;
/// Number of nuisance values in the first search.
const GRID: usize = 200;

/// Trials of one stratum, and the stratum's share of the population.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Stratum {
    /// The share, from 0 to 1.
    pub share: f64,
    /// The trials.
    pub trials: Trials,
}

/// The p-value of the hypothesis "the rate is at most `p0`". 1 if a stratum has no trials.
///
/// The shares must add up to 1. If one stratum is the whole population, this is the exact binomial test of its trials.
pub fn p_above(strata: [Stratum; 2], p0: f64) -> f64 {
    if let Some(whole) = strata.iter().find(|s| s.share >= 1.0) {
        let (k, n) = (whole.trials.successes(), whole.trials.n());
        if k == 0 || p0.is_nan() || p0 >= 1.0 {
            return 1.0;
        }
        // Summed from the largest count, whose mass is the smallest.
        return (k..=n).rev().map(|k| ln_binomial_pmf(k as f64, n as f64, p0.max(0.0)).exp()).sum::<f64>().min(1.0);
    }
    let n = strata.map(|s| s.trials.n());
    if n.contains(&0) || p0.is_nan() || p0 >= 1.0 {
        return 1.0;
    }
    let k = strata.map(|s| s.trials.successes());
    let shares = strata.map(|s| s.share);
    let observed = statistic(k, n, shares, p0);
    if observed <= 0.0 {
        return 1.0;
    }
    if p0 <= 0.0 {
        return 0.0;
    }
    // For each count of the second stratum, the least count of the first one that is as extreme.
    let extreme = |a: u64, b: u64| statistic([a, b], n, shares, p0) >= observed - 1e-9;
    let mut least = Vec::with_capacity(n[1] as usize + 1);
    for b in 0..=n[1] {
        let (mut low, mut high) = (0, n[0] + 1);
        while low < high {
            let middle = low + (high - low) / 2;
            if extreme(middle, b) { high = middle } else { low = middle + 1 }
        }
        least.push(low as usize);
    }
    let tail = |first: f64| {
        let second = ((p0 - shares[0] * first) / shares[1]).clamp(0.0, 1.0);
        let of =
            |n: u64, p: f64| -> Vec<f64> { (0..=n).map(|k| ln_binomial_pmf(k as f64, n as f64, p).exp()).collect() };
        let mut above = of(n[0], first);
        above.push(0.0);
        (0..above.len() - 1).rev().for_each(|i| above[i] += above[i + 1]);
        of(n[1], second).iter().zip(&least).map(|(mass, least)| mass * above[*least]).sum::<f64>()
    };
    let low = ((p0 - shares[1]) / shares[0]).max(0.0);
    let high = (p0 / shares[0]).min(1.0);
    let at = |i: f64| low + (high - low) * i / GRID as f64;
    let best = (0..=GRID).map(|i| (i, tail(at(i as f64)))).fold((0, 0.0), |a, b| if b.1 > a.1 { b } else { a });
    // The largest value lies within one step of the best one.
    let fine = (-20..=20).map(|i| tail(at((best.0 as f64 + f64::from(i) / 20.0).clamp(0.0, GRID as f64))));
    fine.fold(best.1, f64::max).min(1.0)
}

/// The p-value of the hypothesis "the rate is at least `p0`".
pub fn p_below(strata: [Stratum; 2], p0: f64) -> f64 {
    let mirrored =
        strata.map(|s| Stratum { trials: Trials::new(s.trials.failures(), s.trials.n()).unwrap_or(Trials::NONE), ..s });
    p_above(mirrored, 1.0 - p0)
}

/// The rates that neither test rejects at the error `tail` on each side.
pub fn bounds(strata: [Stratum; 2], tail: f64) -> Interval {
    let Some(rate) = estimate(strata) else { return Interval::UNIT };
    let end = |rejected: &dyn Fn(f64) -> bool, rate: f64| {
        let (mut low, mut high) = (0.0, rate);
        for _ in 0..24 {
            let middle = 0.5 * (low + high);
            if rejected(middle) { low = middle } else { high = middle }
        }
        low
    };
    Interval {
        low: end(&|p| p_above(strata, p) <= tail, rate),
        high: 1.0 - end(&|q| p_below(strata, 1.0 - q) <= tail, 1.0 - rate),
    }
}

/// The estimated rate, Σ share · rate. `None` if a stratum has no trials.
pub fn estimate(strata: [Stratum; 2]) -> Option<f64> {
    strata.iter().filter(|s| s.share > 0.0).map(|s| s.trials.rate().map(|rate| s.share * rate)).sum()
}

/// The likelihood ratio of the counts against a rate of `p0`. 0 if their estimate is at most `p0`.
fn statistic(k: [u64; 2], n: [u64; 2], shares: [f64; 2], p0: f64) -> f64 {
    let rate = |i: usize| k[i] as f64 / n[i] as f64;
    if shares[0] * rate(0) + shares[1] * rate(1) <= p0 {
        return 0.0;
    }
    let ln = |x: f64, count: f64| if count > 0.0 { count * x.max(f64::MIN_POSITIVE).ln() } else { 0.0 };
    let one = |i: usize, m: f64| ln(m, k[i] as f64) + ln(1.0 - m, (n[i] - k[i]) as f64);
    // The rates under the hypothesis: n (rate - m) / (m (1 - m)) is proportional to the share in both strata. With the
    // factor x, n (rate - m) = x share m (1 - m), which has one root in (0, rate).
    let constrained = |i: usize, x: f64| {
        let (a, n) = (x * shares[i], n[i] as f64);
        let sum = n + a;
        (2.0 * n * rate(i) / (sum + (sum * sum - 4.0 * a * n * rate(i)).max(0.0).sqrt())).min(1.0)
    };
    let mean = |x: f64| shares[0] * constrained(0, x) + shares[1] * constrained(1, x);
    let (mut low, mut high) = (0.0, 1.0);
    while mean(high) > p0 && high < 1e15 {
        high *= 4.0;
    }
    for _ in 0..50 {
        let middle = 0.5 * (low + high);
        if mean(middle) > p0 { low = middle } else { high = middle }
    }
    (0..2).map(|i| one(i, rate(i)) - one(i, constrained(i, high))).sum::<f64>().max(0.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Confidence, clopper_pearson};

    #[test]
    fn whole_population_is_the_exact_binomial_test() {
        for (k, n) in [(0, 5), (5, 5), (17, 20), (31, 42), (1, 200)] {
            let trials = Trials::new(k, n).unwrap();
            let strata = [Stratum { share: 0.0, trials: Trials::NONE }, Stratum { share: 1.0, trials }];
            let (found, wanted) = (bounds(strata, 0.025), clopper_pearson(trials, Confidence::P95));
            assert!((found.low - wanted.low).abs() < 1e-6 && (found.high - wanted.high).abs() < 1e-6, "{k} of {n}");
            assert_eq!(estimate(strata), trials.rate());
        }
    }

    fn strata(k: [u64; 2], n: [u64; 2]) -> [Stratum; 2] {
        [0, 1].map(|i| Stratum { share: 0.5, trials: Trials::new(k[i], n[i]).unwrap() })
    }

    #[test]
    fn error_is_at_most_alpha() {
        // All pairs of counts, at pairs of rates with the mean 0.8.
        for n in [[10, 10], [6, 14]] {
            for [p, q] in [[0.8, 0.8], [1.0, 0.6], [0.6, 1.0], [0.9, 0.7]] {
                for (low, sign) in [(true, 1.0), (false, -1.0)] {
                    let mut error = 0.0;
                    for a in 0..=n[0] {
                        for b in 0..=n[1] {
                            let of = strata([a, b], n);
                            let found = if low { p_above(of, 0.8) } else { p_below(of, 0.8) };
                            let mass =
                                ln_binomial_pmf(a as f64, n[0] as f64, p) + ln_binomial_pmf(b as f64, n[1] as f64, q);
                            error += if found <= 0.05 { mass.exp() } else { 0.0 };
                        }
                    }
                    assert!(error <= 0.05 + 1e-9, "{n:?} {p} {q} {sign}: {error}");
                }
            }
        }
    }

    #[test]
    fn good_predictions_narrow_the_interval() {
        let alone = clopper_pearson(Trials::new(20, 40).unwrap(), Confidence::P95);
        let split = bounds(strata([20, 0], [20, 20]), 0.025);
        assert!(split.width() < 0.6 * alone.width(), "{split:?} {alone:?}");
        let even = bounds(strata([10, 10], [20, 20]), 0.025);
        assert!(even.width() < 1.03 * alone.width(), "{even:?} {alone:?}");
    }

    #[test]
    fn empty_stratum_gives_no_evidence() {
        assert_eq!(bounds(strata([0, 5], [0, 10]), 0.025), Interval::UNIT);
        assert_eq!(p_above(strata([0, 5], [0, 10]), 0.2), 1.0);
    }
}
