//! Two-sided error of the comparison of very unequal independent samples near a rate of 1.
#![expect(clippy::unwrap_used, reason = "test helpers fail by panicking")]

use robogate_maths::beta::ln_binomial_pmf;
use robogate_stats::difference::{ScoreDifference, independent, independent_normal};
use robogate_stats::{Confidence, Trials};

/// Counts that divide the distribution of the larger sample into parts of equal probability: the middle of each part.
const PARTS: usize = 9;

fn mass(k: u64, n: u64, rate: f64) -> f64 {
    ln_binomial_pmf(k as f64, n as f64, rate).exp()
}

fn middles(n: u64, rate: f64) -> Vec<u64> {
    let (mut sum, mut found) = (0.0, Vec::new());
    for k in 0..=n {
        sum += mass(k, n, rate);
        while found.len() < PARTS && sum >= (found.len() as f64 + 0.5) / PARTS as f64 {
            found.push(k);
        }
    }
    found
}

/// The probability of a significant difference if both rates are equal. All counts of the smaller sample with a
/// noticeable probability are summed.
fn error([small, large]: [u64; 2], rate: f64, test: impl Fn(Trials, Trials, Confidence) -> ScoreDifference) -> f64 {
    let others = middles(large, rate);
    assert_eq!(others.len(), PARTS);
    let mut error = 0.0;
    for k in 0..=small {
        let probability = mass(k, small, rate);
        if probability < 1e-4 {
            continue;
        }
        for other in &others {
            let found = test(Trials::new(k, small).unwrap(), Trials::new(*other, large).unwrap(), Confidence::P95);
            let excludes = found.interval.low > 0.0 || found.interval.high < 0.0;
            assert_eq!(excludes, found.ln_p <= 0.05_f64.ln(), "{k} {other}: {found:?}");
            error += if excludes { probability / PARTS as f64 } else { 0.0 };
        }
    }
    error
}

#[test]
fn unequal_samples_keep_the_level() {
    for (sizes, rate) in [([20, 10_000], 0.99), ([20, 10_000], 0.992), ([30, 3_000], 0.97), ([30, 3_000], 0.983)] {
        let found = error(sizes, rate, independent);
        // The counts of the larger sample are represented by nine of them.
        assert!(found <= 0.055, "{sizes:?} {rate}: {found}");
    }
}

#[test]
fn normal_approximation_exceeds_the_level() {
    // The reason for the exact test.
    let found = error([20, 10_000], 0.992, independent_normal);
    assert!(found > 0.1, "{found}");
}
