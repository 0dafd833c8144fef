//! Independent uniform sampling.

use std::sync::Arc;

use crate::copula::Copula;
use crate::{Design, DesignError, ParameterSpace, Sampler, Stream};

/// Independent draws, uniform in each parameter's scale: the plain Monte Carlo design. Its points are exchangeable, and
/// binomial intervals are exact.
///
/// Integers and categories are also drawn independently and are not balanced, because balancing would make the points
/// dependent. Correlated parameters have exactly the distribution of their Gaussian copula. Any subset of the points is
/// again such a design. Points and parameters are unlimited.
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
