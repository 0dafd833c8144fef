//! Latin hypercubes.

use std::sync::Arc;

use robogate_maths::dense::Cholesky;

use super::{balance::Shares, iman_conover::correlate, maximin::spread};
use crate::copula::{Copula, SMALLEST_PIVOT};
use crate::{Design, DesignError, ParameterSpace, Sampler, Stream};

/// Most points of one design: up to here a point's distance from the edge of its stratum exceeds every
/// rounding error of u = (s + j)/n and of s = floor(n u).
const MOST_POINTS: usize = 1 << 26;

/// Where in its stratum a point may stand: in the middle of one of 2^24 equal parts, hence never
/// within 2^-25 of a stratum's width from its edge.
const PARTS: u64 = 1 << 24;

/// A Latin hypercube whose points keep their distance.
///
/// Each continuous parameter's range, in its own scale, is cut into n equal strata, and exactly one
/// point stands in each: u = (s + j)/n with s a random permutation of 0..n and j uniform in (0, 1)
/// (McKay, Beckman and Conover 1979, Technometrics 21(2)). Each level of an integer or categorical
/// parameter goes to floor(n/k) or ceil(n/k) of the points, in a random order that depends on nothing else.
///
/// Over the continuous parameters the columns are first decorrelated (Iman and Conover 1982,
/// Communications in Statistics B11(3), with the identity as the target), then coordinates are
/// exchanged between points so that the smallest distance between any two grows (maximin;
/// Johnson, Moore and Ylvisaker 1990, J. Stat. Plan. Inference 26(2); Morris and Mitchell 1995,
/// ibid. 43(3)). Distance is Euclidean in the unit cube, over continuous parameters only. Both steps keep
/// every stratum. The improvement is local: the best design there is, is not promised.
///
/// Where parameters are correlated, the columns are reordered by the method of Iman and Conover with normal scores, so that
/// their rank correlations come near to those asked for; every stratum still holds exactly one point. Points are then not
/// moved apart.
///
/// Points are dependent, and a binomial interval taken from them is not exact. For a hypercube as drawn
/// the mean has at most n/(n-1) times the variance of independent draws (Owen 1997, SIAM J. Numer.
/// Anal. 34(5)); no such bound is known once points were moved apart. They are not a sequence: the first
/// m of n points are no hypercube.
/// Up to 2^26 points, any number of parameters.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct LatinHypercube {
    /// How much work may go into moving points apart, counted in looks at a point or at a cell of the
    /// neighbour index: never in time, so that a slow machine draws the same design. At 0 the
    /// hypercube is only decorrelated.
    pub budget: u64,
}

impl Default for LatinHypercube {
    /// Thirty million looks, which is under a second of work. At 10,000 points in five dimensions the
    /// smallest distance becomes about seven times what chance leaves; beyond 300,000 points, or
    /// 5,000 in twenty dimensions, it is too little for one round and changes nothing.
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
    /// The design in the unit cube, row by row.
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
        // Points that are moved apart lose what correlation they have.
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

/// Which of `n` equal parts of [0, 1) holds `u`.
pub(super) fn stratum(u: f64, n: usize) -> usize {
    ((u * n as f64) as usize).min(n - 1)
}

fn permutation(n: usize, stream: &mut Stream) -> Vec<u32> {
    let mut order: Vec<u32> = (0..n as u32).collect();
    stream.shuffle(&mut order);
    order
}

/// Reorders the columns, each a permutation, so that their linear correlations come near to 0.
///
/// With C = L L' their correlation matrix, the rows of X L'^-1 are uncorrelated; each column takes the ranks of
/// its own in that. Repeated while the largest |correlation| falls. Where C has no such factor (as many
/// columns as points) nothing is done.
fn decorrelate(columns: &mut Vec<Vec<u32>>) {
    const ROUNDS: usize = 4;
    let d = columns.len();
    let Some(n) = columns.first().map(Vec::len).filter(|n| *n > 1) else { return };
    let mut correlations = correlations(columns);
    for _ in 0..ROUNDS {
        let Ok(factor) = Cholesky::new(&correlations, d, SMALLEST_PIVOT) else { return };
        let factor = factor.lower();
        let mean = (n as f64 - 1.0) / 2.0;
        // Solved column by column, in place: y_j = (x_j - sum over k < j of L_jk y_k) / L_jj.
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

/// The rank of each number, from 0; equal ones in the order in which they stand.
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
    fn each_stratum_of_the_unit_interval_holds_exactly_one_point() {
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
    fn no_rounding_moves_an_edge_of_a_stratum_into_the_next_one() {
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
    fn decorrelation_leaves_columns_with_almost_no_correlation() {
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
    fn columns_that_cannot_be_decorrelated_stay_as_they_are() {
        for (n, d) in [(1, 3), (2, 2), (3, 5)] {
            let mut stream = Seed::campaign(1).stream("columns");
            let mut columns: Vec<_> = (0..d).map(|_| permutation(n, &mut stream)).collect();
            let before = columns.clone();
            decorrelate(&mut columns);
            assert_eq!(columns, before);
        }
    }
}
