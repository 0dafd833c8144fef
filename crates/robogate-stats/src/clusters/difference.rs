//! The difference of two rates if rows come in clusters.

use robogate_maths::beta::{ln_student_two_sided, student_quantile};

use super::FEWEST;
use crate::difference::ScoreDifference;
use crate::interval::{Confidence, Interval, Trials};

/// Tests the mean difference of two rates over clusters that both samples contain: Student's t on the differences of the
/// clusters' rates, in which each cluster counts once. Clusters without trials in one of them are left out.
///
/// With fewer than 8 clusters the interval is [-1, 1], and nothing is significant.
pub fn paired_clusters(first: &[Trials], second: &[Trials], confidence: Confidence) -> ScoreDifference {
    let rates = first.iter().zip(second).filter_map(|(a, b)| Some(a.rate()? - b.rate()?));
    let (mean, variance, n) = moments(&rates.collect::<Vec<f64>>());
    tested(mean, variance / n, n - 1.0, n, confidence)
}

/// Tests the difference of the mean rates of two samples of different clusters (Welch 1947).
///
/// With fewer than 8 clusters in one of them the interval is [-1, 1], and nothing is significant.
pub fn independent_clusters(first: &[Trials], second: &[Trials], confidence: Confidence) -> ScoreDifference {
    let of = |clusters: &[Trials]| moments(&clusters.iter().filter_map(|t| t.rate()).collect::<Vec<f64>>());
    let ((a, of_a, n), (b, of_b, m)) = (of(first), of(second));
    let (x, y) = (of_a / n, of_b / m);
    let degrees = (x + y).powi(2) / (x * x / (n - 1.0) + y * y / (m - 1.0));
    let degrees = if degrees.is_finite() { degrees } else { n.min(m) - 1.0 };
    tested(a - b, x + y, degrees, n.min(m), confidence)
}

/// Mean, variance and number.
fn moments(values: &[f64]) -> (f64, f64, f64) {
    let n = values.len() as f64;
    let mean = values.iter().sum::<f64>() / n;
    (mean, values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / (n - 1.0), n)
}

fn tested(estimate: f64, variance: f64, degrees: f64, clusters: f64, confidence: Confidence) -> ScoreDifference {
    let all = Interval { low: -1.0, high: 1.0 };
    if clusters < FEWEST as f64 {
        return ScoreDifference { estimate: estimate.is_finite().then_some(estimate), interval: all, ln_p: 0.0 };
    }
    if variance <= 0.0 {
        // Equal differences in all clusters say nothing about their spread, unless there is no difference.
        return ScoreDifference { estimate: Some(estimate), interval: all, ln_p: 0.0 };
    }
    let se = variance.sqrt();
    let half = student_quantile(degrees, confidence.level()) * se;
    ScoreDifference {
        estimate: Some(estimate),
        interval: Interval { low: (estimate - half).max(-1.0), high: (estimate + half).min(1.0) },
        ln_p: ln_student_two_sided(degrees, estimate / se),
    }
}

#[cfg(test)]
mod tests {
    use rand_chacha::ChaCha8Rng;
    use rand_core::SeedableRng;

    use super::*;
    use crate::resample::{binomial, uniform};

    #[test]
    fn equal_policies_differ_in_one_of_twenty() {
        let (mut paired, mut independent) = (0, 0);
        for seed in 0..1_000 {
            let mut rng = ChaCha8Rng::seed_from_u64(seed);
            // Each policy has its own rate in each of 8 scenarios, 40 episodes each.
            let mut policy = || -> Vec<Trials> {
                (0..8)
                    .map(|_| {
                        let rate = uniform(&mut rng);
                        Trials::new(binomial(&mut rng, 40, rate), 40).unwrap()
                    })
                    .collect()
            };
            let (a, b) = (policy(), policy());
            paired += u32::from(paired_clusters(&a, &b, Confidence::P95).ln_p <= 0.05_f64.ln());
            independent += u32::from(independent_clusters(&a, &b, Confidence::P95).ln_p <= 0.05_f64.ln());
        }
        assert!((30..=72).contains(&paired) && (25..=72).contains(&independent), "{paired} {independent}");
    }

    #[test]
    fn two_of_eight_scenarios_are_no_difference_of_policies() {
        let of = |k: [u64; 8]| k.map(|k| Trials::new(k, 5).unwrap());
        let (a, b) = (of([5; 8]), of([5, 5, 5, 5, 5, 5, 0, 0]));
        let found = paired_clusters(&a, &b, Confidence::P95);
        assert!(found.ln_p.exp() > 0.1 && found.interval.low < 0.0, "{found:?}");
        assert!(paired_clusters(&a[..7], &b[..7], Confidence::P95).ln_p.abs() <= 0.0);
    }
}
