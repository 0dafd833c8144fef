//! Latin hypercube sampling.

use std::sync::Arc;

use robogate_maths::dense::Cholesky;

use super::{balance::Shares, iman_conover::correlate, maximin::spread};
use crate::copula::{Copula, SMALLEST_PIVOT};
use crate::{Design, DesignError, ParameterSpace, Sampler, Stream};

/// Most points of one design. Up to this number, a point's distance from the edge of its stratum exceeds the rounding
/// errors of u = (s + j)/n and of s = floor(n u).
const MOST_POINTS: usize = 1 << 26;

/// Number of equal parts of a stratum. A point is placed in the middle of a part, hence never within 2^-25 of a
/// stratum's width from its edge.
const PARTS: u64 = 1 << 24;

/// Latin hypercube sampling with decorrelation and maximin improvement.
///
/// Each continuous parameter's range, in its scale, is cut into n equal strata with exactly one point in each: u = (s +
/// j)/n with s a random permutation of 0..n and j uniform in (0, 1) (McKay, Beckman and Conover 1979, Technometrics
/// 21(2)). Each level of an integer or categorical parameter goes to floor(n/k) or ceil(n/k) of the points, in a random
/// order that is independent of the other parameters.
///
/// The columns of the continuous parameters are first decorrelated (Iman and Conover 1982, Communications in Statistics
/// B11(3), with the identity as the target). Then points exchange coordinates to increase the smallest distance between
/// any two (maximin; Johnson, Moore and Ylvisaker 1990, J. Stat. Plan. Inference 26(2); Morris and Mitchell 1995, ibid.
/// 43(3)). Distance is Euclidean in the unit cube, over continuous parameters only. Both steps keep every stratum. The
/// improvement is a local search and may miss the global optimum.
///
/// If parameters are correlated, the columns are reordered by the method of Iman and Conover with normal scores, which
/// approximates the requested rank correlations. Every stratum still holds exactly one point. The maximin step is then
/// skipped.
///
/// The points are dependent, and a binomial interval computed from them is not exact. Without the maximin step the mean
/// has at most n/(n-1) times the variance of independent draws (Owen 1997, SIAM J. Numer. Anal. 34(5)). No such bound
/// is known with it. The points are not a sequence: the first m of n points are not a hypercube. The limit is 2^26
/// points; the number of parameters is unlimited.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct LatinHypercube {
    /// The work limit of the maximin step, in visits of a point or of a cell of the neighbour index. It is independent
    /// of time, which makes the design the same on a slow machine. With 0, the hypercube is only decorrelated.
    pub budget: u64,
}

impl Default for LatinHypercube {
    /// Thirty million visits, less than one second of work. At 10,000 points in five dimensions the smallest distance
    /// becomes about seven times that of a random hypercube. Beyond 300,000 points, or 5,000 in twenty dimensions, the
    /// budget is too small for one round and has no effect.
    fn default() -> Self {
        Self { budget: 30_000_000 }
    }
}

impl Sampler for LatinHypercube {
    fn name(&self) -> &'static str {
        "latin_hypercube"
    }

    fn design(&self, space: &Arc<ParameterSpace>, n: usize, stream: Stream) -> Result<Design, DesignError> {
        Ok(Design::from_unit(Arc::clone(space), self.unit(space, n, stream)?))
    }
}

impl LatinHypercube {
    /// Draws the design in the unit cube, row by row.
    fn unit(&self, space: &ParameterSpace, n: usize, mut stream: Stream) -> Result<Vec<f64>, DesignError> {
        if n == 0 {
            return Err(DesignError::Empty);
        }
        if n > MOST_POINTS {
            return Err(DesignError::Limit { sampler: self.name(), what: "points", limit: MOST_POINTS, asked: n });
        }
        let d = space.len();
        let mut unit = vec![0.0; n * d];
        let mut continuous = Vec::new();
        for (column, parameter) in space.parameters().iter().enumerate() {
            match Shares::of(&parameter.domain, n, &mut stream) {
                None => continuous.push(column),
                Some(shares) => {
                    for (row, rank) in unit.chunks_exact_mut(d).zip(permutation(n, &mut stream)) {
                        row[column] = shares.unit(rank as usize);
                    }
                }
            }
        }
        let mut strata: Vec<_> = continuous.iter().map(|_| permutation(n, &mut stream)).collect();
        decorrelate(&mut strata);
        let copula = Copula::of(space)?;
        if let Some(copula) = &copula {
            correlate(&mut strata, &copula.target(&continuous));
        }
        let mut cloud = vec![0.0; n * continuous.len()];
        for (i, u) in cloud.iter_mut().enumerate() {
            let (row, column) = (i / continuous.len(), i % continuous.len());
            let part = stream.bits() % PARTS;
            let jitter = (part as f64 + 0.5) / PARTS as f64;
            *u = (f64::from(strata[column][row]) + jitter) / n as f64;
        }
        // The maximin step removes correlation, which is unwanted for correlated parameters.
        if copula.is_none() {
            spread(&mut cloud, continuous.len(), self.budget, &mut stream);
        }
        if !continuous.is_empty() {
            for (row, point) in unit.chunks_exact_mut(d).zip(cloud.chunks_exact(continuous.len())) {
                for (column, u) in continuous.iter().zip(point) {
                    row[*column] = *u;
                }
            }
        }
        Ok(unit)
    }
}

/// The index of the stratum of `u` among `n` equal parts of [0, 1).
pub(super) fn stratum(u: f64, n: usize) -> usize {
    ((u * n as f64) as usize).min(n - 1)
}

fn permutation(n: usize, stream: &mut Stream) -> Vec<u32> {
    let mut order: Vec<u32> = (0..n as u32).collect();
    stream.shuffle(&mut order);
    order
}

/// Reorders the columns, each a permutation, to bring their linear correlations near 0.
///
/// With C = L L' their correlation matrix, the rows of X L'^-1 are uncorrelated; each column is reordered to the ranks
/// of its column in that matrix. This repeats while the largest |correlation| decreases. If C has no such factor (as
/// many columns as points), the columns do not change.
fn decorrelate(columns: &mut Vec<Vec<u32>>) {
    const ROUNDS: usize = 4;
    let d = columns.len();
    let Some(n) = columns.first().map(Vec::len).filter(|n| *n > 1) else { return };
    let mut correlations = correlations(columns);
    for _ in 0..ROUNDS {
        let Ok(factor) = Cholesky::new(&correlations, d, SMALLEST_PIVOT) else { return };
        let factor = factor.lower();
        let mean = (n as f64 - 1.0) / 2.0;
        // Forward substitution by columns, in place: y_j = (x_j - sum over k < j of L_jk y_k) / L_jj.
        let mut solved: Vec<Vec<f64>> = Vec::with_capacity(d);
        for (j, column) in columns.iter().enumerate() {
            let mut y: Vec<f64> = column.iter().map(|s| f64::from(*s) - mean).collect();
            for (k, earlier) in solved.iter().enumerate() {
                let l = factor[j * d + k];
                y.iter_mut().zip(earlier).for_each(|(y, e)| *y -= l * e);
            }
            y.iter_mut().for_each(|y| *y /= factor[j * d + j]);
            solved.push(y);
        }
        let candidate: Vec<_> = solved.iter().map(|y| ranks(y)).collect();
        let after = self::correlations(&candidate);
        if largest_off_diagonal(&after, d) >= largest_off_diagonal(&correlations, d) {
            return;
        }
        *columns = candidate;
        correlations = after;
    }
}

/// The linear correlations of columns that are permutations of 0..n, row by row.
fn correlations(columns: &[Vec<u32>]) -> Vec<f64> {
    let n = columns.first().map_or(0, Vec::len) as f64;
    let mean = (n - 1.0) / 2.0;
    // The sum of squared deviations of 0..n.
    let spread = n * (n * n - 1.0) / 12.0;
    let covariance = |a: &[u32], b: &[u32]| -> f64 {
        a.iter().zip(b).map(|(a, b)| (f64::from(*a) - mean) * (f64::from(*b) - mean)).sum()
    };
    columns.iter().flat_map(|a| columns.iter().map(move |b| covariance(a, b) / spread)).collect()
}

fn largest_off_diagonal(matrix: &[f64], d: usize) -> f64 {
    (0..d).flat_map(|i| (0..i).map(move |j| matrix[i * d + j].abs())).fold(0.0, f64::max)
}

/// The rank of each number, from 0. Equal numbers keep their order.
pub(super) fn ranks(numbers: &[f64]) -> Vec<u32> {
    let mut order: Vec<u32> = (0..numbers.len() as u32).collect();
    order.sort_by(|a, b| numbers[*a as usize].total_cmp(&numbers[*b as usize]));
    let mut ranks = vec![0; numbers.len()];
    for (rank, i) in order.into_iter().enumerate() {
        ranks[i as usize] = rank as u32;
    }
    ranks
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Domain, Parameter, Scale, Seed};

    fn cube(d: usize) -> ParameterSpace {
        let domain = Domain::Continuous { low: 0.0, high: 1.0, scale: Scale::Linear };
        let parameters = (0..d).map(|i| Parameter { name: format!("x{i}").into(), domain: domain.clone() }).collect();
        ParameterSpace::new("cube", parameters).unwrap()
    }

    #[test]
    fn each_stratum_has_one_point() {
        for (n, d) in [(1, 1), (2, 1), (3, 2), (7, 5), (100, 5), (1_000, 3), (10_000, 5), (100_000, 1)] {
            let unit = LatinHypercube { budget: 1_000_000 }.unit(&cube(d), n, Seed::campaign(5).stream("s")).unwrap();
            for column in 0..d {
                let mut strata: Vec<_> = unit.iter().skip(column).step_by(d).map(|u| (u * n as f64) as usize).collect();
                strata.sort_unstable();
                assert!(strata.into_iter().eq(0..n), "n {n} d {d} column {column}");
            }
        }
    }

    #[test]
    fn rounding_keeps_points_in_stratum() {
        for n in [1, 3, 7, 49, 9_999, 10_000, 1_000_003, MOST_POINTS - 1, MOST_POINTS] {
            for s in [0, n / 5, n / 3, n / 2, n.saturating_sub(2), n - 1] {
                for part in [0, PARTS - 1] {
                    let u = (s as f64 + (part as f64 + 0.5) / PARTS as f64) / n as f64;
                    assert_eq!((u * n as f64) as usize, s, "n {n} s {s}");
                    assert!(u < 1.0);
                }
            }
        }
    }

    #[test]
    fn decorrelation_removes_correlation() {
        for n in [20, 100, 1_000] {
            let mut stream = Seed::campaign(n as u64).stream("columns");
            let mut columns: Vec<_> = (0..5).map(|_| permutation(n, &mut stream)).collect();
            let before = largest_off_diagonal(&correlations(&columns), 5);
            decorrelate(&mut columns);
            let after = largest_off_diagonal(&correlations(&columns), 5);
            assert!(after < before / 5.0 && after < 2.0 / n as f64, "n {n}: {before} -> {after}");
            for mut column in columns {
                column.sort_unstable();
                assert!(column.into_iter().eq(0..n as u32));
            }
        }
    }

    #[test]
    fn singular_columns_stay_unchanged() {
        for (n, d) in [(1, 3), (2, 2), (3, 5)] {
            let mut stream = Seed::campaign(1).stream("columns");
            let mut columns: Vec<_> = (0..d).map(|_| permutation(n, &mut stream)).collect();
            let before = columns.clone();
            decorrelate(&mut columns);
            assert_eq!(columns, before);
        }
    }
}
