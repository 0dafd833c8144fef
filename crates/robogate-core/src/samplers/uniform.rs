//! Independent uniform draws.

use std::sync::Arc;

use crate::copula::Copula;
use crate::{Design, DesignError, ParameterSpace, Sampler, Stream};

/// Independent draws, uniform in each parameter's own scale: the plain Monte Carlo design, whose
/// points are exchangeable and whose binomial intervals are exact.
///
/// Integers and categories are drawn like the rest and so are not balanced: balance would make
/// the points dependent. Correlated parameters come from their Gaussian copula, exactly. Any subset of the points is again such a design. Any number of points and parameters.
#[derive(Debug, Clone, Copy, Default)]
pub struct Uniform;

impl Sampler for Uniform {
    fn name(&self) -> &'static str {
        "uniform"
    }

    fn design(&self, space: &Arc<ParameterSpace>, n: usize, mut stream: Stream) -> Result<Design, DesignError> {
        if n == 0 {
            return Err(DesignError::Empty);
        }
        let mut unit: Vec<f64> = (0..n * space.len()).map(|_| stream.uniform()).collect();
        if let Some(copula) = Copula::of(space)? {
            unit.chunks_exact_mut(space.len()).for_each(|point| copula.join(point));
        }
        Ok(Design::from_unit(Arc::clone(space), unit))
    }
}
