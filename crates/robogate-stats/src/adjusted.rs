//! A success rate with less variance: known distributions of the parameters as a control variate.
//!
//! The points of a campaign are sampled from known distributions, so the mean over the operating space of any function
//! of one parameter is known. A linear model of the outcome, y = β0 + Σ f(parameter) + e, gives the rate over the operating
//! space from these means. Its variance is only that of e: the part of the outcome that single parameters do not explain.
//! A numeric parameter has a piecewise linear f, a categorical one a value for each level. For independent points this is a
//! regression estimator. The points of a Latin hypercube have the known means already, so the estimate stays near the
//! observed rate, and the smaller variance is the true one: a Latin hypercube removes the variance of all additive parts.
//! A piecewise constant f would leave the variance within its bins and make the interval too wide for steep effects.
//!
//! The interval is Wilson's at the number of independent episodes with the same variance, n' = p (1 - p) / variance.
//!
//! Limits: knots must be fixed before the outcomes are seen, and the rows must determine the model. The model needs enough
//! rows of the rarer outcome. `examples/adjusted.rs` measures the coverage; `docs/results/variance-reduction.md` has the
//! figures. Sources: Cochran (1977), Sampling Techniques, chapter 7; Stein (1987), Technometrics 29(2), and Owen (1992), JRSS
//! B 54(2), for Latin hypercubes.

use robogate_maths::dense::{Cholesky, dot};

use crate::{Confidence, Interval};

/// Smallest pivot, as a fraction of its diagonal.
const PIVOT: f64 = 1e-9;
/// Fewest rows of the rarer outcome.
pub const FEWEST: usize = 50;
/// Fewest rows for each coefficient.
pub const ROWS_PER_COEFFICIENT: usize = 8;

/// One parameter with a known distribution.
#[derive(Debug, Clone)]
pub enum Control {
    /// A parameter with levels.
    Levels {
        /// The level of each row.
        of: Vec<u16>,
        /// The share of the operating space of each level. They add up to 1.
        shares: Vec<f64>,
    },
    /// A numeric parameter that is uniform on its scale.
    Uniform {
        /// The value of each row, from 0 to 1.
        at: Vec<f64>,
        /// The number of knots of the piecewise linear function, at least 2. They have equal distances.
        knots: usize,
    },
}

impl Control {
    fn rows(&self) -> usize {
        match self {
            Self::Levels { of, .. } => of.len(),
            Self::Uniform { at, .. } => at.len(),
        }
    }

    fn is_valid(&self) -> bool {
        match self {
            Self::Levels { of, shares } => of.iter().all(|level| usize::from(*level) < shares.len()),
            Self::Uniform { at, knots } => *knots >= 2 && at.iter().all(|x| (0.0..=1.0).contains(x)),
        }
    }

    /// The number of functions. They add up to 1, so the last one is not used.
    fn functions(&self) -> usize {
        match self {
            Self::Levels { shares, .. } => shares.len(),
            Self::Uniform { knots, .. } => *knots,
        }
    }

    /// The functions that are not 0 at a row, and their values there.
    fn at(&self, row: usize) -> [(usize, f64); 2] {
        match self {
            Self::Levels { of, .. } => [(usize::from(of[row]), 1.0), (usize::MAX, 0.0)],
            Self::Uniform { at, knots } => {
                let place = at[row] * (knots - 1) as f64;
                let knot = (place as usize).min(knots - 2);
                let part = place - knot as f64;
                [(knot, 1.0 - part), (knot + 1, part)]
            }
        }
    }

    /// The mean of each function over the operating space.
    fn means(&self) -> Vec<f64> {
        match self {
            Self::Levels { shares, .. } => shares.clone(),
            Self::Uniform { knots, .. } => {
                let step = 1.0 / (knots - 1) as f64;
                (0..*knots).map(|knot| if knot == 0 || knot == knots - 1 { 0.5 * step } else { step }).collect()
            }
        }
    }
}

/// The reason why there is no adjusted rate.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum AdjustError {
    /// Columns of different lengths, a level without a share, or a value out of range.
    #[error("the parameters do not match the rows, the shares or the range from 0 to 1")]
    Mismatch,
    /// Too few rows of one outcome.
    #[error("the rarer outcome has {0} episodes. Expected at least {FEWEST}")]
    FewRows(usize),
    /// Too few rows for the model.
    #[error(
        "{rows} episodes are too few for {coefficients} coefficients. Expected at least {ROWS_PER_COEFFICIENT} for each"
    )]
    FewRowsForModel {
        /// Rows.
        rows: usize,
        /// Coefficients.
        coefficients: usize,
    },
    /// A part of a parameter's range without rows, or parameters that determine each other.
    #[error("a part of a parameter's range has no episode")]
    Empty,
}

/// A success rate over the operating space.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AdjustedRate {
    /// The estimate.
    pub rate: f64,
    /// Its standard error.
    pub se: f64,
    /// Its interval.
    pub interval: Interval,
    /// The number of independent episodes with the same variance.
    pub effective: f64,
}

/// The rate over the operating space with the known distributions of all parameters.
///
/// # Errors
/// Too few rows, or parameters that do not fit.
pub fn adjusted(controls: &[Control], outcomes: &[bool], confidence: Confidence) -> Result<AdjustedRate, AdjustError> {
    let n = outcomes.len();
    if !controls.iter().all(|control| control.rows() == n && control.is_valid()) {
        return Err(AdjustError::Mismatch);
    }
    let successes = outcomes.iter().filter(|y| **y).count();
    let rarer = successes.min(n - successes);
    if rarer < FEWEST {
        return Err(AdjustError::FewRows(rarer));
    }
    // The intercept, then all functions of each parameter but the last.
    let mut first = Vec::new();
    let mut q = 1;
    for of in controls {
        first.push(q);
        q += of.functions().saturating_sub(1);
    }
    if n < ROWS_PER_COEFFICIENT * q {
        return Err(AdjustError::FewRowsForModel { rows: n, coefficients: q });
    }
    let (gram, moments) = normal_equations(controls, &first, outcomes, q);
    let factor = Cholesky::new(&gram, q, PIVOT).map_err(|_| AdjustError::Empty)?;
    let mut beta = moments.clone();
    factor.solve(&mut beta);
    // The mean row of the operating space.
    let mut mean = vec![0.0; q];
    mean[0] = 1.0;
    for (of, first) in controls.iter().zip(&first) {
        let means = of.means();
        let kept = means.len().saturating_sub(1);
        mean[*first..first + kept].copy_from_slice(&means[..kept]);
    }
    let rate = dot(&mean, &beta).clamp(0.5 / n as f64, 1.0 - 0.5 / n as f64);
    // Outcomes are 0 and 1, so their sum of squares is the number of successes.
    let residual = (successes as f64 - dot(&beta, &moments)).max(0.0) / (n - q) as f64;
    factor.forward(&mut mean);
    let se = (residual * dot(&mean, &mean)).sqrt();
    let effective = rate * (1.0 - rate) / (se * se).max(f64::MIN_POSITIVE);
    Ok(AdjustedRate { rate, se, interval: wilson_at(rate, effective, confidence), effective })
}

/// X'X and X'y, from the few functions that are not 0 at each row.
fn normal_equations(controls: &[Control], first: &[usize], outcomes: &[bool], q: usize) -> (Vec<f64>, Vec<f64>) {
    let (mut gram, mut moments) = (vec![0.0; q * q], vec![0.0; q]);
    let mut row: Vec<(usize, f64)> = Vec::new();
    for (at, y) in outcomes.iter().enumerate() {
        row.clear();
        row.push((0, 1.0));
        for (of, first) in controls.iter().zip(first) {
            let kept = of.functions().saturating_sub(1);
            row.extend(of.at(at).into_iter().filter(|(k, x)| *k < kept && *x > 0.0).map(|(k, x)| (first + k, x)));
        }
        for (i, (a, x)) in row.iter().enumerate() {
            moments[*a] += if *y { *x } else { 0.0 };
            // Indices increase within a row.
            for (b, z) in &row[..=i] {
                gram[a * q + b] += x * z;
            }
        }
    }
    for i in 0..q {
        for j in 0..i {
            gram[j * q + i] = gram[i * q + j];
        }
    }
    (gram, moments)
}

/// Wilson's interval at a rate and a number of trials that need not be an integer.
fn wilson_at(p: f64, n: f64, confidence: Confidence) -> Interval {
    let z2 = confidence.z().powi(2);
    let centre = (p + z2 / (2.0 * n)) / (1.0 + z2 / n);
    let half = (z2 * (p * (1.0 - p) / n + z2 / (4.0 * n * n))).sqrt() / (1.0 + z2 / n);
    Interval { low: (centre - half).max(0.0), high: (centre + half).min(1.0) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::resample::{shuffle, uniform};
    use rand_chacha::ChaCha8Rng;
    use rand_core::SeedableRng;

    const PARAMETERS: usize = 5;
    const KNOTS: usize = 5;

    /// A point set: a Latin hypercube, or independent points.
    fn points(rng: &mut ChaCha8Rng, n: usize, latin: bool) -> Vec<Vec<f64>> {
        let column = |_| {
            if !latin {
                return (0..n).map(|_| uniform(rng)).collect();
            }
            let mut cells: Vec<usize> = (0..n).collect();
            shuffle(rng, &mut cells);
            cells.into_iter().map(|cell| (cell as f64 + uniform(rng)) / n as f64).collect()
        };
        (0..PARAMETERS).map(column).collect()
    }

    /// Coverage of the interval in percent, and the mean saving of episodes.
    fn simulated(latin: bool, n: usize, law: impl Fn(&[f64]) -> f64) -> (f64, f64) {
        let mut rng = ChaCha8Rng::seed_from_u64(7);
        let (mut truth, mut mean) = (0.0, vec![0.0; PARAMETERS]);
        for _ in 0..200_000 {
            mean.iter_mut().for_each(|x| *x = uniform(&mut rng));
            truth += law(&mean) / 200_000.0;
        }
        let (mut covered, mut effective) = (0, 0.0);
        let sets = 600;
        for _ in 0..sets {
            let points = points(&mut rng, n, latin);
            let row = |i: usize| points.iter().map(|c| c[i]).collect::<Vec<f64>>();
            let outcomes: Vec<bool> = (0..n).map(|i| uniform(&mut rng) < law(&row(i))).collect();
            let controls: Vec<Control> =
                points.iter().map(|c| Control::Uniform { at: c.clone(), knots: KNOTS }).collect();
            let found = adjusted(&controls, &outcomes, Confidence::P95).unwrap();
            covered += u32::from(found.interval.contains(truth));
            effective += found.effective / n as f64 / f64::from(sets);
        }
        (100.0 * f64::from(covered) / f64::from(sets), effective)
    }

    #[test]
    fn coverage_is_near_the_level() {
        let logistic = |x: f64| 1.0 / (1.0 + (-x).exp());
        // 600 sets: the standard deviation of a coverage is 0.9 %.
        for latin in [true, false] {
            for n in [400, 1_500] {
                let (none, saved) = simulated(latin, n, |_| 0.3);
                assert!((92.8..=97.5).contains(&none), "no effect, {n}, {latin}: {none} %");
                assert!((0.9..1.05).contains(&saved), "no effect: {saved}");
                let (weak, _) = simulated(latin, n, |x| logistic(1.0 + x[0] - x[1]));
                assert!((92.8..=97.5).contains(&weak), "weak, {n}, {latin}: {weak} %");
                let (strong, saved) = simulated(latin, n, |x| logistic(12.0 * x[0] - 8.0 * x[1]));
                assert!((92.8..=97.9).contains(&strong), "strong, {n}, {latin}: {strong} %");
                assert!(saved > 1.7, "strong: {saved}");
            }
        }
    }

    #[test]
    fn unusable_rows_are_rejected() {
        let levels = |of: Vec<u16>| Control::Levels { of, shares: vec![0.5, 0.5] };
        let of = |of: Vec<u16>, y: &[bool]| adjusted(&[levels(of)], y, Confidence::P95);
        assert_eq!(of(vec![0; 3], &[true; 2]), Err(AdjustError::Mismatch));
        assert_eq!(of(vec![2; 2], &[true; 2]), Err(AdjustError::Mismatch));
        assert_eq!(of(vec![0; 200], &[true; 200]), Err(AdjustError::FewRows(0)));
        let y: Vec<bool> = (0..200).map(|i| i % 2 == 0).collect();
        assert_eq!(of(vec![0; 200], &y), Err(AdjustError::Empty));
        for at in [vec![1.5; 200], vec![f64::NAN; 200]] {
            assert_eq!(adjusted(&[Control::Uniform { at, knots: 3 }], &y, Confidence::P95), Err(AdjustError::Mismatch));
        }
        let both = adjusted(&[levels((0..200).map(|i| i / 100).collect())], &y, Confidence::P95).unwrap();
        assert!((both.rate - 0.5).abs() < 1e-12);
    }
}
