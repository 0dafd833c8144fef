//! Compares requested parameters with the applied ones.

use crate::{Assignment, Fault, FaultKind};

/// Largest relative difference between a requested and an applied number. Engines that store a quantity in another form
/// (a density, a single-precision mass) return it rounded.
const APPLIED_TOLERANCE: f64 = 1e-6;

/// Below this magnitude the tolerance is absolute: a small offset is computed from a position in single precision.
const APPLIED_FLOOR: f64 = 0.1;

/// Checks that every requested parameter was applied: numbers to single precision, words exactly.
pub fn check_applied(requested: &Assignment, applied: &Assignment) -> Result<(), Fault> {
    for (name, want) in requested.iter() {
        let same = match (requested.number(name), applied.number(name)) {
            (Some(want), Some(got)) => (want - got).abs() <= APPLIED_TOLERANCE * want.abs().max(APPLIED_FLOOR),
            _ => applied.get(name) == Some(want),
        };
        if !same {
            let got = applied.get(name).map_or_else(|| "nothing".to_owned(), ToString::to_string);
            return Err(Fault::new(
                FaultKind::NotApplied,
                format!("requested {name} = {want}, but the environment applied {got}"),
            ));
        }
    }
    Ok(())
}
