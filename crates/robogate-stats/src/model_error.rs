//! The error of predicted probabilities, from pairs of outcomes.
//!
//! Two independent outcomes y1 and y2 (0 or 1) at the same point with the unknown probability p, and a prediction q that
//! used neither: E[(q - y1)(q - y2)] = (q - p)². The mean over pairs of points therefore estimates the mean squared error
//! of the predictions without bias, although no p is known. The mean of (y1 - y2)²/2 estimates the mean of p(1 - p), the
//! error that no prediction can avoid.
//!
//! The upper bound is that of [`crate::bounded_mean`] for one look: it holds for every distribution of p and q and every
//! number of pairs. Terms lie between -1/4 and 1. Limit: both outcomes must be independent given the point, and no pair
//! may have been used for the prediction.

use crate::bounded_mean::{BoundedMean, OutOfBounds};

/// Smallest value of a term: q = 1/2 between two different outcomes.
const LEAST: f64 = -0.25;

/// Two outcomes at one point, and the prediction there.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pair {
    /// The predicted probability of success, from 0 to 1.
    pub predicted: f64,
    /// The outcomes.
    pub success: [bool; 2],
}

/// The error of predictions.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ModelError {
    /// Number of pairs.
    pub pairs: usize,
    /// Estimate of the mean of (q - p)². It may be negative by chance.
    pub mean_square: f64,
    /// Its standard error. `None` below two pairs.
    pub se: Option<f64>,
    /// Upper bound of the root of the mean of (q - p)², at the requested level.
    pub rms_bound: f64,
    /// Estimate of the mean of p(1 - p).
    pub noise: f64,
}

/// The error of predictions from these pairs. The bound fails with a probability of at most `alpha`. `None` without
/// pairs.
///
/// # Errors
/// A prediction outside [0, 1].
pub fn model_error(pairs: &[Pair], alpha: f64) -> Result<Option<ModelError>, OutOfBounds> {
    if let Some(index) = pairs.iter().position(|pair| !(0.0..=1.0).contains(&pair.predicted)) {
        return Err(OutOfBounds { index, value: pairs[index].predicted, ceiling: 1.0 });
    }
    if pairs.is_empty() {
        return Ok(None);
    }
    let term = |pair: &Pair| {
        let [a, b] = pair.success.map(|y| pair.predicted - f64::from(u8::from(y)));
        a * b
    };
    let n = pairs.len() as f64;
    let mean_square = pairs.iter().map(term).sum::<f64>() / n;
    let squares: f64 = pairs.iter().map(|pair| (term(pair) - mean_square).powi(2)).sum();
    let shifted: Vec<f64> = pairs.iter().map(|pair| (term(pair) - LEAST).clamp(0.0, 1.0 - LEAST)).collect();
    let look = [shifted.len()];
    let bound = BoundedMean::new(&shifted, &look, 1.0 - LEAST)?.interval(alpha).high + LEAST;
    let different = pairs.iter().filter(|pair| pair.success[0] != pair.success[1]).count();
    Ok(Some(ModelError {
        pairs: pairs.len(),
        mean_square,
        se: (pairs.len() > 1).then(|| (squares / (n * (n - 1.0))).sqrt()),
        rms_bound: bound.max(0.0).sqrt(),
        noise: 0.5 * different as f64 / n,
    }))
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand_chacha::ChaCha8Rng;
    use rand_core::SeedableRng;

    use crate::resample::uniform;

    /// Pairs at points with a uniform probability p, predicted with an error of 0.1 in either direction.
    fn pairs(n: usize, random: &mut ChaCha8Rng) -> (Vec<Pair>, f64) {
        let mut square = 0.0;
        let pairs = (0..n)
            .map(|_| {
                let p = uniform(random);
                let predicted = if uniform(random) < 0.5 { p - 0.1 } else { p + 0.1 }.clamp(0.0, 1.0);
                square += (predicted - p).powi(2);
                Pair { predicted, success: [uniform(random) < p, uniform(random) < p] }
            })
            .collect();
        (pairs, square / n as f64)
    }

    #[test]
    fn estimate_is_unbiased_and_bound_covers() {
        let mut random = ChaCha8Rng::seed_from_u64(3);
        let (runs, mut sum, mut misses) = (400, 0.0, 0);
        for _ in 0..runs {
            let (pairs, _) = pairs(200, &mut random);
            let found = model_error(&pairs, 0.05).unwrap().unwrap();
            // E[(q - p)²] with clamping at both ends.
            let truth = 0.01 - 2.0 * 0.5 * (0.01 * 0.1 - 0.1_f64.powi(3) / 3.0);
            sum += found.mean_square - truth;
            misses += usize::from(found.rms_bound < truth.sqrt());
        }
        // The standard error of the mean over the runs is about 0.0006.
        assert!((sum / f64::from(runs)).abs() < 0.0025, "{}", sum / f64::from(runs));
        assert!(misses <= 20, "{misses} of {runs}");
    }

    #[test]
    fn bound_tightens_with_pairs() {
        let mut random = ChaCha8Rng::seed_from_u64(4);
        let mut bound = |n| model_error(&pairs(n, &mut random).0, 0.05).unwrap().unwrap().rms_bound;
        let bounds = [bound(50), bound(500), bound(10_000)];
        assert!(bounds[0] > bounds[1] && bounds[1] > bounds[2] && bounds[2] < 0.14, "{bounds:?}");
    }

    #[test]
    fn no_pairs_and_bad_predictions() {
        assert_eq!(model_error(&[], 0.05), Ok(None));
        let bad = Pair { predicted: f64::NAN, success: [true, false] };
        assert!(model_error(&[bad], 0.05).is_err());
    }
}
