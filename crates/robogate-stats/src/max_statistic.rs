//! Which of several quantities is correlated with a result? A permutation test over all of them at once.
//!
//! The statistic of each quantity is the absolute rank correlation with the result (Spearman, ties share their mean rank).
//! The result is permuted over the rows, and the largest statistic over all quantities is recorded. The adjusted p-value
//! of a quantity is the share of permutations whose largest statistic is at least its own: the single-step procedure of
//! Westfall and Young. If the result does not depend on any quantity, each permutation is equally likely, so the
//! probability that any quantity is named at level α is at most α for any number of rows, any dependence between the
//! quantities and any ties.
//!
//! Source: Westfall and Young (1993), Resampling-Based Multiple Testing, section 2.6.

use rand_chacha::ChaCha8Rng;
use rand_core::SeedableRng;

use crate::correlation::midranks;
use crate::resample::shuffle;

/// The test of one quantity.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct QuantityTest {
    /// Rank correlation with the result, in [-1, 1]. 0 for a constant quantity.
    pub correlation: f64,
    /// p-value of "the result does not depend on any quantity", adjusted for all quantities.
    pub p_adjusted: f64,
}

/// Tests each quantity (values by row) against `result`. `permutations` bounds the resolution: the smallest p-value is
/// 1 / (`permutations` + 1).
///
/// `None` if a list has another length than `result`, a value is not finite, or all results are equal.
pub fn correlated_quantities(
    quantities: &[Vec<f64>],
    result: &[f64],
    permutations: usize,
    seed: u64,
) -> Option<Vec<QuantityTest>> {
    let finite = |values: &[f64]| values.len() == result.len() && values.iter().all(|value| value.is_finite());
    if !finite(result) || !quantities.iter().all(|values| finite(values)) {
        return None;
    }
    let mut result = standardised(result)?;
    let quantities: Vec<Option<Vec<f64>>> = quantities.iter().map(|values| standardised(values)).collect();
    let correlations = |result: &[f64]| -> Vec<f64> {
        let with = |scores: &Vec<f64>| scores.iter().zip(result).map(|(a, b)| a * b).sum::<f64>().clamp(-1.0, 1.0);
        quantities.iter().map(|scores| scores.as_ref().map_or(0.0, with)).collect()
    };
    let observed = correlations(&result);
    let mut reached = vec![0_usize; observed.len()];
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    for _ in 0..permutations {
        shuffle(&mut rng, &mut result);
        let largest = correlations(&result).into_iter().map(f64::abs).fold(0.0, f64::max);
        for (reached, observed) in reached.iter_mut().zip(&observed) {
            // Equal orders have equal statistics except for rounding.
            *reached += usize::from(largest >= observed.abs() - 1e-9);
        }
    }
    let p = |reached: usize| (reached + 1) as f64 / (permutations + 1) as f64;
    Some(
        observed
            .into_iter()
            .zip(reached)
            .map(|(correlation, reached)| QuantityTest { correlation, p_adjusted: p(reached) })
            .collect(),
    )
}

/// Ranks with mean 0 and sum of squares 1. `None` if all values are equal.
fn standardised(values: &[f64]) -> Option<Vec<f64>> {
    let mut ranks = midranks(values);
    let mean = ranks.iter().sum::<f64>() / ranks.len().max(1) as f64;
    ranks.iter_mut().for_each(|rank| *rank -= mean);
    let norm = ranks.iter().map(|rank| rank * rank).sum::<f64>().sqrt();
    if norm < 1e-12 {
        return None;
    }
    ranks.iter_mut().for_each(|rank| *rank /= norm);
    Some(ranks)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::resample::uniform;

    fn noise(rng: &mut ChaCha8Rng, quantities: usize, rows: usize) -> Vec<Vec<f64>> {
        (0..quantities).map(|_| (0..rows).map(|_| uniform(rng)).collect()).collect()
    }

    #[test]
    fn named_quantities_are_rarely_wrong() {
        let mut rng = ChaCha8Rng::seed_from_u64(7);
        let mut named = 0;
        for seed in 0..400 {
            let quantities = noise(&mut rng, 12, 20);
            // Few failing units, as in a fleet: strongly tied results.
            let result: Vec<f64> = (0..20).map(|_| f64::from(u8::from(uniform(&mut rng) < 0.25))).collect();
            let Some(tests) = correlated_quantities(&quantities, &result, 199, seed) else { continue };
            named += usize::from(tests.iter().any(|test| test.p_adjusted <= 0.05));
        }
        // 20 expected; the limit is 3.5 standard deviations above.
        assert!(named <= 35, "{named} of 400");
    }

    #[test]
    fn cause_is_found_among_others() {
        let mut rng = ChaCha8Rng::seed_from_u64(8);
        let quantities = noise(&mut rng, 12, 20);
        let result: Vec<f64> = quantities[4].iter().map(|x| f64::from(u8::from(*x > 0.7))).collect();
        let tests = correlated_quantities(&quantities, &result, 1_999, 1).unwrap();
        let best = (0..12).min_by(|a, b| tests[*a].p_adjusted.total_cmp(&tests[*b].p_adjusted)).unwrap();
        assert!(best == 4 && tests[4].p_adjusted < 0.02 && tests[4].correlation > 0.6, "{tests:?}");
    }

    #[test]
    fn equal_results_cannot_be_tested() {
        let quantities = vec![vec![1.0, 2.0, 3.0], vec![5.0; 3]];
        assert_eq!(correlated_quantities(&quantities, &[1.0; 3], 99, 1), None);
        assert_eq!(correlated_quantities(&quantities, &[1.0, f64::NAN, 0.0], 99, 1), None);
        let tests = correlated_quantities(&quantities, &[1.0, 0.0, 0.0], 99, 1).unwrap();
        assert!(tests[1].correlation.abs() <= 0.0 && tests[1].p_adjusted >= 1.0);
    }
}
