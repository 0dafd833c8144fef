//! Scrambled Sobol sequences.

use std::sync::Arc;

use super::{balance::Shares, latin_hypercube::ranks, sobol_directions::DIRECTIONS};
use crate::copula::Copula;
use crate::{Design, DesignError, ParameterSpace, Sampler, Stream};

/// Most points of one design.
const MOST_POINTS: usize = 1 << 31;

/// Most parameters: the first dimension needs no table.
const MOST_PARAMETERS: usize = DIRECTIONS.len() + 1;

/// The first n points of a scrambled Sobol sequence.
///
/// Sobol's sequence fills the unit cube evenly. With n = 2^m points, each of the n equal strata of each parameter holds
/// exactly one, and so does each of many boxes over several parameters ((t, m, s)-nets; Sobol 1967). Direction numbers
/// are those of Joe and Kuo (2008, SIAM J. Sci. Comput. 30(5), `new-joe-kuo-6`). Points are in the Gray-code order of
/// Antonov and Saleev (1979), including the first point (Owen 2022, "On dropping the first Sobol' point").
///
/// Each coordinate is scrambled by nested uniform digit permutations (Owen 1995): digit i is flipped by a random bit
/// that depends on the preceding digits. The bits come from a hash keyed by the stream instead of a stored tree. The
/// first 32 digits are Sobol's and the other 21 are random, which equals full scrambling for up to 2^32 points. Every
/// single point is uniform, and the net property is kept. A mean over the points is unbiased, with a variance of o(1/n)
/// for square-integrable functions (Owen 1997).
///
/// Integers and categories take their levels by the rank of their scrambled coordinate: each occurs floor(n/k) or
/// ceil(n/k) times for any n. If k divides n = 2^m, these are the levels of the sequence itself; otherwise a few points
/// move to the neighbouring level. If n is not a power of two, the continuous parameters are still evenly spread, but
/// strata can hold zero or several points.
///
/// Correlated parameters use a Gaussian copula with the conditional (Rosenblatt) transformation of the points. Means
/// stay unbiased and each parameter stays uniform, but among correlated parameters only the first still has one point
/// per stratum.
///
/// The points are dependent, and a binomial interval computed from them is not exact. The limits are 2^31 points and 64
/// parameters.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Sobol;

impl Sampler for Sobol {
    fn name(&self) -> &'static str {
        "sobol"
    }

    fn design(&self, space: &Arc<ParameterSpace>, n: usize, mut stream: Stream) -> Result<Design, DesignError> {
        let d = space.len();
        self.check(n, d)?;
        let mut unit = scrambled(n, d, &mut stream);
        if let Some(copula) = Copula::of(space)? {
            unit.chunks_exact_mut(d).for_each(|point| copula.join(point));
        }
        for (column, parameter) in space.parameters().iter().enumerate() {
            if let Some(shares) = Shares::of(&parameter.domain, n, &mut stream) {
                let numbers: Vec<f64> = unit.iter().skip(column).step_by(d).copied().collect();
                for (row, rank) in unit.chunks_exact_mut(d).zip(ranks(&numbers)) {
                    row[column] = shares.unit(rank as usize);
                }
            }
        }
        Ok(Design::from_unit(Arc::clone(space), unit))
    }
}

impl Sobol {
    fn check(&self, n: usize, d: usize) -> Result<(), DesignError> {
        let limit = |what, limit, asked| Err(DesignError::Limit { sampler: self.name(), what, limit, asked });
        match (n, d) {
            (0, _) => Err(DesignError::Empty),
            (n, _) if n > MOST_POINTS => limit("points", MOST_POINTS, n),
            (_, d) if d > MOST_PARAMETERS => limit("parameters", MOST_PARAMETERS, d),
            _ => Ok(()),
        }
    }
}

/// The first `n` scrambled points in `d` dimensions, row by row, as multiples of 2^-53.
fn scrambled(n: usize, d: usize, stream: &mut Stream) -> Vec<f64> {
    const SCALE: f64 = 1.0 / (1_u64 << 53) as f64;
    let keys: Vec<u64> = (0..d).map(|_| stream.bits()).collect();
    let mut unit = Vec::with_capacity(n * d);
    for_each_point(n, d, |point| {
        unit.extend(point.iter().zip(&keys).map(|(x, key)| scramble(*x, *key) as f64 * SCALE));
    });
    unit
}

/// Calls `show` with each of the first `n` points of the sequence, as 32-bit fractions.
fn for_each_point(n: usize, d: usize, mut show: impl FnMut(&[u32])) {
    let directions: Vec<[u32; 32]> = (0..d).map(direction_numbers).collect();
    let mut point = vec![0; d];
    for i in 0..n {
        show(&point);
        // The Gray codes of i and i + 1 differ in the digit of i's lowest zero.
        let digit = (i.trailing_ones() as usize).min(31);
        point.iter_mut().zip(&directions).for_each(|(x, v)| *x ^= v[digit]);
    }
}

/// The direction numbers v_1..v_32 of a dimension (from 0), as 32-bit fractions.
fn direction_numbers(dimension: usize) -> [u32; 32] {
    // The first dimension is the van der Corput sequence: m_i = 1 for all i.
    let Some(&(degree, coefficients, initial)) = dimension.checked_sub(1).and_then(|i| DIRECTIONS.get(i)) else {
        return std::array::from_fn(|i| 1 << (31 - i));
    };
    let mut v = [0_u32; 32];
    for i in 0..32 {
        v[i] = if i < degree {
            initial[i] << (31 - i)
        } else {
            // Joe and Kuo (2008), equation 2, with a_1 the highest of the s - 1 inner coefficients.
            (1..degree)
                .filter(|k| coefficients >> (degree - 1 - k) & 1 == 1)
                .fold(v[i - degree] ^ (v[i - degree] >> degree), |value, k| value ^ v[i - k])
        };
    }
    v
}

/// Owen's scrambling of one coordinate. The result has 53 digits; the first 32 are the permuted digits of `x`.
fn scramble(x: u32, key: u64) -> u64 {
    // A node of the digit tree is the preceding digits with a leading 1, which distinguishes 0 from 00.
    let node = |digits: u32| (1_u64 << digits) | (u64::from(x) >> (32 - digits));
    let flips = (0..32).fold(0_u32, |flips, digit| flips << 1 | (hash(key, node(digit)) >> 63) as u32);
    u64::from(x ^ flips) << 21 | hash(key, node(32)) >> 43
}

/// Random bits of a node: SplitMix64 (Steele, Lea and Flood 2014) from `key`, at step `node`.
fn hash(key: u64, node: u64) -> u64 {
    let mut z = key.wrapping_add(node.wrapping_mul(0x9e37_79b9_7f4a_7c15));
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Seed;

    #[derive(serde::Deserialize)]
    struct Reference {
        near_bits: u32,
        near: Vec<Vec<u32>>,
        far_index: usize,
        far_bits: u32,
        far: Vec<Vec<u32>>,
        centred_discrepancy_of_first_50_points_in_5_dimensions: f64,
    }

    fn reference() -> Reference {
        serde_json::from_str(include_str!("../../tests/reference/sobol.json")).unwrap()
    }

    fn stream(seed: u64) -> Stream {
        Seed::campaign(seed).stream("design")
    }

    fn unscrambled(n: usize, d: usize) -> Vec<f64> {
        let mut unit = Vec::new();
        for_each_point(n, d, |point| unit.extend(point.iter().map(|x| f64::from(*x) / 2_f64.powi(32))));
        unit
    }

    /// The squared centred L2 discrepancy (Hickernell 1998, Mathematics of Computation 67(221), equation 5.1c).
    fn centred_discrepancy(unit: &[f64], d: usize) -> f64 {
        let n = (unit.len() / d) as f64;
        let off = |x: f64| (x - 0.5).abs();
        let single: f64 = unit
            .chunks_exact(d)
            .map(|x| x.iter().map(|x| 1.0 + 0.5 * off(*x) - 0.5 * off(*x) * off(*x)).product::<f64>())
            .sum();
        let pair = |x: &[f64], y: &[f64]| -> f64 {
            x.iter().zip(y).map(|(x, y)| 1.0 + 0.5 * (off(*x) + off(*y) - (x - y).abs())).product()
        };
        let double: f64 = unit.chunks_exact(d).flat_map(|x| unit.chunks_exact(d).map(move |y| pair(x, y))).sum();
        (13.0_f64 / 12.0).powi(d as i32) - 2.0 / n * single + double / (n * n)
    }

    #[test]
    fn unscrambled_points_match_scipy() {
        let Reference { near_bits, near, far_index, far_bits, far, .. } = reference();
        let mut i = 0;
        for_each_point(far_index + far.len(), MOST_PARAMETERS, |point| {
            let (bits, expected) = match i {
                i if i < near.len() => (near_bits, &near[i]),
                i if i >= far_index => (far_bits, &far[i - far_index]),
                _ => {
                    i += 1;
                    return;
                }
            };
            let shown: Vec<u32> = point.iter().map(|x| x >> (32 - bits)).collect();
            assert_eq!(&shown, expected, "point {i}");
            assert!(point.iter().all(|x| x << bits == 0), "point {i}");
            i += 1;
        });
        assert_eq!(near.len(), 64);
        assert_eq!(near[0].len(), MOST_PARAMETERS);
    }

    #[test]
    fn direction_numbers_are_valid() {
        for (degree, coefficients, initial) in DIRECTIONS {
            assert_eq!(initial.len(), degree);
            assert!(coefficients < 1 << (degree - 1));
            assert!(initial.iter().enumerate().all(|(i, m)| m % 2 == 1 && *m < 2 << i));
        }
    }

    #[test]
    fn discrepancy_matches_scipy() {
        let expected = reference().centred_discrepancy_of_first_50_points_in_5_dimensions;
        let got = centred_discrepancy(&unscrambled(50, 5), 5);
        assert!((got - expected).abs() < 1e-13, "{got} {expected}");
    }

    #[test]
    fn scrambling_beats_independent_points() {
        for (n, d) in [(64, 3), (256, 5), (250, 5), (512, 8)] {
            for seed in 0..10 {
                let sobol = centred_discrepancy(&scrambled(n, d, &mut stream(seed)), d);
                let mut stream = stream(seed);
                let uniform: Vec<f64> = (0..n * d).map(|_| stream.uniform()).collect();
                let uniform = centred_discrepancy(&uniform, d);
                assert!(sobol < 0.5 * uniform, "n {n} d {d} seed {seed}: {sobol} {uniform}");
            }
        }
    }

    #[test]
    fn power_of_two_fills_each_stratum() {
        for m in [0, 1, 3, 8, 12] {
            let n = 1 << m;
            let unit = scrambled(n, MOST_PARAMETERS, &mut stream(m));
            for column in 0..MOST_PARAMETERS {
                let numbers = unit.iter().skip(column).step_by(MOST_PARAMETERS);
                let mut strata: Vec<_> = numbers.map(|u| (u * n as f64) as usize).collect();
                strata.sort_unstable();
                assert!(strata.into_iter().eq(0..n), "n {n} column {column}");
            }
        }
    }

    #[test]
    fn elementary_boxes_have_one_point() {
        // A (0, m, 2)-net: 2^m boxes of any shape 2^-a x 2^-(m-a).
        let m = 10;
        let unit = scrambled(1 << m, 2, &mut stream(1));
        for a in 0..=m {
            let mut seen = vec![false; 1 << m];
            for point in unit.chunks_exact(2) {
                let cell = |u: f64, bits: i32| (u * 2_f64.powi(bits)) as usize;
                let here = cell(point[0], a) << (m - a) | cell(point[1], m - a);
                assert!(!std::mem::replace(&mut seen[here], true), "two points in box {here} of shape {a}");
            }
        }
    }

    #[test]
    fn each_orthant_has_one_point() {
        // Sobol's property A, which Joe and Kuo's numbers have and scrambling preserves.
        let d = 12;
        let unit = scrambled(1 << d, d, &mut stream(2));
        let orthant = |point: &[f64]| point.iter().fold(0, |cell, u| cell << 1 | usize::from(*u >= 0.5));
        let mut orthants: Vec<_> = unit.chunks_exact(d).map(orthant).collect();
        orthants.sort_unstable();
        assert!(orthants.into_iter().eq(0..1 << d));
    }

    #[test]
    fn single_scrambled_point_is_uniform() {
        // The first point is 0 before scrambling. Over 40,000 streams, mean and variance of its coordinates are within
        // five standard errors, sqrt(1/12 / N) and sqrt(1/180 / N).
        let numbers: Vec<f64> = (0..20_000).flat_map(|seed| scrambled(1, 2, &mut stream(seed))).collect();
        let n = numbers.len() as f64;
        let mean = numbers.iter().sum::<f64>() / n;
        let variance = numbers.iter().map(|u| (u - 0.5).powi(2)).sum::<f64>() / n;
        assert!((mean - 0.5).abs() < 5.0 * (1.0 / 12.0 / n).sqrt(), "{mean}");
        assert!((variance - 1.0 / 12.0).abs() < 5.0 * (1.0 / 180.0 / n).sqrt(), "{variance}");
    }

    #[test]
    fn scrambling_is_nested() {
        // Two coordinates that agree in their first i digits still agree in exactly i digits after scrambling.
        let mut draws = stream(3);
        for _ in 0..1_000 {
            let x = draws.bits() as u32;
            let digits = draws.below(32) as u32;
            let y = x ^ (1 << (31 - digits)) ^ (draws.bits() as u32).checked_shr(digits + 1).unwrap_or(0);
            let agree = (scramble(x, 17) ^ scramble(y, 17)).leading_zeros() - 11;
            assert_eq!(agree, digits, "{x:032b} {y:032b}");
        }
    }
}
