//! Does the outcome of a row depend on its neighbours in the file?
//!
//! The statistic is the sum of squares of the sums of [`LAG`] neighbouring residuals. Under the hypothesis that rows can be
//! exchanged, it is compared with that of permuted rows; sampling stops as soon as the p-value is clearly large.
//!
//! Limit: a test that does not reject proves nothing. Of eight days with rates that differ by a standard deviation of 0.4 on the logit scale, 60
//! rows each, it finds about half. Source of the sequential p-value: Besag and Clifford (1991), Biometrika 78(2).

use rand_chacha::ChaCha8Rng;
use rand_core::SeedableRng;

use crate::resample::shuffle;

/// Number of neighbouring rows whose residuals are summed.
pub const LAG: usize = 20;
/// Permutations that must reach the observed statistic before sampling stops.
const EXCEEDANCES: usize = 20;

/// The permutation p-value of "the residuals do not depend on their order". `level` is the smallest level of interest. `None`
/// with fewer than two windows, or if all residuals are equal.
pub fn serial_dependence(residuals: &[f64], level: f64, seed: u64) -> Option<f64> {
    if residuals.len() < 2 * LAG || residuals.iter().all(|e| (e - residuals[0]).abs() <= 0.0) {
        return None;
    }
    let observed = statistic(residuals);
    let replicates = (2.0 / level).ceil() as usize - 1;
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut permuted = residuals.to_vec();
    let mut reached = 0;
    for drawn in 1..=replicates {
        shuffle(&mut rng, &mut permuted);
        if statistic(&permuted) >= observed {
            reached += 1;
            if reached == EXCEEDANCES {
                return Some(EXCEEDANCES as f64 / drawn as f64);
            }
        }
    }
    Some((reached + 1) as f64 / (replicates + 1) as f64)
}

fn statistic(residuals: &[f64]) -> f64 {
    let mut window: f64 = residuals[..LAG].iter().sum();
    let mut total = window * window;
    for (entering, leaving) in residuals[LAG..].iter().zip(residuals) {
        window += entering - leaving;
        total += window * window;
    }
    total
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::resample::uniform;

    /// How often the test rejects for `days` of 60 rows whose rates lie within `spread` of 0.7.
    fn rejected(days: usize, spread: f64) -> u32 {
        let mut found = 0;
        for seed in 0..200 {
            let mut rng = ChaCha8Rng::seed_from_u64(seed);
            let rates: Vec<f64> = (0..days).map(|_| 0.7 + spread * (2.0 * uniform(&mut rng) - 1.0)).collect();
            let rows: Vec<f64> =
                (0..days * 60).map(|row| f64::from(u8::from(uniform(&mut rng) < rates[row / 60])) - 0.7).collect();
            found += u32::from(serial_dependence(&rows, 0.01, seed).is_some_and(|p| p <= 0.01));
        }
        found
    }

    #[test]
    fn days_are_found_and_independent_rows_are_not() {
        assert!(rejected(8, 0.0) <= 6, "{}", rejected(8, 0.0));
        assert!(rejected(8, 0.3) >= 190, "{}", rejected(8, 0.3));
        assert_eq!(serial_dependence(&[1.0; 100], 0.01, 1), None);
    }
}
