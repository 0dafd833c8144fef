//! The samplers: Latin hypercube, scrambled Sobol, plain uniform.

mod uniform;

pub use uniform::Uniform;
