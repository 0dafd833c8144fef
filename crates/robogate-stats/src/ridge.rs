//! Logistic regression with a normal prior on its coefficients, for many correlated columns.
//!
//! logit P(success | x) = β₀ + Σ βⱼ xⱼ with βⱼ ~ N(0, s²) and a flat prior on β₀. The fit is the posterior mode, which
//! exists for every data set with both outcomes, separated or not. Columns are not rescaled: the caller must bring them
//! to a common scale, because all share one prior.
//!
//! - Evidence, by Laplace's approximation: ln L - |β|²/(2 s²) - (q/2) ln s² - ½ ln det H, with q columns and H the
//!   curvature of the penalised likelihood. Fits to the same rows are comparable, up to one constant.
//! - Prediction averages over the posterior: P = logistic(η / sqrt(1 + π v / 8)), with v the variance of η.
//!   This never moves a row to the other side of 50 %.
//!
//! Sources: MacKay (1992), Neural Computation 4(5), for evidence and moderated output; Bishop (2006), 4.4 and 4.5.

use crate::logistic::{Data, RegressionError, logistic_and_log};
use robogate_maths::dense::{Cholesky, dot};

/// Rows per block.
const BLOCK: usize = 128;
/// Smallest pivot, as a fraction of its diagonal, that counts as positive.
const PIVOT: f64 = 1e-14;
/// Maximum number of steps.
const MOST_STEPS: usize = 100;

/// A fitted model.
#[derive(Debug, Clone)]
pub struct RidgeFit {
    /// β₀ first, then one coefficient per column.
    pub coefficients: Vec<f64>,
    /// s², the prior variance of every coefficient except β₀.
    pub prior_variance: f64,
    /// ln L at the mode, without the prior.
    pub log_likelihood: f64,
    /// ln of the evidence, up to a constant that depends on the rows.
    pub log_evidence: f64,
    /// Newton steps taken.
    pub iterations: usize,
    curvature: Cholesky,
}

/// Fits the model at one prior variance.
///
/// # Errors
/// No rows, one class, or no convergence. A prior variance that is not positive never converges.
pub fn fit(data: Data<'_>, prior_variance: f64) -> Result<RidgeFit, RegressionError> {
    from(data, prior_variance, start(data)?)
}

/// Fits the model at each prior variance and returns the fit with the largest evidence. `None` for an empty list.
///
/// # Errors
/// As [`fit`].
pub fn by_evidence(data: Data<'_>, prior_variances: &[f64]) -> Result<Option<RidgeFit>, RegressionError> {
    by_evidence_watched(data, prior_variances, &mut || {})
}

/// As [`by_evidence`]. `fitted` is called after each fit.
///
/// # Errors
/// As [`fit`].
pub fn by_evidence_watched(
    data: Data<'_>,
    prior_variances: &[f64],
    fitted: &mut dyn FnMut(),
) -> Result<Option<RidgeFit>, RegressionError> {
    let mut beta = start(data)?;
    let mut best: Option<RidgeFit> = None;
    for s2 in prior_variances {
        let found = from(data, *s2, beta)?;
        fitted();
        beta = found.coefficients.clone();
        if best.as_ref().is_none_or(|b| found.log_evidence > b.log_evidence) {
            best = Some(found);
        }
    }
    Ok(best)
}

impl RidgeFit {
    /// L, the lower Cholesky factor of the posterior precision (the curvature at the mode), row by row.
    pub fn precision_factor(&self) -> &[f64] {
        self.curvature.lower()
    }

    /// Moderated log-odds of success for whole columns. `None` if their number or lengths do not match.
    pub fn log_odds(&self, columns: &[&[f64]]) -> Option<Vec<f64>> {
        let moderate = |(eta, variance): (f64, f64)| eta / (1.0 + std::f64::consts::PI * variance / 8.0).sqrt();
        Some(self.posterior(columns)?.into_iter().map(moderate).collect())
    }

    /// Posterior mean and variance of the log-odds for whole columns. `None` if their number or lengths do not match.
    pub fn posterior(&self, columns: &[&[f64]]) -> Option<Vec<(f64, f64)>> {
        let rows = columns.first().map_or(0, |c| c.len());
        if columns.len() + 1 != self.coefficients.len() || columns.iter().any(|c| c.len() != rows) {
            return None;
        }
        let mut x = vec![0.0; self.coefficients.len()];
        let log_odds = |row: usize| {
            x[0] = 1.0;
            for (x, column) in x[1..].iter_mut().zip(columns) {
                *x = column[row];
            }
            let eta = dot(&x, &self.coefficients);
            self.curvature.forward(&mut x);
            (eta, dot(&x, &x))
        };
        Some((0..rows).map(log_odds).collect())
    }
}

/// The start of the search: all slopes are 0, and β₀ is the log-odds of the weighted rate.
fn start(data: Data<'_>) -> Result<Vec<f64>, RegressionError> {
    let (mut weight, mut successes) = ([0.0; 2], 0);
    let mut rows = 0;
    for (row, success) in data.outcomes().iter().enumerate() {
        let w = data.weights().map_or(1.0, |w| w[row]);
        if w > 0.0 {
            rows += 1;
            successes += usize::from(*success);
            weight[usize::from(*success)] += w;
        }
    }
    if rows == 0 {
        return Err(RegressionError::NoRows);
    }
    if successes == 0 || successes == rows {
        return Err(RegressionError::OneClass { rows, success: successes > 0 });
    }
    let mut beta = vec![0.0; data.width() + 1];
    beta[0] = (weight[1] / weight[0]).ln();
    Ok(beta)
}

/// Newton's method on the penalised likelihood, which is concave. A step that lowers it is halved.
fn from(data: Data<'_>, prior_variance: f64, start: Vec<f64>) -> Result<RidgeFit, RegressionError> {
    let q = start.len();
    let precision = 1.0 / prior_variance;
    let mut beta = start;
    let mut here = evaluate(data, &beta, precision);
    for iterations in 1..=MOST_STEPS {
        let unsettled = RegressionError::NotSettled { iterations };
        let Ok(factor) = Cholesky::new(&here.curvature, q, PIVOT) else { return Err(unsettled) };
        let mut step = here.gradient.clone();
        factor.solve(&mut step);
        let slack = 1e-13 * here.objective.abs();
        let mut accepted = None;
        for _ in 0..40 {
            let trial: Vec<f64> = beta.iter().zip(&step).map(|(b, s)| b + s).collect();
            let there = evaluate(data, &trial, precision);
            if there.objective >= here.objective - slack {
                accepted = Some((trial, there));
                break;
            }
            step.iter_mut().for_each(|s| *s *= 0.5);
        }
        let Some((trial, there)) = accepted else { return Err(unsettled) };
        (beta, here) = (trial, there);
        let scale = beta.iter().fold(1.0_f64, |m, b| m.max(b.abs()));
        if step.iter().all(|s| s.abs() <= 1e-8 * scale) {
            let Ok(curvature) = Cholesky::new(&here.curvature, q, PIVOT) else { return Err(unsettled) };
            let log_evidence = here.objective - 0.5 * (q - 1) as f64 * prior_variance.ln() - 0.5 * curvature.ln_det();
            let log_likelihood = here.log_likelihood;
            return Ok(RidgeFit {
                coefficients: beta,
                prior_variance,
                log_likelihood,
                log_evidence,
                iterations,
                curvature,
            });
        }
    }
    Err(RegressionError::NotSettled { iterations: MOST_STEPS })
}

/// The penalised likelihood and its derivatives at one point.
struct Local {
    log_likelihood: f64,
    /// ln L - |β|²/(2 s²).
    objective: f64,
    gradient: Vec<f64>,
    /// The negative second derivatives.
    curvature: Vec<f64>,
}

fn evaluate(data: Data<'_>, beta: &[f64], precision: f64) -> Local {
    let q = beta.len();
    let (mut gradient, mut curvature) = (vec![0.0; q], vec![0.0; q * q]);
    let mut log_likelihood = 0.0;
    let ones = [1.0; BLOCK];
    let (mut residual, mut slope, mut weighted) = ([0.0; BLOCK], [0.0; BLOCK], [0.0; BLOCK]);
    for first in (0..data.rows()).step_by(BLOCK) {
        let n = BLOCK.min(data.rows() - first);
        let column = |j: usize| if j == 0 { &ones[..n] } else { &data.columns()[j - 1][first..first + n] };
        let mut eta = [beta[0]; BLOCK];
        for (j, b) in beta.iter().enumerate().skip(1) {
            eta.iter_mut().zip(column(j)).for_each(|(e, x)| *e += b * x);
        }
        for i in 0..n {
            let sign = if data.outcomes()[first + i] { 1.0 } else { -1.0 };
            let w = data.weights().map_or(1.0, |w| w[first + i]);
            let (p, log) = logistic_and_log(sign * eta[i]);
            let (other, _) = logistic_and_log(-sign * eta[i]);
            log_likelihood += w * log;
            residual[i] = w * sign * other;
            slope[i] = w * p * other;
        }
        for i in 0..q {
            let x = column(i);
            gradient[i] += dot(&residual[..n], x);
            for ((t, x), s) in weighted.iter_mut().zip(x).zip(&slope) {
                *t = x * s;
            }
            for j in 0..=i {
                curvature[i * q + j] += dot(&weighted[..n], column(j));
            }
        }
    }
    let mut square = 0.0;
    for i in 0..q {
        if i > 0 {
            square += beta[i] * beta[i];
            gradient[i] -= precision * beta[i];
            curvature[i * q + i] += precision;
        }
        for j in 0..i {
            curvature[j * q + i] = curvature[i * q + j];
        }
    }
    Local { log_likelihood, objective: log_likelihood - 0.5 * precision * square, gradient, curvature }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn separated_data_have_finite_fit() {
        let x = [-2.0, -1.0, 1.0, 2.0];
        let y = [false, false, true, true];
        let columns: [&[f64]; 1] = [&x];
        let data = Data::new(&columns, &y, None).unwrap();
        let narrow = fit(data, 0.1).unwrap().coefficients[1];
        let wide = fit(data, 10.0).unwrap().coefficients[1];
        assert!(0.0 < narrow && narrow < wide && wide.is_finite());
    }

    #[test]
    fn invalid_prior_and_class_are_rejected() {
        let x = [1.0, 2.0];
        let columns: [&[f64]; 1] = [&x];
        let one = Data::new(&columns, &[true, true], None).unwrap();
        assert!(matches!(fit(one, 1.0), Err(RegressionError::OneClass { rows: 2, success: true })));
        let both = Data::new(&columns, &[true, false], None).unwrap();
        for s2 in [f64::NAN, 0.0, -1.0] {
            assert!(matches!(fit(both, s2), Err(RegressionError::NotSettled { .. })), "{s2}");
        }
        assert!(by_evidence(both, &[]).unwrap().is_none());
    }

    #[test]
    fn distant_predictions_approach_one_half() {
        let x: Vec<f64> = (0..40).map(|i| f64::from(i) / 20.0 - 1.0).collect();
        let y: Vec<bool> = x.iter().enumerate().map(|(i, x)| *x > 0.0 || i % 7 == 0).collect();
        let columns: [&[f64]; 1] = [&x];
        let found = fit(Data::new(&columns, &y, None).unwrap(), 4.0).unwrap();
        let plain = logistic_and_log(found.coefficients[0] + 50.0 * found.coefficients[1]).0;
        let moderated = logistic_and_log(found.log_odds(&[&[50.0]]).unwrap()[0]).0;
        assert!(plain > 1.0 - 1e-9 && moderated < 0.999 && moderated > 0.5, "{plain} {moderated}");
    }
}
