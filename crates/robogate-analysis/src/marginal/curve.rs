//! The success rate as a smooth function of one parameter.

use robogate_stats::Confidence;
use robogate_stats::logistic::{Data, Options, fit};

use crate::MarginalEffect;

/// Number of points of a curve.
const POINTS: usize = 41;
/// Smallest number of bins with episodes for a curve with three coefficients.
const MIN_BINS: usize = 4;

/// A point of a curve.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CurvePoint {
    /// The value of the parameter.
    pub at: f64,
    /// The estimated success rate.
    pub rate: f64,
    /// The 95 % interval of the rate at this value.
    pub interval_95: [f64; 2],
}

impl MarginalEffect {
    /// The success rate as a smooth function of the parameter, over the bins that hold episodes: a logistic regression on
    /// the parameter and its square, fitted to the bins at their centres. Empty for a parameter without bins, and where
    /// the model cannot be fitted.
    pub fn curve(&self) -> Vec<CurvePoint> {
        self.fitted().unwrap_or_default()
    }

    fn fitted(&self) -> Option<Vec<CurvePoint>> {
        let cells: Vec<([f64; 2], f64, f64)> = self
            .cells
            .iter()
            .filter(|cell| cell.rate.n > 0)
            .map(|cell| {
                let n = cell.rate.independent();
                let k = n * cell.rate.rate.unwrap_or(0.0);
                cell.range.map(|range| (range, k, n - k))
            })
            .collect::<Option<_>>()?;
        if cells.len() < MIN_BINS {
            return None;
        }
        let (low, high) = (cells.first()?.0[0], cells.last()?.0[1]);
        let position = |x: f64| 2.0 * (x - low) / (high - low) - 1.0;
        let centre = |[from, to]: [f64; 2]| position(0.5 * (from + to));
        // Two rows for each bin: its successes and its failures, with their numbers as weights.
        let linear: Vec<f64> = cells.iter().flat_map(|(range, ..)| [centre(*range); 2]).collect();
        let square: Vec<f64> = linear.iter().map(|x| x * x).collect();
        let outcomes: Vec<bool> = cells.iter().flat_map(|_| [true, false]).collect();
        let counts: Vec<f64> = cells.iter().flat_map(|(_, successes, failures)| [*successes, *failures]).collect();
        let columns: [&[f64]; 2] = [&linear, &square];
        let model = fit(Data::new(&columns, &outcomes, Some(&counts)).ok()?, Options::default()).ok()?;
        let point = |i: usize| {
            let at = low + (high - low) * i as f64 / (POINTS - 1) as f64;
            let row = [position(at), position(at).powi(2)];
            let interval = model.probability_interval(&row, Confidence::P95)?;
            Some(CurvePoint { at, rate: model.probability(&row)?, interval_95: [interval.low, interval.high] })
        };
        (0..POINTS).map(point).collect()
    }
}
