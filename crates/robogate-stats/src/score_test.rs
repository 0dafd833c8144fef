//! Score tests: does a further column improve a fitted logistic model?
//!
//! For a model with columns X (intercept included), fitted probabilities p and W = diag(p (1 - p)), the score of a
//! further column z is U = z'(y - p). Its variance is V = z'Wz - z'WX (X'WX)⁻¹ X'Wz, and U/√V is standard normal if z has
//! no effect. The model is fitted once for any number of columns. Rows with sampling weights a have W = diag(a p (1 - p)) and
//! U = z'diag(a)(y - p), whose variance is estimated by Σ (a (y - p) z̃)², with z̃ the part of z that X leaves unexplained.
//! Sources: Rao (1948); Cox and Hinkley (1974), 9.3; Binder (1983), International Statistical Review 51, for weights.
//!
//! Limit: the normal distribution is an approximation. It needs a few dozen rows of the rarer outcome.

use robogate_maths::dense::{Cholesky, dot};
use robogate_maths::normal::ln_two_sided;

use crate::logistic::{Data, Fit, Term};

/// Smallest pivot, as a fraction of its diagonal.
const PIVOT: f64 = 1e-10;
/// Smallest part of a column's weighted variance that the model must leave unexplained.
const COLLINEAR: f64 = 1e-6;

/// The two-sided p-value of a standard normal score.
pub fn two_sided(z: f64) -> f64 {
    ln_two_sided(z).exp()
}

/// A fitted model, prepared for score tests.
#[derive(Debug)]
pub struct ScoreTest<'a> {
    /// The columns of the fit, without the intercept.
    columns: Vec<&'a [f64]>,
    /// a (y - p).
    residual: Vec<f64>,
    /// a p (1 - p).
    weight: Vec<f64>,
    /// Whether the rows have sampling weights.
    is_weighted: bool,
    gram: Cholesky,
}

impl<'a> ScoreTest<'a> {
    /// Prepares tests of further columns. `fit` must be a fit to `data`. `None` if it is not, or if it is degenerate.
    pub fn new(data: Data<'a>, fit: &Fit) -> Option<Self> {
        let p = if data.width() == 0 {
            vec![1.0 / (1.0 + (-fit.raw_coefficients()[0]).exp()); data.rows()]
        } else {
            fit.probabilities(data.columns())?
        };
        let kept = |(column, term): (&&'a [f64], &Term)| term.coefficient().map(|_| *column);
        let columns: Vec<&[f64]> = data.columns().iter().zip(&fit.terms).filter_map(kept).collect();
        let of_row = |row: usize| data.weights().map_or(1.0, |weights| weights[row]);
        let weight: Vec<f64> = p.iter().enumerate().map(|(row, p)| of_row(row) * p * (1.0 - p)).collect();
        let difference = |(row, (y, p)): (usize, (&bool, &f64))| of_row(row) * (f64::from(u8::from(*y)) - p);
        let residual = data.outcomes().iter().zip(&p).enumerate().map(difference).collect();
        let q = columns.len() + 1;
        let mut gram = vec![0.0; q * q];
        let mut weighted = vec![0.0; data.rows()];
        for i in 0..q {
            match i {
                0 => weighted.copy_from_slice(&weight),
                _ => weighted.iter_mut().zip(columns[i - 1]).zip(&weight).for_each(|((t, x), w)| *t = x * w),
            }
            gram[i * q] = weighted.iter().sum();
            for j in 1..=i {
                gram[i * q + j] = dot(&weighted, columns[j - 1]);
            }
        }
        for i in 0..q {
            for j in 0..i {
                gram[j * q + i] = gram[i * q + j];
            }
        }
        let gram = Cholesky::new(&gram, q, PIVOT).ok()?;
        Some(Self { columns, residual, weight, is_weighted: data.weights().is_some(), gram })
    }

    /// The standard normal score of a column. `None` if its length differs or if it is a combination of the others.
    pub fn z(&self, column: &[f64]) -> Option<f64> {
        if column.len() != self.residual.len() {
            return None;
        }
        let weighted: Vec<f64> = column.iter().zip(&self.weight).map(|(z, w)| z * w).collect();
        let mut cross: Vec<f64> = vec![weighted.iter().sum()];
        cross.extend(self.columns.iter().map(|x| dot(&weighted, x)));
        let total = dot(&weighted, column);
        // z'WX (X'WX)⁻¹ X'Wz = |L⁻¹ X'Wz|².
        let mut forward = cross.clone();
        self.gram.forward(&mut forward);
        let variance = total - dot(&forward, &forward);
        if variance <= COLLINEAR * total.max(f64::MIN_POSITIVE) {
            return None;
        }
        let variance = if self.is_weighted { self.robust_variance(column, cross) } else { variance };
        (variance > 0.0).then(|| dot(column, &self.residual) / variance.sqrt())
    }

    /// Σ (a (y - p) z̃)². `cross` is X'Wz.
    fn robust_variance(&self, column: &[f64], mut cross: Vec<f64>) -> f64 {
        self.gram.solve(&mut cross);
        let explained =
            |row: usize| cross[0] + self.columns.iter().zip(&cross[1..]).map(|(x, b)| x[row] * b).sum::<f64>();
        column.iter().zip(&self.residual).enumerate().map(|(row, (z, r))| ((z - explained(row)) * r).powi(2)).sum()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::logistic::{Options, fit, interaction};
    use crate::resample::uniform;
    use rand_chacha::ChaCha8Rng;
    use rand_core::SeedableRng;

    /// Two parameters from -1 to 1, and outcomes with an interaction.
    fn rows(seed: u64, n: usize, strength: f64) -> ([Vec<f64>; 2], Vec<bool>) {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let mut column = || (0..n).map(|_| 2.0 * uniform(&mut rng) - 1.0).collect::<Vec<f64>>();
        let (a, b) = (column(), column());
        let p = |i: usize| 1.0 / (1.0 + (-(a[i] - 2.0 * b[i] + strength * a[i] * b[i])).exp());
        let y = (0..n).map(|i| uniform(&mut rng) < p(i)).collect();
        ([a, b], y)
    }

    #[test]
    fn score_is_standard_normal_without_interaction() {
        let (mut mean, mut square) = (0.0, 0.0);
        for seed in 0..300 {
            let ([a, b], y) = rows(seed, 300, 0.0);
            let columns: [&[f64]; 2] = [&a, &b];
            let data = Data::new(&columns, &y, None).unwrap();
            let z = ScoreTest::new(data, &fit(data, Options::default()).unwrap()).unwrap();
            let z = z.z(&interaction(&a, &b)).unwrap();
            mean += z / 300.0;
            square += z * z / 300.0;
        }
        assert!(mean.abs() < 0.2 && (square - 1.0).abs() < 0.25, "mean {mean}, mean square {square}");
    }

    #[test]
    fn weighted_score_is_standard_normal_without_interaction() {
        let (mut mean, mut square) = (0.0, 0.0);
        for seed in 0..300 {
            let ([a, b], y) = rows(seed, 400, 0.0);
            let weights: Vec<f64> = a.iter().map(|a| if *a > 0.0 { 2.0 } else { 0.3 }).collect();
            let columns: [&[f64]; 2] = [&a, &b];
            let data = Data::new(&columns, &y, Some(&weights)).unwrap();
            let z = ScoreTest::new(data, &fit(data, Options::default()).unwrap()).unwrap();
            let z = z.z(&interaction(&a, &b)).unwrap();
            mean += z / 300.0;
            square += z * z / 300.0;
        }
        assert!(mean.abs() < 0.2 && (square - 1.0).abs() < 0.25, "mean {mean}, mean square {square}");
    }

    #[test]
    fn planted_interaction_is_found() {
        let ([a, b], y) = rows(1, 1_000, 3.0);
        let columns: [&[f64]; 2] = [&a, &b];
        let data = Data::new(&columns, &y, None).unwrap();
        let test = ScoreTest::new(data, &fit(data, Options::default()).unwrap()).unwrap();
        assert!(test.z(&interaction(&a, &b)).unwrap() > 5.0);
        assert!(test.z(&a).is_none(), "a column of the model adds nothing");
        assert!(test.z(&[1.0]).is_none());
    }
}
