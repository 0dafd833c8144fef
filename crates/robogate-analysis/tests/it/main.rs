//! Tests of the public interface.

#![expect(clippy::unwrap_used, reason = "helpers of tests are tests too")]

mod anchors;
mod clusters;
mod comparison;
mod degenerate;
mod dependence;
mod designs;
mod explorer;
mod headlines;
mod learners;
mod named;
mod noise;
mod populations;
mod risk;
mod runs;
mod sought;
mod synthetic;
mod transfer;

use robogate_core::{Assignment, Domain, ParameterSpace};

/// Sets one parameter to a relative position in its range.
fn hold(requested: &mut Assignment, space: &ParameterSpace, name: &str, unit: f64) {
    let domain: &Domain = &space.parameters()[space.position(name).unwrap()].domain;
    requested.set(name, domain.decode(domain.from_unit(unit)));
}
