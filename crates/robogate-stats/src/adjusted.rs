//! A success rate with less variance: known distributions of the parameters as a control variate.
//!
//! The points of a campaign are sampled from known distributions, so the share of the operating space in each bin of a
//! parameter is known. A linear model of the outcome on the bins of all parameters, y = β0 + Σ β(bin) + e, gives the rate
//! over the operating space, Σ share · β. Its variance is only that of e: the part of the outcome that single parameters
//! do not explain. For independent points this is a regression estimator (post-stratification on all margins). The points
//! of a Latin hypercube have the known shares already, so the estimate stays the observed rate, and the smaller variance is
//! the true one: a Latin hypercube removes the variance of all additive parts.
//!
//! The interval is Wilson's at the number of independent episodes with the same variance, n' = p (1 - p) / variance.
//!
//! Limits: bins must be fixed before the outcomes are seen, and every bin needs rows. The model needs enough rows of the
//! rarer outcome. The tests simulate the coverage. Sources: Cochran (1977), Sampling Techniques, chapter 7; Stein
//! (1987), Technometrics 29(2), and Owen (1992), JRSS B 54(2), for Latin hypercubes.

use robogate_maths::dense::{Cholesky, dot};

use crate::{Confidence, Interval};

/// Smallest pivot, as a fraction of its diagonal.
const PIVOT: f64 = 1e-9;
/// Fewest rows of the rarer outcome.
pub const FEWEST: usize = 50;
/// Fewest rows for each coefficient.
pub const ROWS_PER_COEFFICIENT: usize = 8;

/// One parameter, divided into bins.
#[derive(Debug, Clone)]
pub struct Strata {
    /// The bin of each row.
    pub bins: Vec<u16>,
    /// The share of the operating space in each bin. They add up to 1.
    pub shares: Vec<f64>,
}

/// The reason why there is no adjusted rate.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum AdjustError {
    /// Columns of different lengths, or a bin without a share.
    #[error("the bins do not match the rows or the shares")]
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
    /// A bin without rows, or bins that determine each other.
    #[error("a bin of a parameter has no episode")]
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

/// The rate over the operating space with the known shares of all bins.
///
/// # Errors
/// Too few rows, or bins that do not fit.
pub fn adjusted(strata: &[Strata], outcomes: &[bool], confidence: Confidence) -> Result<AdjustedRate, AdjustError> {
    let n = outcomes.len();
    let fits = |s: &Strata| s.bins.len() == n && s.bins.iter().all(|bin| usize::from(*bin) < s.shares.len());
    if !strata.iter().all(fits) {
        return Err(AdjustError::Mismatch);
    }
    let successes = outcomes.iter().filter(|y| **y).count();
    let rarer = successes.min(n - successes);
    if rarer < FEWEST {
        return Err(AdjustError::FewRows(rarer));
    }
    // The intercept, then all bins of each parameter but the last.
    let mut first = Vec::new();
    let mut q = 1;
    for of in strata {
        first.push(q);
        q += of.shares.len().saturating_sub(1);
    }
    if n < ROWS_PER_COEFFICIENT * q {
        return Err(AdjustError::FewRowsForModel { rows: n, coefficients: q });
    }
    let (gram, moments) = normal_equations(strata, &first, outcomes, q);
    let factor = Cholesky::new(&gram, q, PIVOT).map_err(|_| AdjustError::Empty)?;
    let mut beta = moments.clone();
    factor.solve(&mut beta);
    // The mean row of the operating space.
    let mut mean = vec![0.0; q];
    mean[0] = 1.0;
    for (of, first) in strata.iter().zip(&first) {
        for (bin, share) in of.shares.iter().take(of.shares.len().saturating_sub(1)).enumerate() {
            mean[first + bin] = *share;
        }
    }
    let rate = dot(&mean, &beta).clamp(0.5 / n as f64, 1.0 - 0.5 / n as f64);
    // Outcomes are 0 and 1, so their sum of squares is the number of successes.
    let residual = (successes as f64 - dot(&beta, &moments)).max(0.0) / (n - q) as f64;
    factor.forward(&mut mean);
    let se = (residual * dot(&mean, &mean)).sqrt();
    let effective = rate * (1.0 - rate) / (se * se).max(f64::MIN_POSITIVE);
    Ok(AdjustedRate { rate, se, interval: wilson_at(rate, effective, confidence), effective })
}

/// X'X and X'y, from the counts of all pairs of bins.
fn normal_equations(strata: &[Strata], first: &[usize], outcomes: &[bool], q: usize) -> (Vec<f64>, Vec<f64>) {
    let (mut gram, mut moments) = (vec![0.0; q * q], vec![0.0; q]);
    gram[0] = outcomes.len() as f64;
    moments[0] = outcomes.iter().filter(|y| **y).count() as f64;
    for (i, a) in strata.iter().enumerate() {
        let kept = a.shares.len().saturating_sub(1);
        for (bin, y) in a.bins.iter().zip(outcomes) {
            let bin = usize::from(*bin);
            if bin < kept {
                let at = first[i] + bin;
                gram[at * q] += 1.0;
                gram[at * q + at] += 1.0;
                moments[at] += f64::from(u8::from(*y));
            }
        }
        for (j, b) in strata.iter().enumerate().take(i) {
            let (wide, other) = (b.shares.len(), b.shares.len().saturating_sub(1));
            let mut counts = vec![0_u32; a.shares.len() * wide];
            for (x, y) in a.bins.iter().zip(&b.bins) {
                counts[usize::from(*x) * wide + usize::from(*y)] += 1;
            }
            for x in 0..kept {
                for y in 0..other {
                    gram[(first[i] + x) * q + first[j] + y] = f64::from(counts[x * wide + y]);
                }
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
    const BINS: u16 = 5;

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
            let strata: Vec<Strata> = points
                .iter()
                .map(|c| Strata {
                    bins: c.iter().map(|x| (x * f64::from(BINS)) as u16).collect(),
                    shares: vec![1.0 / f64::from(BINS); usize::from(BINS)],
                })
                .collect();
            let found = adjusted(&strata, &outcomes, Confidence::P95).unwrap();
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
        let strata = |bins: Vec<u16>| Strata { bins, shares: vec![0.5, 0.5] };
        let of = |bins: Vec<u16>, y: &[bool]| adjusted(&[strata(bins)], y, Confidence::P95);
        assert_eq!(of(vec![0; 3], &[true; 2]), Err(AdjustError::Mismatch));
        assert_eq!(of(vec![2; 2], &[true; 2]), Err(AdjustError::Mismatch));
        assert_eq!(of(vec![0; 200], &[true; 200]), Err(AdjustError::FewRows(0)));
        let y: Vec<bool> = (0..200).map(|i| i % 2 == 0).collect();
        assert_eq!(of(vec![0; 200], &y), Err(AdjustError::Empty));
        let both = adjusted(&[strata((0..200).map(|i| i / 100).collect())], &y, Confidence::P95).unwrap();
        assert!((both.rate - 0.5).abs() < 1e-12);
    }
}
