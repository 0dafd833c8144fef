//! The samplers: Latin hypercube, scrambled Sobol, plain uniform.

mod balance;
mod iman_conover;
mod latin_hypercube;
mod maximin;
mod sobol;
mod sobol_directions;
mod uniform;

pub use latin_hypercube::LatinHypercube;
pub use sobol::Sobol;
pub use uniform::Uniform;

use crate::Sampler;

/// The names of the samplers in settings.
pub const NAMES: [&str; 3] = ["latin_hypercube", "sobol", "uniform"];

/// The sampler with this name, with default settings. `None` if the name is unknown.
///
/// ```
/// use robogate_core::samplers;
/// assert!(samplers::NAMES.iter().all(|name| samplers::by_name(name).is_some_and(|s| s.name() == *name)));
/// assert!(samplers::by_name("grid").is_none());
/// ```
pub fn by_name(name: &str) -> Option<Box<dyn Sampler>> {
    match name {
        "latin_hypercube" => Some(Box::new(LatinHypercube::default())),
        "sobol" => Some(Box::new(Sobol)),
        "uniform" => Some(Box::new(Uniform)),
        _ => None,
    }
}
