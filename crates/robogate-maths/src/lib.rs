//! Special functions and small dense matrices, shared by the samplers and the statistics.
//!
//! Every function is accurate in the far tails and is tested against SciPy. Arguments must be finite and inside the
//! domain of the function. The callers check this.
//!
//! The exact bits of [`normal::cdf`], [`normal::quantile`] and [`dense::Cholesky::lower`] determine the points of a
//! design. A change to them changes every campaign with correlated parameters.

pub mod beta;
pub mod dense;
pub mod gamma;
pub mod normal;
#[cfg(test)]
mod reference;
