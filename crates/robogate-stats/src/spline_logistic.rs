//! Ridge logistic regression on linear splines and products of columns.
//!
//! Each column enters as a line and as hinges max(0, x - k) with knots k at its quartiles; a column with two values
//! enters as a line only. Chosen columns also enter as products of pairs. All terms are scaled to mean 0 and standard
//! deviation 1 over the fitted rows, and share one normal prior, whose variance the evidence selects ([`crate::ridge`]).
//!
//! The splines are additive and the products linear, so the model extrapolates gently. It needs fewer rows than trees
//! ([`crate::boosting`]) where the truth is smooth. Sources: Friedman (1991), Annals of Statistics 19, for hinges; the
//! sources of [`crate::ridge`].

use crate::flexible::numbers;
use crate::logistic::{Data, RegressionError};
use crate::ridge::{self, RidgeFit};

/// The prior variances of which the evidence selects one.
const PRIOR_VARIANCES: [f64; 3] = [0.02, 0.1, 0.5];

/// A fitted model.
#[derive(Debug, Clone)]
pub struct SplineLogistic {
    form: SplineForm,
    fit: RidgeFit,
}

/// The part of a model that predicts.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct SplineForm {
    terms: Vec<SplineTerm>,
    /// Mean and standard deviation of each term.
    scale: Vec<(f64, f64)>,
    /// The intercept, then one coefficient for each term.
    coefficients: Vec<f64>,
}

/// A term of the linear predictor.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum SplineTerm {
    /// The value of a column.
    Line(usize),
    /// max(0, x - knot) of a column.
    Hinge(usize, f64),
    /// The product of two columns.
    Product(usize, usize),
}

/// The numbers of a fitted model, with which another program can evaluate it.
///
/// With the terms t(x), z = (1, (t(x) - mean) / deviation): the log-odds of success have the posterior mean z'β and the
/// posterior variance |L⁻¹z|².
#[derive(Debug, Clone, Copy)]
pub struct SplineParts<'a> {
    /// The terms.
    pub terms: &'a [SplineTerm],
    /// Mean and standard deviation of each term.
    pub scale: &'a [(f64, f64)],
    /// β: the intercept, then one coefficient for each term.
    pub coefficients: &'a [f64],
    /// L, the lower Cholesky factor of the posterior precision, row by row, with zeros above the diagonal.
    pub precision_factor: &'a [f64],
}

impl SplineTerm {
    fn at(self, row: impl Fn(usize) -> f64) -> f64 {
        match self {
            Self::Line(column) => row(column),
            Self::Hinge(column, knot) => (row(column) - knot).max(0.0),
            Self::Product(a, b) => row(a) * row(b),
        }
    }
}

impl SplineLogistic {
    /// Fits the model. `interacting` lists the columns whose products are terms.
    ///
    /// # Errors
    /// As [`ridge::fit`], and if the lengths of the columns differ.
    pub fn fit(columns: &[&[f64]], outcomes: &[bool], interacting: &[usize]) -> Result<Self, RegressionError> {
        let rows = outcomes.len();
        let mut terms = Vec::new();
        for (at, column) in columns.iter().enumerate() {
            let mut sorted = column.to_vec();
            sorted.sort_unstable_by(f64::total_cmp);
            sorted.dedup();
            terms.push(SplineTerm::Line(at));
            if sorted.len() > 2 {
                let mut all = column.to_vec();
                all.sort_unstable_by(f64::total_cmp);
                let mut knots: Vec<f64> =
                    (1..4).map(|quarter| all[(quarter * all.len() / 4).min(all.len() - 1)]).collect();
                knots.dedup();
                terms.extend(knots.into_iter().map(|knot| SplineTerm::Hinge(at, knot)));
            }
        }
        for (i, a) in interacting.iter().enumerate() {
            terms.extend(interacting[..i].iter().map(|b| SplineTerm::Product(*b, *a)));
        }
        let mut scale = Vec::with_capacity(terms.len());
        let mut kept = Vec::with_capacity(terms.len());
        let mut values: Vec<Vec<f64>> = Vec::with_capacity(terms.len());
        for term in terms {
            let mut value: Vec<f64> = (0..rows).map(|row| term.at(|at| columns[at][row])).collect();
            let mean = value.iter().sum::<f64>() / rows.max(1) as f64;
            let deviation = (value.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / rows.max(1) as f64).sqrt();
            // A constant term is the intercept, and a value that is not finite fits no line.
            if deviation.is_finite() && deviation > 1e-9 * mean.abs().max(1e-9) {
                value.iter_mut().for_each(|x| *x = (*x - mean) / deviation);
                values.push(value);
                scale.push((mean, deviation));
                kept.push(term);
            }
        }
        let views: Vec<&[f64]> = values.iter().map(Vec::as_slice).collect();
        let data = Data::new(&views, outcomes, None)?;
        let fit = ridge::by_evidence(data, &PRIOR_VARIANCES)?.ok_or(RegressionError::NoRows)?;
        Ok(Self { form: SplineForm { terms: kept, scale, coefficients: fit.coefficients.clone() }, fit })
    }

    /// Log-odds of success of one row at the posterior mode.
    pub fn log_odds(&self, row: &[f64]) -> f64 {
        self.form.log_odds(row)
    }

    /// The part that predicts.
    pub fn form(&self) -> &SplineForm {
        &self.form
    }

    /// The numbers of the model.
    pub fn parts(&self) -> SplineParts<'_> {
        SplineParts {
            terms: &self.form.terms,
            scale: &self.form.scale,
            coefficients: &self.form.coefficients,
            precision_factor: self.fit.precision_factor(),
        }
    }

    /// The number of terms.
    pub fn terms(&self) -> usize {
        self.form.terms.len()
    }
}

impl SplineForm {
    /// Log-odds of success of one row.
    pub(crate) fn log_odds(&self, row: &[f64]) -> f64 {
        let at = |column: usize| row.get(column).copied().unwrap_or(f64::NAN);
        let Some((intercept, beta)) = self.coefficients.split_first() else { return 0.0 };
        let terms = self.terms.iter().zip(&self.scale).zip(beta);
        terms.fold(*intercept, |sum, ((term, (mean, deviation)), beta)| sum + beta * (term.at(at) - mean) / deviation)
    }

    /// The model as text: the intercept, then one line for each term with mean, deviation and coefficient.
    pub(crate) fn lines(&self) -> Vec<String> {
        let intercept = self.coefficients.first().copied().unwrap_or_default();
        let terms = self.terms.iter().zip(&self.scale).zip(self.coefficients.iter().skip(1));
        let term = |((term, (mean, deviation)), beta): ((&SplineTerm, &(f64, f64)), &f64)| {
            let term = match term {
                SplineTerm::Line(column) => format!("line {column}"),
                SplineTerm::Hinge(column, knot) => format!("hinge {column} {knot}"),
                SplineTerm::Product(a, b) => format!("product {a} {b}"),
            };
            format!("{term} {mean} {deviation} {beta}")
        };
        std::iter::once(format!("spline {intercept}")).chain(terms.map(term)).collect()
    }

    /// Reads a line of [`Self::lines`] for rows of this many columns. `None` if it is not valid.
    pub(crate) fn read(&mut self, kind: &str, words: &[&str], columns: usize) -> Option<()> {
        if kind == "spline" && self.coefficients.is_empty() {
            let [intercept] = numbers(words)?;
            self.coefficients.push(intercept);
            return Some(());
        }
        let column = |at: usize| words.get(at)?.parse().ok().filter(|column: &usize| *column < columns);
        let (term, rest) = match kind {
            "line" => (SplineTerm::Line(column(0)?), words.get(1..)?),
            "hinge" => (SplineTerm::Hinge(column(0)?, numbers::<1>(words.get(1..2)?)?[0]), words.get(2..)?),
            "product" => (SplineTerm::Product(column(0)?, column(1)?), words.get(2..)?),
            _ => return None,
        };
        let [mean, deviation, beta] = numbers(rest)?;
        let valid = deviation > 0.0 && !self.coefficients.is_empty();
        self.terms.push(term);
        self.scale.push((mean, deviation));
        self.coefficients.push(beta);
        valid.then_some(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::logistic::logistic_and_log;

    #[test]
    fn kink_and_product_are_found() {
        // The chance of success depends on |x - 0.5| and on the product of two centred columns.
        let rows = 4000;
        let unit = |i: usize, prime: usize| ((i * prime) % 9973) as f64 / 9973.0;
        let x: Vec<f64> = (0..rows).map(|i| unit(i, 7919)).collect();
        let y: Vec<f64> = (0..rows).map(|i| unit(i, 104_729 % 9973) - 0.5).collect();
        let truth = |x: f64, y: f64| logistic_and_log(2.0 - 8.0 * (x - 0.5).abs() + 4.0 * y * (x - 0.5)).0;
        let outcomes: Vec<bool> = (0..rows).map(|i| unit(i * i + 17, 6151) < truth(x[i], y[i])).collect();
        let columns: [&[f64]; 2] = [&x, &y];
        let model = SplineLogistic::fit(&columns, &outcomes, &[0, 1]).unwrap();
        assert_eq!(model.terms(), 9);
        for (x, y) in [(0.1, 0.0), (0.5, 0.0), (0.9, 0.3), (0.9, -0.3)] {
            let p = logistic_and_log(model.log_odds(&[x, y])).0;
            assert!((p - truth(x, y)).abs() < 0.08, "({x}, {y}): {p} {}", truth(x, y));
        }
    }

    #[test]
    fn constant_columns_are_left_out() {
        let columns: [&[f64]; 2] = [&[1.0, 2.0, 3.0, 4.0], &[5.0; 4]];
        let model = SplineLogistic::fit(&columns, &[false, false, true, true], &[]).unwrap();
        assert!(model.log_odds(&[4.0, 5.0]) > model.log_odds(&[1.0, 5.0]));
    }
}
