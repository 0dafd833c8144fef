//! Estimates for a population from rows sampled with unequal probabilities.
//!
//! wᵢ is the weight of row i: operating density over design density, up to a constant factor.
//!
//! - [`hajek`]: m = Σ w y / Σ w, with the linearised variance n/(n-1) · Σ w²(y - m)² / (Σ w)². The constant factor of w
//!   cancels; the bias is of order 1/n.
//! - [`horvitz_thompson`]: Σ w y / N for weights that are inverse inclusion probabilities and a known N. It is
//!   unbiased, but may leave [0, 1] and varies more if Σ w varies.
//! - Effective sample size (Kish): (Σ w)² / Σ w².
//!
//! The interval is Wilson's at an effective count: the smaller of Kish's and m(1-m)/variance, which prevents double
//! counting of outcomes that are correlated with large weights. Without successes or without failures, only Kish's is
//! used. Limit: weights cannot represent parts of the operating space where the design density is zero. Sources: Hajek
//! (1971); Horvitz and Thompson (1952), JASA 47; Kish (1965); Korn and Graubard (1998) for binomial intervals at
//! effective counts.

use crate::interval::{Confidence, Interval, wilson_real};

/// The reason why weighted rows cannot be evaluated.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum WeightError {
    /// Lengths differ.
    #[error("{found} weights. Expected {expected}, one for each outcome")]
    Length {
        /// Rows of the outcomes.
        expected: usize,
        /// Weights found.
        found: usize,
    },
    /// A weight is negative, NaN, or so large or small that its square over- or underflows.
    #[error("the weight of row {row} is {value}. Expected 0 or a number from 1e-150 to 1e150")]
    BadWeight {
        /// Index of the row.
        row: usize,
        /// Value found.
        value: f64,
    },
    /// The population size is not a positive number.
    #[error("the population is {population}. Expected a number of at least 1")]
    BadPopulation {
        /// Value found.
        population: f64,
    },
}

/// A success rate of the population that the weights describe.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct WeightedRate {
    /// Estimate. `None` if no row has weight.
    pub rate: Option<f64>,
    /// Standard error. `None` below two rows of positive weight, or if all outcomes are equal (a zero would claim
    /// certainty).
    pub se: Option<f64>,
    /// Interval at the requested level. [0, 1] if no row has weight.
    pub interval: Interval,
    /// Kish's effective sample size.
    pub effective: f64,
    /// The number of independent trials that the interval counts: at most the effective sample size.
    pub independent: f64,
    /// Rows of positive weight.
    pub rows: usize,
    /// Sum of the weights.
    pub total_weight: f64,
}

/// Whether a weight is zero, or positive with a normal square and reciprocal.
pub(crate) fn is_weight(w: f64) -> bool {
    w >= 0.0 && (w <= 0.0 || (1e-150..=1e150).contains(&w))
}

fn check(outcomes: &[bool], weights: &[f64]) -> Result<(), WeightError> {
    if outcomes.len() != weights.len() {
        return Err(WeightError::Length { expected: outcomes.len(), found: weights.len() });
    }
    match weights.iter().position(|w| !is_weight(*w)) {
        Some(row) => Err(WeightError::BadWeight { row, value: weights[row] }),
        None => Ok(()),
    }
}

/// Kish's effective sample size (Σ w)² / Σ w². 0 if no weight is positive.
pub fn effective_sample_size(weights: &[f64]) -> f64 {
    // Division by the largest weight keeps squares finite.
    let largest = weights.iter().copied().fold(0.0, f64::max);
    let sum: f64 = weights.iter().map(|w| w / largest).sum();
    let square: f64 = weights.iter().map(|w| (w / largest).powi(2)).sum();
    if largest > 0.0 && square > 0.0 { sum * sum / square } else { 0.0 }
}

/// Success rate of the population by Hajek's ratio.
///
/// # Errors
/// Unequal lengths or an invalid weight.
pub fn hajek(outcomes: &[bool], weights: &[f64], confidence: Confidence) -> Result<WeightedRate, WeightError> {
    check(outcomes, weights)?;
    let rows = weights.iter().filter(|w| **w > 0.0).count();
    let total: f64 = weights.iter().sum();
    let effective = effective_sample_size(weights);
    if rows == 0 {
        return Ok(WeightedRate {
            rate: None,
            se: None,
            interval: Interval::UNIT,
            effective,
            independent: 0.0,
            rows,
            total_weight: total,
        });
    }
    // Weights are divided by their sum via the largest one first, because the sum of huge weights may not be finite.
    let largest = weights.iter().copied().fold(0.0, f64::max);
    let share = |i: usize| weights[i] / largest;
    let sum: f64 = (0..weights.len()).map(share).sum();
    // The sum of no numbers is -0.0, and this is printed.
    let successes: f64 = (0..weights.len()).filter(|&i| outcomes[i]).map(share).sum::<f64>() + 0.0;
    let rate = (successes / sum).min(1.0);
    let squares: f64 = (0..weights.len()).map(|i| (share(i) * (f64::from(u8::from(outcomes[i])) - rate)).powi(2)).sum();
    let n = rows as f64;
    let variance = n / (n - 1.0) * squares / (sum * sum);
    let se = (rows > 1 && variance > 0.0).then(|| variance.sqrt());
    let spread = rate * (1.0 - rate);
    let count = match se {
        Some(se) if spread > 0.0 => effective.min(spread / (se * se)),
        _ => effective,
    };
    Ok(WeightedRate {
        rate: Some(rate),
        se,
        interval: wilson_real(rate * count, count, confidence.z()),
        effective,
        independent: count,
        rows,
        total_weight: total,
    })
}

/// An unbiased estimate, which may leave [0, 1].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct HorvitzThompson {
    /// Σ w y / N.
    pub rate: f64,
    /// Standard error for draws with replacement (Hansen and Hurwitz 1943). `None` below two rows.
    pub se: Option<f64>,
    /// Σ w / N, near 1 if the weights describe the population.
    pub weight_share: f64,
}

/// Success rate of a population of known size by Horvitz and Thompson. Weights are inverse inclusion probabilities.
///
/// # Errors
/// Unequal lengths, an invalid weight, or a population that is not positive.
pub fn horvitz_thompson(outcomes: &[bool], weights: &[f64], population: f64) -> Result<HorvitzThompson, WeightError> {
    check(outcomes, weights)?;
    if !(population > 0.0 && population.is_finite()) {
        return Err(WeightError::BadPopulation { population });
    }
    let n = weights.len() as f64;
    let term = |i: usize| if outcomes[i] { weights[i] / population } else { 0.0 };
    let rate: f64 = (0..weights.len()).map(term).sum();
    let squares: f64 = (0..weights.len()).map(|i| (term(i) - rate / n).powi(2)).sum();
    Ok(HorvitzThompson {
        rate,
        se: (weights.len() > 1).then(|| (n / (n - 1.0) * squares).sqrt()),
        weight_share: weights.iter().map(|w| w / population).sum(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::interval::{Trials, wilson};

    #[test]
    fn no_weight_gives_no_rate() {
        let r = hajek(&[true, true], &[0.0, 0.0], Confidence::P95).unwrap();
        assert_eq!((r.rate, r.interval, r.rows), (None, Interval::UNIT, 0));
        assert_eq!(r.effective, 0.0);
    }

    #[test]
    fn equal_weights_give_plain_rate() {
        let outcomes: Vec<bool> = (0..200).map(|i| i % 4 == 0).collect();
        let r = hajek(&outcomes, &vec![3.0; 200], Confidence::P95).unwrap();
        let plain = wilson(Trials::new(50, 200).unwrap(), Confidence::P95);
        assert!((r.rate.unwrap() - 0.25).abs() < 1e-15 && (r.effective - 200.0).abs() < 1e-9);
        assert!((r.interval.low - plain.low).abs() < 5e-4 && (r.interval.high - plain.high).abs() < 5e-4);
    }

    #[test]
    fn zero_successes_leave_an_interval() {
        let r = hajek(&[false; 30], &[1.0; 30], Confidence::P95).unwrap();
        assert_eq!((r.rate, r.se, r.interval.low), (Some(0.0), None, 0.0));
        assert!(r.rate.unwrap().is_sign_positive());
        assert!(r.interval.high > 0.1);
    }

    #[test]
    fn heavy_row_counts_as_one() {
        let mut weights = vec![1e-6; 100];
        weights[0] = 1.0;
        let r = hajek(&[true; 100], &weights, Confidence::P95).unwrap();
        assert!((r.effective - 1.0).abs() < 1e-3 && r.interval.low < 0.25);
    }

    #[test]
    fn weights_correct_a_focused_design() {
        // Population: 80 % easy with rate 0.9, 20 % hard with rate 0.1. The design samples half of each.
        let outcomes: Vec<bool> = (0..1000).map(|i| if i < 500 { i % 10 != 0 } else { i % 10 == 0 }).collect();
        let weights: Vec<f64> = (0..1000).map(|i| if i < 500 { 1.6 } else { 0.4 }).collect();
        let r = hajek(&outcomes, &weights, Confidence::P95).unwrap();
        assert!((r.rate.unwrap() - 0.74).abs() < 1e-12);
        let h = horvitz_thompson(&outcomes, &weights, 1000.0).unwrap();
        assert!((h.rate - 0.74).abs() < 1e-12 && (h.weight_share - 1.0).abs() < 1e-12);
        assert!(h.se.unwrap() > r.se.unwrap());
    }
}
