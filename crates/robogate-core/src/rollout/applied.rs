//! Compares requested parameters with the applied ones.

use crate::{Assignment, Fault, FaultKind};

/// Largest relative difference between a requested and an applied number. Engines that store a quantity in another form
/// (a density, a single-precision mass) return it rounded.
const APPLIED_TOLERANCE: f64 = 1e-6;

/// Below this magnitude the tolerance is absolute: a small offset is computed from a position in single precision.
const APPLIED_FLOOR: f64 = 0.1;

/// Whether an engine has this number, as far as its precision tells.
pub fn is_applied(wanted: f64, found: f64) -> bool {
    (wanted - found).abs() <= APPLIED_TOLERANCE * wanted.abs().max(APPLIED_FLOOR)
}

/// Checks that every requested parameter was applied: numbers to single precision, words exactly.
pub fn check_applied(requested: &Assignment, applied: &Assignment) -> Result<(), Fault> {
    for (name, want) in requested.iter() {
        let same = match (requested.number(name), applied.number(name)) {
            (Some(want), Some(got)) => is_applied(want, got),
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
