//! The first steps with something of the user's: what it is, drafts of what is missing, and why the first episode failed.

mod diagnosis;
mod requirements;
mod thing;

use robogate_core::{Assignment, Domain, ParameterSpace, Suite, SuiteError, TaskSpec, Value};

pub use diagnosis::diagnosis;
pub use requirements::{Wanted, collision_mode, requirements};
pub use thing::Thing;

/// One scenario with the nominal value of each parameter of the space; for a parameter without one, the middle of its range.
///
/// # Errors
/// A space without parameters.
pub fn nominal_suite(task: &TaskSpec, space: &ParameterSpace) -> Result<Suite, SuiteError> {
    let middle = |domain: &Domain| match domain {
        Domain::Continuous { low, high, .. } => Value::Number(0.5 * (low + high)),
        _ => domain.decode(0.5),
    };
    let mut point = Assignment::default();
    for parameter in space.parameters() {
        point.set(&*parameter.name, middle(&parameter.domain));
    }
    match Suite::nominal_twins(task, std::slice::from_ref(&point)) {
        // A task without nominal values: the middle of all ranges.
        Err(SuiteError::NoNominal { .. }) => Suite::sampled(&std::sync::Arc::new(space.clone()), 1, 0),
        made => made,
    }
}
