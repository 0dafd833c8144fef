//! Gaussian copulas: correlated uniform numbers.

use robogate_maths::dense::Cholesky;
use robogate_maths::normal::{cdf, quantile};

use crate::{ParameterSpace, SpaceError};

/// Smallest pivot of a correlation matrix that counts as positive definite.
pub(crate) const SMALLEST_PIVOT: f64 = 1e-6;

/// The correlated parameters of a space and the correlations of their normal scores.
#[derive(Debug, Clone)]
pub(crate) struct Copula {
    /// Positions of the correlated parameters in the space, in increasing order.
    columns: Vec<usize>,
    /// Correlations of the normal scores, row by row.
    target: Vec<f64>,
    /// The Cholesky factor L of `target` = L L'.
    factor: Cholesky,
}

impl Copula {
    /// Builds the copula of a space. Returns `None` if its parameters are independent.
    pub(crate) fn of(space: &ParameterSpace) -> Result<Option<Self>, SpaceError> {
        let position = |name: &str| space.position(name).unwrap_or(usize::MAX);
        let pairs: Vec<([usize; 2], f64)> =
            space.correlations().iter().map(|c| (c.parameters.each_ref().map(|name| position(name)), c.rank)).collect();
        let mut columns: Vec<usize> = pairs.iter().flat_map(|(pair, _)| *pair).collect();
        columns.sort_unstable();
        columns.dedup();
        if columns.is_empty() {
            return Ok(None);
        }
        let target = between(&columns, &pairs);
        let factor = Cholesky::new(&target, columns.len(), SMALLEST_PIVOT).map_err(|at| {
            let names = columns[..=at].iter().filter_map(|c| space.parameters().get(*c));
            let names: Vec<String> = names.map(|p| format!("`{}`", p.name)).collect();
            SpaceError::CorrelationsContradict { parameters: names.join(", ") }
        })?;
        Ok(Some(Self { columns, target, factor }))
    }

    /// Transforms independent coordinates in [0, 1) into correlated ones. Each stays uniform.
    pub(crate) fn join(&self, point: &mut [f64]) {
        let d = self.columns.len();
        let factor = self.factor.lower();
        // 0 has no normal score. The smallest number that a sampler draws above it is 2^-53.
        let z: Vec<f64> = self.columns.iter().map(|c| quantile(point[*c].max(0.5_f64.powi(54)))).collect();
        // The first coordinate does not change.
        for i in 1..d {
            let y: f64 = factor[i * d..=i * d + i].iter().zip(&z).map(|(l, z)| l * z).sum();
            point[self.columns[i]] = cdf(y).min(1.0 - f64::EPSILON / 2.0);
        }
    }

    /// The correlations of the normal scores between these columns of the space. Columns outside the copula have 0.
    pub(crate) fn target(&self, columns: &[usize]) -> Vec<f64> {
        let own = |column: &usize| self.columns.iter().position(|c| c == column);
        let mut target = Vec::with_capacity(columns.len() * columns.len());
        for a in columns {
            target.extend(columns.iter().map(|b| match (own(a), own(b)) {
                (Some(i), Some(j)) => self.target[i * self.columns.len() + j],
                _ => f64::from(u8::from(a == b)),
            }));
        }
        target
    }
}

/// The matrix of 2 sin(π rank / 6) with a diagonal of 1.
fn between(columns: &[usize], pairs: &[([usize; 2], f64)]) -> Vec<f64> {
    let entry = |a: &usize, b: &usize| {
        let rank = pairs.iter().find(|(pair, _)| pair.contains(a) && pair.contains(b)).map_or(0.0, |(_, rank)| *rank);
        if a == b { 1.0 } else { 2.0 * (std::f64::consts::PI * rank / 6.0).sin() }
    };
    columns.iter().flat_map(|a| columns.iter().map(move |b| entry(a, b))).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Correlation, Domain, Parameter, Scale, Seed};

    fn reference() -> serde_json::Value {
        serde_json::from_str(include_str!("../tests/reference/correlation.json")).unwrap()
    }

    fn joined(rank: f64) -> Copula {
        let domain = Domain::Continuous { low: 0.0, high: 1.0, scale: Scale::Linear };
        let parameter = |name: &str| Parameter { name: name.into(), domain: domain.clone() };
        let space = ParameterSpace::new("pair", vec![parameter("a"), parameter("b")]).unwrap();
        let correlation = Correlation { parameters: ["a".into(), "b".into()], rank };
        Copula::of(&space.with_correlations(vec![correlation]).unwrap()).unwrap().unwrap()
    }

    #[test]
    fn score_correlations_match_quadrature() {
        for case in reference()["copula"].as_array().unwrap() {
            let [rank, pearson] = ["rank", "pearson"].map(|key| case[key].as_f64().unwrap());
            let ours = joined(rank).target[1];
            assert!((ours - pearson).abs() < 1e-9, "{rank}: {ours} {pearson}");
        }
    }

    #[test]
    fn joined_coordinates_stay_uniform() {
        let copula = joined(-0.9);
        for corner in [[0.0, 0.0], [0.0, 1.0 - f64::EPSILON / 2.0], [1.0 - f64::EPSILON / 2.0; 2]] {
            let mut point = corner;
            copula.join(&mut point);
            assert!(point.iter().all(|u| (0.0..1.0).contains(u)), "{corner:?} {point:?}");
        }
        let mut stream = Seed::campaign(4).stream("points");
        let mut cells = [0_u32; 20];
        for _ in 0..200_000 {
            let mut point = [stream.uniform(), stream.uniform()];
            copula.join(&mut point);
            cells[(point[1] * 20.0) as usize] += 1;
        }
        // 20 cells of 10,000 +- 97 (one standard deviation). The tolerance is five standard deviations.
        assert!(cells.iter().all(|c| c.abs_diff(10_000) < 490), "{cells:?}");
    }
}
