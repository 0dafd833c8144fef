//! Logistic regression of success on the parameters.
//!
//! logit P(success | x) = β₀ + Σ βⱼ xⱼ, fitted by maximum likelihood (Newton with step-halving) on internally
//! standardized columns and reported raw or standardized. Standard errors come from the inverse information, or from
//! the sandwich I⁻¹ (Σ w² (y-p)² x xᵀ) I⁻¹ if weights are not counts. z = β/se. The p-value is stored as its logarithm,
//! which represents values below 1e-300.
//!
//! Quantities that cannot be estimated are reported:
//! - A constant column, or one that other columns explain, is [`Term::Dropped`] with the reason.
//! - Data that a linear function separates have no finite maximum likelihood estimate. [`Separation`] names the kind,
//!   the columns and the rows, and Firth's penalised fit is used instead ([`Estimator::FirthIfSeparated`], the
//!   default). Firth maximises ln L + ½ ln det I(β), which is always finite and removes the bias of order 1/n. Its Wald
//!   errors are inaccurate under separation; use [`firth_profile`] for intervals there.
//! - Fewer than ten events per coefficient give a [`Caution`].
//!
//! If rows come in clusters ([`Data::clustered`]), standard errors are those of a jackknife over clusters, and intervals and
//! p-values use Student's t with as many degrees of freedom as clusters exceed coefficients.
//!
//! Guarantee: a returned fit has converged (last Newton step below 1e-8 of a standardized unit). Limit: rows, or clusters,
//! are assumed independent. A wrong functional form is not detected; see [`crate::calibration`].
//! Sources: McCullagh and Nelder (1989), chapter 4; Albert and Anderson (1984); Firth (1993), Biometrika 80(1); Heinze
//! and Schemper (2002), Statistics in Medicine 21; White (1982) for the sandwich; Peduzzi et al. (1996) for ten events.

mod cone;
mod data;
mod newton;
mod separation;

use crate::interval::{Confidence, Interval};
use data::Standardized;
pub use data::{Data, Dropped};
use newton::Solution;
pub(crate) use newton::logistic_and_log;
use robogate_maths::beta::{ln_student_two_sided, student_quantile};
use robogate_maths::normal::ln_two_sided;
pub use separation::{Separation, SeparationKind};

/// The reason why there is no fit.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum RegressionError {
    /// A column and the outcomes have different lengths.
    #[error("column {column} has {found} rows. Expected {expected}, one for each outcome")]
    ColumnLength {
        /// Index of the column.
        column: usize,
        /// Rows of the outcomes.
        expected: usize,
        /// Rows of the column.
        found: usize,
    },
    /// The weights and the outcomes have different lengths.
    #[error("{found} weights. Expected {expected}, one for each outcome")]
    WeightLength {
        /// Rows of the outcomes.
        expected: usize,
        /// Rows of the weights.
        found: usize,
    },
    /// The clusters and the outcomes have different lengths.
    #[error("{found} numbers of clusters. Expected {expected}, one for each outcome")]
    ClusterLength {
        /// Rows of the outcomes.
        expected: usize,
        /// Rows of the clusters.
        found: usize,
    },
    /// A value is NaN or infinite.
    #[error("column {column}, row {row}: {value} is not valid. Expected a finite number. Hint: leave the row out")]
    NotFinite {
        /// Index of the column.
        column: usize,
        /// Index of the row.
        row: usize,
        /// Value found.
        value: f64,
    },
    /// A weight is negative, NaN, or so large or small that its square over- or underflows.
    #[error("the weight of row {row} is {value}. Expected 0 or a number from 1e-150 to 1e150")]
    BadWeight {
        /// Index of the row.
        row: usize,
        /// Value found.
        value: f64,
    },
    /// No row has positive weight.
    #[error("no row has positive weight. Expected at least one")]
    NoRows,
    /// All outcomes are equal, so no coefficient can be estimated.
    #[error("all {rows} rows have the same outcome (success: {success}); no coefficient can be estimated")]
    OneClass {
        /// Rows of positive weight.
        rows: usize,
        /// The common outcome.
        success: bool,
    },
    /// The data are separated, but only maximum likelihood was requested.
    #[error(
        "{kind:?} separation by columns {columns:?}: there is no finite maximum likelihood estimate. Hint: use Firth's fit",
        kind = .0.kind, columns = .0.columns
    )]
    Separated(Separation),
    /// The steps did not converge, and there is no separation.
    #[error("the fit did not converge in {iterations} steps. Hint: check for nearly collinear columns")]
    NotSettled {
        /// Steps taken.
        iterations: usize,
    },
    /// A profile was requested for a column that is not in the fit.
    #[error("column {column} is not part of the fit")]
    NotInFit {
        /// Index of the column.
        column: usize,
    },
}

/// The units of reported coefficients.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Scale {
    /// Per unit of the original column.
    #[default]
    Raw,
    /// Per standard deviation (divisor: total weight) of the column, about its mean.
    Standardized,
}

/// The maximised likelihood.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Estimator {
    /// Plain maximum likelihood. Separation is an error.
    MaximumLikelihood,
    /// Firth's penalised likelihood.
    Firth,
    /// Maximum likelihood, or Firth's likelihood if the data are separated.
    #[default]
    FirthIfSeparated,
}

/// The estimator of standard errors.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Covariance {
    /// Inverse information: rows are independent and weights are counts.
    #[default]
    Model,
    /// Sandwich: weights are sampling weights.
    Sandwich,
}

/// Options of the fit and the report.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Options {
    /// Units of the coefficients.
    pub scale: Scale,
    /// Likelihood.
    pub estimator: Estimator,
    /// Standard errors.
    pub covariance: Covariance,
}

impl Options {
    /// The default options, with the sandwich estimator for rows with sampling weights.
    pub fn for_rows(weighted: bool) -> Self {
        let covariance = if weighted { Covariance::Sandwich } else { Covariance::Model };
        Self { covariance, ..Self::default() }
    }
}

/// One estimated coefficient.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Coefficient {
    /// Estimate, in log-odds per unit.
    pub estimate: f64,
    /// Standard error.
    pub se: f64,
    /// Wald statistic, estimate / se.
    pub z: f64,
    /// Natural logarithm of the two-sided p-value.
    pub ln_p: f64,
    /// Degrees of freedom of Student's t, if rows come in clusters. Otherwise the normal distribution is used.
    pub degrees: Option<f64>,
}

impl Coefficient {
    fn new(estimate: f64, variance: f64, degrees: Option<f64>) -> Self {
        let se = variance.max(0.0).sqrt();
        let z = estimate / se;
        let ln_p = degrees.map_or_else(|| ln_two_sided(z), |df| ln_student_two_sided(df, z));
        Self { estimate, se, z, ln_p, degrees }
    }

    /// Two-sided p-value. 0 if it is below the smallest double; see `ln_p`.
    pub fn p(&self) -> f64 {
        self.ln_p.exp()
    }

    /// Wald interval, estimate ± z se.
    pub fn interval(&self, confidence: Confidence) -> Interval {
        let half = quantile(confidence, self.degrees) * self.se;
        Interval { low: self.estimate - half, high: self.estimate + half }
    }
}

/// The two-sided quantile of Student's t, or of the normal distribution without degrees of freedom.
fn quantile(confidence: Confidence, degrees: Option<f64>) -> f64 {
    degrees.map_or_else(|| confidence.z(), |df| student_quantile(df, confidence.level()))
}

/// The result for one column.
#[derive(Debug, Clone, PartialEq)]
pub enum Term {
    /// The column has a coefficient.
    Estimated(Coefficient),
    /// The column was dropped.
    Dropped(Dropped),
}

impl Term {
    /// The coefficient, if the column has one.
    pub fn coefficient(&self) -> Option<&Coefficient> {
        match self {
            Self::Estimated(coefficient) => Some(coefficient),
            Self::Dropped(_) => None,
        }
    }
}

/// A warning about a fit.
#[derive(Debug, Clone, PartialEq)]
pub enum Caution {
    /// The data are separated. The figures come from Firth's fit.
    Separated(Separation),
    /// The rarer outcome has fewer than ten rows per coefficient.
    FewEvents {
        /// Rows of the rarer outcome.
        events: usize,
        /// Number of coefficients, without the intercept.
        coefficients: usize,
    },
}

/// A fitted model.
#[derive(Debug, Clone, PartialEq)]
pub struct Fit {
    /// Intercept β₀, in the reported scale (log-odds at the mean row when standardized).
    pub intercept: Coefficient,
    /// One term per column.
    pub terms: Vec<Term>,
    /// Units of the coefficients.
    pub scale: Scale,
    /// The maximised likelihood: never [`Estimator::FirthIfSeparated`].
    pub estimator: Estimator,
    /// ln L at the estimate, without penalty.
    pub log_likelihood: f64,
    /// ½ ln det I on the standardized scale, if Firth's penalty was used.
    pub penalty: Option<f64>,
    /// ln L of the model with only an intercept.
    pub null_log_likelihood: f64,
    /// Steps taken.
    pub iterations: usize,
    /// Rows with positive weight.
    pub rows: usize,
    /// Warnings about the fit.
    pub cautions: Vec<Caution>,
    /// Raw coefficients, intercept first, 0 for dropped columns.
    raw: Vec<f64>,
    /// Covariance in the raw scale, row-major, 0 for dropped columns.
    raw_covariance: Vec<f64>,
    /// Covariance in the reported scale.
    covariance: Vec<f64>,
}

impl Fit {
    /// -2 ln L.
    pub fn deviance(&self) -> f64 {
        -2.0 * self.log_likelihood
    }

    /// Covariance of two parameters in the reported scale: 0 is the intercept, c + 1 is column c.
    ///
    /// `None` for an index that does not exist or a dropped column.
    pub fn covariance(&self, a: usize, b: usize) -> Option<f64> {
        let in_fit = |i: usize| i == 0 || self.terms.get(i - 1).is_some_and(|t| t.coefficient().is_some());
        (in_fit(a) && in_fit(b)).then(|| self.covariance[a * (self.terms.len() + 1) + b])
    }

    /// The quantile of intervals of the coefficients: of Student's t if rows come in clusters, otherwise the normal one.
    pub fn quantile(&self, confidence: Confidence) -> f64 {
        quantile(confidence, self.intercept.degrees)
    }

    /// Coefficients per raw unit, intercept first, 0 for dropped columns. They do not depend on the reported scale.
    pub fn raw_coefficients(&self) -> &[f64] {
        &self.raw
    }

    /// The covariance of the raw coefficients, row-major, 0 for dropped columns.
    pub fn raw_covariance(&self) -> &[f64] {
        &self.raw_covariance
    }

    /// Log-odds of success for one raw row. `None` if its length differs from the number of columns.
    pub fn log_odds(&self, row: &[f64]) -> Option<f64> {
        (row.len() == self.terms.len())
            .then(|| self.raw[0] + row.iter().zip(&self.raw[1..]).map(|(x, b)| x * b).sum::<f64>())
    }

    /// Probability of success for one raw row. `None` if its length differs from the number of columns.
    pub fn probability(&self, row: &[f64]) -> Option<f64> {
        self.log_odds(row).map(|t| logistic_and_log(t).0)
    }

    /// Interval for the probability of success of one raw row, from the Wald interval of its log-odds.
    pub fn probability_interval(&self, row: &[f64], confidence: Confidence) -> Option<Interval> {
        let t = self.log_odds(row)?;
        let q = self.raw.len();
        let x = |i: usize| if i == 0 { 1.0 } else { row[i - 1] };
        let mut variance = 0.0;
        for i in 0..q {
            for j in 0..q {
                variance += x(i) * x(j) * self.raw_covariance[i * q + j];
            }
        }
        let half = self.quantile(confidence) * variance.max(0.0).sqrt();
        Some(Interval { low: logistic_and_log(t - half).0, high: logistic_and_log(t + half).0 })
    }

    /// Probabilities of success for whole columns. `None` if their number or lengths do not match.
    pub fn probabilities(&self, columns: &[&[f64]]) -> Option<Vec<f64>> {
        let rows = columns.first().map_or(0, |c| c.len());
        if columns.len() != self.terms.len() || columns.iter().any(|c| c.len() != rows) {
            return None;
        }
        let mut eta = vec![self.raw[0]; rows];
        for (column, b) in columns.iter().zip(&self.raw[1..]) {
            for (e, x) in eta.iter_mut().zip(*column) {
                *e += b * x;
            }
        }
        eta.iter_mut().for_each(|e| *e = logistic_and_log(*e).0);
        Some(eta)
    }
}

/// Fits the model.
///
/// # Errors
/// No rows, one class, separation although Firth's fit is not allowed, or no convergence.
pub fn fit(data: Data<'_>, options: Options) -> Result<Fit, RegressionError> {
    let x = prepare(data)?;
    let mut cautions = Vec::new();
    let solution = match options.estimator {
        Estimator::Firth => firth(&x)?,
        Estimator::MaximumLikelihood | Estimator::FirthIfSeparated => match maximum_likelihood(&x) {
            Answer::Settled(solution) => solution,
            Answer::Separated(found) if options.estimator == Estimator::MaximumLikelihood => {
                return Err(RegressionError::Separated(found));
            }
            Answer::Separated(found) => {
                cautions.push(Caution::Separated(found));
                firth(&x)?
            }
            Answer::Neither { iterations } => return Err(RegressionError::NotSettled { iterations }),
        },
    };
    let events = x.successes.min(x.rows - x.successes);
    if events < 10 * x.kept.len() {
        cautions.push(Caution::FewEvents { events, coefficients: x.kept.len() });
    }
    Ok(report(&x, &solution, options, cautions))
}

/// Tests for separation without another fit. `None` if the outcomes overlap.
///
/// # Errors
/// No rows, one class, or no convergence without separation.
pub fn separation(data: Data<'_>) -> Result<Option<Separation>, RegressionError> {
    let x = prepare(data)?;
    match maximum_likelihood(&x) {
        Answer::Settled(_) => Ok(None),
        Answer::Separated(found) => Ok(Some(found)),
        Answer::Neither { iterations } => Err(RegressionError::NotSettled { iterations }),
    }
}

/// The result of maximum likelihood.
enum Answer {
    Settled(Solution),
    Separated(Separation),
    Neither { iterations: usize },
}

fn maximum_likelihood(x: &Standardized<'_>) -> Answer {
    let mut found = None;
    let result = newton::maximum_likelihood(x, |beta| {
        found = separation::find(x, beta);
        found.is_some()
    });
    match (result, found) {
        (Ok(solution), _) => Answer::Settled(solution),
        (Err(_), Some(found)) => Answer::Separated(found),
        (Err(unsettled), None) => match separation::find(x, &unsettled.beta) {
            Some(found) => Answer::Separated(found),
            None => Answer::Neither { iterations: unsettled.iterations },
        },
    }
}

/// Profile interval and test of one column under Firth's likelihood.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Profile {
    /// Estimate per raw unit.
    pub estimate: f64,
    /// Interval per raw unit. An end is infinite if the profile does not fall below the limit within the search range.
    pub interval: Interval,
    /// ln of the p-value of the penalised likelihood ratio test for a zero coefficient.
    pub ln_p: f64,
}

/// Profile penalised likelihood of one column. It is valid under separation, where Wald errors are not.
///
/// The interval contains the values b with 2 (l* - l*(b)) ≤ χ²₁, where l*(b) is the penalised likelihood maximised over
/// the other coefficients (Heinze and Schemper 2002).
///
/// # Errors
/// As [`fit`], or [`RegressionError::NotInFit`].
pub fn firth_profile(data: Data<'_>, column: usize, confidence: Confidence) -> Result<Profile, RegressionError> {
    let x = prepare(data)?;
    let position = x.kept.iter().position(|&c| c == column).ok_or(RegressionError::NotInFit { column })?;
    let j = position + 1;
    let best = firth(&x)?;
    let objective = |s: &Solution| s.log_likelihood + s.penalty.unwrap_or(0.0);
    let top = objective(&best);
    let se = best.inverse_information[j * x.parameters() + j].max(0.0).sqrt();
    let limit = 0.5 * confidence.z().powi(2);
    let drop_at = |b: f64, from: &[f64]| -> Result<(f64, Vec<f64>), RegressionError> {
        let s = newton::firth(&x, Some((j, b)), Some(from)).map_err(not_settled)?;
        Ok((top - objective(&s), s.beta))
    };
    let end = |side: f64| -> Result<f64, RegressionError> {
        let mut inside = best.beta[j];
        let mut from = best.beta.clone();
        let mut step = confidence.z() * se;
        let mut outside = None;
        for _ in 0..12 {
            let b = inside + side * step;
            let (drop, beta) = drop_at(b, &from)?;
            from = beta;
            if drop > limit {
                outside = Some(b);
                break;
            }
            inside = b;
            step *= 1.5;
        }
        let Some(mut outside) = outside else {
            return Ok(side * f64::INFINITY);
        };
        for _ in 0..60 {
            let middle = 0.5 * (inside + outside);
            let (drop, beta) = drop_at(middle, &from)?;
            from = beta;
            if drop > limit {
                outside = middle;
            } else {
                inside = middle;
            }
            if (outside - inside).abs() <= 1e-9 * (1.0 + inside.abs()) {
                break;
            }
        }
        Ok(0.5 * (inside + outside))
    };
    let low = end(-1.0)?;
    let high = end(1.0)?;
    let (drop, _) = drop_at(0.0, &best.beta)?;
    let scale = x.deviations[position];
    Ok(Profile {
        estimate: best.beta[j] / scale,
        interval: Interval { low: low / scale, high: high / scale },
        ln_p: ln_two_sided((2.0 * drop.max(0.0)).sqrt()),
    })
}

fn prepare(data: Data<'_>) -> Result<Standardized<'_>, RegressionError> {
    let x = Standardized::new(data);
    if x.rows == 0 {
        Err(RegressionError::NoRows)
    } else if x.successes == 0 || x.successes == x.rows {
        Err(RegressionError::OneClass { rows: x.rows, success: x.successes > 0 })
    } else {
        Ok(x)
    }
}

fn firth(x: &Standardized<'_>) -> Result<Solution, RegressionError> {
    newton::firth(x, None, None).map_err(not_settled)
}

fn not_settled(unsettled: newton::Unsettled) -> RegressionError {
    RegressionError::NotSettled { iterations: unsettled.iterations }
}

/// Transforms the solution from standardized columns to the caller's columns.
fn report(x: &Standardized<'_>, solution: &Solution, options: Options, cautions: Vec<Caution>) -> Fit {
    let q = x.parameters();
    let (covariance, degrees) = match (x.clusters(), options.covariance) {
        (Some(of_row), _) => {
            let (covariance, clusters) = newton::clustered(x, solution, of_row);
            // Too few clusters for the coefficients leave one degree of freedom, with which almost nothing is significant.
            (covariance, Some((clusters as f64 - q as f64).max(1.0)))
        }
        (None, Covariance::Model) => (solution.inverse_information.clone(), None),
        (None, Covariance::Sandwich) => (newton::sandwich(x, solution), None),
    };
    // Raw = T standardized: slopes are divided by the standard deviation, and the intercept absorbs the means.
    let mut transform = vec![0.0; q * q];
    transform[0] = 1.0;
    for j in 1..q {
        transform[j] = -x.means[j - 1] / x.deviations[j - 1];
        transform[j * q + j] = 1.0 / x.deviations[j - 1];
    }
    let raw_beta: Vec<f64> = (0..q).map(|i| (0..q).map(|k| transform[i * q + k] * solution.beta[k]).sum()).collect();
    let mut transposed = vec![0.0; q * q];
    for i in 0..q {
        for j in 0..q {
            transposed[j * q + i] = transform[i * q + j];
        }
    }
    let raw_covariance = newton::product(&transform, &newton::product(&covariance, &transposed, q), q);

    let full = x.full_width() + 1;
    let place = |i: usize| if i == 0 { 0 } else { x.kept[i - 1] + 1 };
    let spread = |matrix: &[f64]| {
        let mut wide = vec![0.0; full * full];
        for i in 0..q {
            for j in 0..q {
                wide[place(i) * full + place(j)] = matrix[i * q + j];
            }
        }
        wide
    };
    let mut raw = vec![0.0; full];
    for i in 0..q {
        raw[place(i)] = raw_beta[i];
    }
    let (shown, shown_covariance) = match options.scale {
        Scale::Raw => (&raw_beta, &raw_covariance),
        Scale::Standardized => (&solution.beta, &covariance),
    };
    let coefficient = |i: usize| Coefficient::new(shown[i], shown_covariance[i * q + i], degrees);
    let mut terms: Vec<Term> = vec![Term::Dropped(Dropped::Constant); full - 1];
    for (column, why) in &x.dropped {
        terms[*column] = Term::Dropped(why.clone());
    }
    for j in 1..q {
        terms[x.kept[j - 1]] = Term::Estimated(coefficient(j));
    }
    let failures = x.weight - x.success_weight;
    let null_log_likelihood =
        x.success_weight * (x.success_weight / x.weight).ln() + failures * (failures / x.weight).ln();
    Fit {
        intercept: coefficient(0),
        terms,
        scale: options.scale,
        estimator: if solution.penalty.is_some() { Estimator::Firth } else { Estimator::MaximumLikelihood },
        log_likelihood: solution.log_likelihood,
        penalty: solution.penalty,
        null_log_likelihood,
        iterations: solution.iterations,
        rows: x.rows,
        cautions,
        raw,
        raw_covariance: spread(&raw_covariance),
        covariance: spread(shown_covariance),
    }
}

/// Elementwise product of two columns: the interaction term of a model.
pub fn interaction(a: &[f64], b: &[f64]) -> Vec<f64> {
    a.iter().zip(b).map(|(x, y)| x * y).collect()
}

/// Centres a column and scales it to unit standard deviation (divisor n), as needed for an interaction of standardized
/// columns. `None` if the column is constant or empty.
pub fn standardized(column: &[f64]) -> Option<Vec<f64>> {
    let n = column.len() as f64;
    let mean = column.iter().sum::<f64>() / n;
    let deviation = (column.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / n).sqrt();
    (deviation > 1e-12 * mean.abs() && deviation.is_finite())
        .then(|| column.iter().map(|v| (v - mean) / deviation).collect())
}

#[cfg(test)]
mod tests {
    use rand_chacha::ChaCha8Rng;
    use rand_core::SeedableRng;

    use super::*;
    use crate::resample::uniform;

    #[test]
    fn clusters_keep_the_level_of_p_values() {
        // Scenarios have their own rates, which depend on nothing.
        let (mut by_cluster, mut by_row) = (0, 0);
        for seed in 0..300 {
            let mut rng = ChaCha8Rng::seed_from_u64(seed);
            let of_row: Vec<usize> = (0..900).map(|row| row / 60).collect();
            let rates: Vec<f64> = (0..15).map(|_| uniform(&mut rng)).collect();
            let mut column = || -> Vec<f64> {
                let points: Vec<f64> = (0..15).map(|_| uniform(&mut rng)).collect();
                of_row.iter().map(|of| points[*of]).collect()
            };
            let (a, b) = (column(), column());
            let outcomes: Vec<bool> = of_row.iter().map(|of| uniform(&mut rng) < rates[*of]).collect();
            let columns: [&[f64]; 2] = [&a, &b];
            let data = Data::new(&columns, &outcomes, None).unwrap();
            let p = |data: Data<'_>| fit(data, Options::default()).unwrap().terms[0].coefficient().unwrap().p();
            by_cluster += u32::from(p(data.clustered(Some(&of_row)).unwrap()) <= 0.05);
            by_row += u32::from(p(data) <= 0.05);
        }
        assert!(by_cluster <= 24, "{by_cluster} of 300");
        assert!(by_row >= 150, "{by_row} of 300");
    }

    #[test]
    fn single_rows_as_clusters_give_the_sandwich() {
        let x: Vec<f64> = (0..800).map(|i| f64::from(i % 40)).collect();
        let outcomes: Vec<bool> = (0..800).map(|i| (i * 37) % 101 < 30 + (i % 40)).collect();
        let of_row: Vec<usize> = (0..800).collect();
        let columns: [&[f64]; 1] = [&x];
        let data = Data::new(&columns, &outcomes, None).unwrap();
        let se = |data, options| fit(data, options).unwrap().terms[0].coefficient().unwrap().se;
        let clustered = se(data.clustered(Some(&of_row)).unwrap(), Options::default());
        let sandwich = se(data, Options { covariance: Covariance::Sandwich, ..Options::default() });
        assert!((clustered / sandwich - 1.0).abs() < 0.002, "{clustered} {sandwich}");
        assert!(data.clustered(Some(&of_row[1..])).is_err());
    }
}
