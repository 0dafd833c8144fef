//! The rate of a rare event from rows sampled with unequal probabilities.
//!
//! Row i has the weight wᵢ, operating density over sampling density, and the event eᵢ. The estimate is y = Σ w e / n, which is
//! unbiased. The interval treats the events as a Poisson process whose points have weights (Fay and Feuer 1997, Statistics in
//! Medicine 16): with v = Σ w² e / n² and m = max(w) / n,
//!
//! ```text
//! low  = v / (2 y) χ²(α/2; 2 y²/v),   high = (v + m²) / (2 (y + m)) χ²(1 - α/2; 2 (y + m)²/(v + m²)).
//! ```
//!
//! With equal weights these are the exact limits of a Poisson mean (Garwood 1936). Intervals from a normal approximation cover
//! far too rarely at five events. Limits: a part of the space that the design never samples is invisible; where events are
//! frequent, the interval is too wide, because a binomial count varies less than a Poisson count.

use robogate_maths::gamma::ln_chi_squared_sf;

use crate::interval::{Confidence, Interval};
use crate::weighted::{WeightError, is_weight};

/// The rate of an event.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct EventRate {
    /// The estimate. `None` without rows.
    pub rate: Option<f64>,
    /// The interval, within [0, 1]. [0, 1] without rows.
    pub interval: Interval,
    /// The number of events.
    pub events: u64,
    /// The number of rows.
    pub rows: u64,
    /// The number of independent rows, each with weight 1, that would give the same standard error at this rate. `None`
    /// without events.
    pub worth: Option<f64>,
}

/// Estimates the rate of an event, with whether it occurred in each row and the weight of the row.
///
/// # Errors
/// Unequal lengths, or an invalid weight.
pub fn event_rate(events: &[bool], weights: &[f64], confidence: Confidence) -> Result<EventRate, WeightError> {
    if events.len() != weights.len() {
        return Err(WeightError::Length { expected: events.len(), found: weights.len() });
    }
    if let Some(row) = weights.iter().position(|w| !is_weight(*w)) {
        return Err(WeightError::BadWeight { row, value: weights[row] });
    }
    let count = events.iter().filter(|event| **event).count() as u64;
    if events.is_empty() {
        return Ok(EventRate { rate: None, interval: Interval::UNIT, events: 0, rows: 0, worth: None });
    }
    let n = events.len() as f64;
    let of_events = |power: i32| {
        let weighted = events.iter().zip(weights).filter(|(event, _)| **event);
        weighted.map(|(_, w)| (w / n).powi(power)).sum::<f64>()
    };
    let (y, v) = (of_events(1), of_events(2));
    let most = weights.iter().copied().fold(0.0, f64::max) / n;
    let half = confidence.tail();
    // A sum of weights in place of a count: mean and variance determine the scale and the degrees of freedom.
    let limit = |mean: f64, variance: f64, upper: f64| match variance > 0.0 {
        true => variance / (2.0 * mean) * chi_squared_quantile(2.0 * mean * mean / variance, upper),
        false => 0.0,
    };
    let low = limit(y, v, 1.0 - half);
    let high = limit(y + most, v + most * most, half);
    Ok(EventRate {
        rate: Some(y.min(1.0)),
        interval: Interval { low: low.clamp(0.0, 1.0), high: high.clamp(0.0, 1.0) },
        events: count,
        rows: events.len() as u64,
        worth: (v > 0.0).then(|| y * (1.0 - y).max(0.0) / v),
    })
}

/// The value that a chi-squared variable exceeds with this probability, by bisection.
fn chi_squared_quantile(df: f64, upper: f64) -> f64 {
    let wanted = upper.ln();
    let above = |x: f64| ln_chi_squared_sf(df, x) > wanted;
    let (mut low, mut high) = (0.0, df.max(1.0));
    while above(high) && high < 1e12 {
        high *= 2.0;
    }
    // Far below the precision of a double.
    for _ in 0..200 {
        let middle = 0.5 * (low + high);
        *(if above(middle) { &mut low } else { &mut high }) = middle;
    }
    0.5 * (low + high)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn equal_weights_give_poisson_limits() {
        // Garwood's 95 % limits.
        let table = [(0, 0.0, 3.688_879), (5, 1.623_486, 11.668_332), (20, 12.216_520, 30.888_380)];
        for (count, low, high) in table {
            let events: Vec<bool> = (0..1000).map(|i| i < count).collect();
            let found = event_rate(&events, &[1.0; 1000], Confidence::P95).unwrap();
            assert!((1000.0 * found.interval.low - low).abs() < 1e-4, "{found:?}");
            assert!((1000.0 * found.interval.high - high).abs() < 1e-4, "{found:?}");
            assert_eq!((found.events, found.rows), (count, 1000));
        }
    }

    #[test]
    fn smaller_weights_are_worth_more() {
        let found = event_rate(&[true, true, false, false], &[0.1, 0.1, 1.0, 1.0], Confidence::P95).unwrap();
        assert!((found.rate.unwrap() - 0.05).abs() < 1e-12);
        // y (1 - y) / v = 0.05 x 0.95 / (2 x 0.025^2).
        assert!((found.worth.unwrap() - 38.0).abs() < 1e-9, "{found:?}");
    }

    #[test]
    fn no_rows_are_no_evidence() {
        let none = event_rate(&[], &[], Confidence::P95).unwrap();
        assert_eq!((none.rate, none.interval), (None, Interval::UNIT));
        assert!(event_rate(&[true], &[], Confidence::P95).is_err());
        assert!(event_rate(&[true], &[f64::NAN], Confidence::P95).is_err());
    }
}
