//! Means over repeats of an experiment that are all evaluated on the same rows.
//!
//! `x[r][i]`, repeat r at test row i, varies from two sources: the training data of the repeat, and the choice of rows.
//! Let v_r be the variance of the repeats' means divided by the number of repeats, and v_i that of the rows' means
//! divided by the number of rows. The variance of the grand mean is estimated as v_r + v_i, which counts the common
//! part twice and is conservative. The interval is Student's with Satterthwaite's degrees of freedom, (v_r + v_i)² /
//! (v_r²/(k - 1) + v_i²/(n - 1)).
//!
//! Limit: with few repeats the interval is wide; with one repeat there is no interval.
//! Sources: Satterthwaite (1946), Biometrics Bulletin 2(6); Owen (2007), Annals of Applied Statistics 1(2), for
//! variances of crossed designs; Hillis (2007), Statistics in Medicine 26(3), for readers and cases.

use crate::interval::{Confidence, Interval};
use robogate_maths::beta::student_quantile;

/// The reason why there is no mean.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum CrossedError {
    /// No repeats or no rows.
    #[error("no measurements. Expected at least one repeat with one row")]
    Empty,
    /// Repeats with different numbers of rows.
    #[error("repeat {repeat} has {found} rows. Expected {expected}, as in the first repeat")]
    Length {
        /// The repeat, from 0.
        repeat: usize,
        /// Rows of the first repeat.
        expected: usize,
        /// Rows of this repeat.
        found: usize,
    },
}

/// A mean over repeats and rows.
#[derive(Debug, Clone, PartialEq)]
pub struct CrossedMean {
    /// The mean.
    pub mean: f64,
    /// The mean of each repeat.
    pub repeats: Vec<f64>,
    /// Standard error over the repeats. `None` with one repeat.
    pub se_repeats: Option<f64>,
    /// Standard error over the rows. `None` with one row.
    pub se_rows: Option<f64>,
    /// Student's interval. `None` with one repeat or one row, or if the values do not vary.
    pub interval: Option<Interval>,
}

/// The mean of `table[r][i]`, repeat by row.
///
/// # Errors
/// An empty table, or repeats of unequal length.
pub fn crossed_mean(table: &[Vec<f64>], confidence: Confidence) -> Result<CrossedMean, CrossedError> {
    let expected = table.first().map_or(0, Vec::len);
    if expected == 0 {
        return Err(CrossedError::Empty);
    }
    if let Some(repeat) = table.iter().position(|row| row.len() != expected) {
        return Err(CrossedError::Length { repeat, expected, found: table[repeat].len() });
    }
    let repeats: Vec<f64> = table.iter().map(|row| mean(row)).collect();
    let rows: Vec<f64> =
        (0..expected).map(|i| table.iter().map(|row| row[i]).sum::<f64>() / table.len() as f64).collect();
    let grand = mean(&repeats);
    let (of_repeats, of_rows) = (variance_of_mean(&repeats), variance_of_mean(&rows));
    let interval = of_repeats.zip(of_rows).and_then(|(v_r, v_i)| {
        let variance = v_r + v_i;
        let spread = v_r * v_r / (repeats.len() - 1) as f64 + v_i * v_i / (rows.len() - 1) as f64;
        (variance > 0.0 && spread > 0.0).then(|| {
            let half = student_quantile(variance * variance / spread, confidence.level()) * variance.sqrt();
            Interval { low: grand - half, high: grand + half }
        })
    });
    Ok(CrossedMean {
        mean: grand,
        repeats,
        se_repeats: of_repeats.map(f64::sqrt),
        se_rows: of_rows.map(f64::sqrt),
        interval,
    })
}

fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len() as f64
}

/// S²/n; `None` below two values.
fn variance_of_mean(values: &[f64]) -> Option<f64> {
    let (m, n) = (mean(values), values.len() as f64);
    (values.len() > 1).then(|| values.iter().map(|v| (v - m).powi(2)).sum::<f64>() / (n - 1.0) / n)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn single_repeat_has_no_interval() {
        let found = crossed_mean(&[vec![1.0, 2.0, 4.0]], Confidence::P95).unwrap();
        assert!((found.mean - 7.0 / 3.0).abs() < 1e-15);
        assert_eq!((found.se_repeats, found.interval), (None, None));
    }

    #[test]
    fn constant_values_have_no_interval() {
        let found = crossed_mean(&[vec![0.0; 5], vec![0.0; 5]], Confidence::P95).unwrap();
        assert_eq!((found.mean, found.interval), (0.0, None));
    }

    #[test]
    fn invalid_tables_are_rejected() {
        assert_eq!(crossed_mean(&[], Confidence::P95), Err(CrossedError::Empty));
        assert_eq!(crossed_mean(&[vec![], vec![]], Confidence::P95), Err(CrossedError::Empty));
        let ragged = crossed_mean(&[vec![1.0, 2.0], vec![1.0]], Confidence::P95);
        assert_eq!(ragged, Err(CrossedError::Length { repeat: 1, expected: 2, found: 1 }));
    }

    #[test]
    fn interval_has_nominal_coverage() {
        // x = a_r + b_i + noise, with mean 0.
        let mut rng = <rand_chacha::ChaCha8Rng as rand_core::SeedableRng>::seed_from_u64(3);
        // A sum of twelve uniform numbers is close enough to a normal one.
        let mut normal = || (0..12).map(|_| crate::resample::uniform(&mut rng)).sum::<f64>() - 6.0;
        let (trials, mut covered) = (2000, 0);
        for _ in 0..trials {
            let rows: Vec<f64> = (0..40).map(|_| normal()).collect();
            let table: Vec<Vec<f64>> = (0..5)
                .map(|_| {
                    let own = 0.2 * normal();
                    rows.iter().map(|b| own + b + normal()).collect()
                })
                .collect();
            let found = crossed_mean(&table, Confidence::P95).unwrap();
            covered += usize::from(found.interval.unwrap().contains(0.0));
        }
        let share = covered as f64 / f64::from(trials);
        assert!((0.94..0.985).contains(&share), "{share}");
    }
}
