//! Correlated Latin hypercube sampling (Iman and Conover 1982).

use robogate_maths::dense::Cholesky;
use robogate_maths::normal::quantile;

use super::latin_hypercube::ranks;
use crate::copula::SMALLEST_PIVOT;

/// Reorders the columns to approximate the rank correlations of a Gaussian copula. Each column is a permutation of
/// 0..n. `target` holds the correlations of the copula: a positive definite matrix, row by row.
///
/// Let M be the scores Φ⁻¹((rank + 1)/(n + 1)), E = F F' their correlations and target = L L'. The rows of M F'^-1 L'
/// have exactly the target correlations. Each column is reordered to the ranks of its column in that matrix (Iman and
/// Conover 1982, Communications in Statistics B11(3)). The ranks then have the correlations approximately. The
/// remaining difference is added to the target of another pass, as long as this reduces it. If E has no factor (as many
/// columns as points), F = 1, and the correlations vary randomly about the target.
pub(super) fn correlate(columns: &mut Vec<Vec<u32>>, target: &[f64]) {
    const ROUNDS: usize = 8;
    let d = columns.len();
    let n = columns.first().map_or(0, Vec::len);
    if n < 2 {
        return;
    }
    let scores: Vec<f64> = (1..=n).map(|rank| quantile(rank as f64 / (n + 1) as f64)).collect();
    let mut wanted = target.to_vec();
    let mut off = f64::INFINITY;
    for _ in 0..ROUNDS {
        let Ok(factor) = Cholesky::new(&wanted, d, SMALLEST_PIVOT) else { return };
        let present = Cholesky::new(&correlations(columns, &scores), d, SMALLEST_PIVOT).ok();
        let candidate = pass(columns, &scores, present.as_ref().map(Cholesky::lower), factor.lower());
        let found = of_ranks(&candidate);
        let farther = found.iter().zip(target).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        if farther >= off {
            return;
        }
        (*columns, off) = (candidate, farther);
        wanted.iter_mut().zip(target.iter().zip(&found)).for_each(|(w, (t, f))| *w += t - f);
    }
}

/// Computes the ranks of M F'^-1 L', column by column.
fn pass(columns: &[Vec<u32>], scores: &[f64], present: Option<&[f64]>, wanted: &[f64]) -> Vec<Vec<u32>> {
    let d = columns.len();
    let mut free: Vec<Vec<f64>> = Vec::with_capacity(d);
    for (j, column) in columns.iter().enumerate() {
        let mut y: Vec<f64> = column.iter().map(|rank| scores[*rank as usize]).collect();
        if let Some(factor) = present {
            for (k, earlier) in free.iter().enumerate() {
                let l = factor[j * d + k];
                y.iter_mut().zip(earlier).for_each(|(y, e)| *y -= l * e);
            }
            y.iter_mut().for_each(|y| *y /= factor[j * d + j]);
        }
        free.push(y);
    }
    let joined = |j: usize| {
        let mut y = vec![0.0; scores.len()];
        for (l, column) in wanted[j * d..=j * d + j].iter().zip(&free) {
            y.iter_mut().zip(column).for_each(|(y, x)| *y += l * x);
        }
        ranks(&y)
    };
    (0..d).map(joined).collect()
}

/// The correlations of the columns' scores, row by row. All columns have the same scores, with mean 0.
fn correlations(columns: &[Vec<u32>], scores: &[f64]) -> Vec<f64> {
    let square: f64 = scores.iter().map(|s| s * s).sum();
    let product = |a: &[u32], b: &[u32]| -> f64 {
        a.iter().zip(b).map(|(a, b)| scores[*a as usize] * scores[*b as usize]).sum::<f64>() / square
    };
    columns.iter().flat_map(|a| columns.iter().map(move |b| product(a, b))).collect()
}

/// The correlations of normal scores for these ranks under a Gaussian copula: 2 sin(π rank correlation / 6).
fn of_ranks(columns: &[Vec<u32>]) -> Vec<f64> {
    let n = columns.first().map_or(0, Vec::len);
    let centred: Vec<f64> = (0..n).map(|rank| rank as f64 - 0.5 * (n as f64 - 1.0)).collect();
    let scores = |rank: f64| 2.0 * (std::f64::consts::PI * rank / 6.0).sin();
    correlations(columns, &centred).into_iter().map(scores).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_pass_matches_numpy_and_scipy() {
        let reference: serde_json::Value =
            serde_json::from_str(include_str!("../../tests/reference/correlation.json")).unwrap();
        let case = &reference["iman_conover"];
        let table = |key: &str| -> Vec<Vec<u32>> { serde_json::from_value(case[key].clone()).unwrap() };
        let target: Vec<f64> = serde_json::from_value(case["target"].clone()).unwrap();
        let columns = table("columns");
        let scores: Vec<f64> = (1..=40).map(|rank| quantile(f64::from(rank) / 41.0)).collect();
        let factor = |matrix: &[f64]| Cholesky::new(matrix, 3, SMALLEST_PIVOT).unwrap().lower().to_vec();
        let present = factor(&correlations(&columns, &scores));
        assert_eq!(pass(&columns, &scores, Some(&present), &factor(&target)), table("after"));
    }
}
