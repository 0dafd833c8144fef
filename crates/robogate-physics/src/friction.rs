//! The friction coefficients that act on an object, over all of its possible contacts.

use robogate_core::{Fault, FaultKind};

/// The friction coefficients that act on an object.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Friction {
    /// Against everything but the table.
    pub(crate) others: f64,
    /// Against the table.
    pub(crate) table: f64,
}

/// Coefficients of single contacts, collected.
#[derive(Debug, Default)]
pub(crate) struct Coefficients {
    others: Vec<f64>,
    table: Vec<f64>,
}

impl Coefficients {
    /// Adds the coefficient of a contact with the table, or with anything else.
    pub(crate) fn add(&mut self, table: bool, coefficient: f64) {
        (if table { &mut self.table } else { &mut self.others }).push(coefficient);
    }

    /// The one coefficient of each kind of contact.
    ///
    /// # Errors
    /// If contacts of one kind have different coefficients, or there is none.
    pub(crate) fn finish(self) -> Result<Friction, Fault> {
        Ok(Friction { others: one("other bodies", &self.others)?, table: one("the table", &self.table)? })
    }
}

fn one(what: &str, coefficients: &[f64]) -> Result<f64, Fault> {
    let bounds =
        coefficients.iter().fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], x| [low.min(*x), high.max(*x)]);
    match (coefficients, bounds) {
        ([], _) => Err(Fault::new(FaultKind::Setup, format!("the object cannot touch {what}"))),
        // Engines that combine two coefficients round the result.
        ([first, ..], [low, high]) if high - low <= 1e-12 * high.abs() => Ok(*first),
        (_, [low, high]) => Err(Fault::new(
            FaultKind::NotApplied,
            format!("the object's friction against {what} is {low} to {high}. Expected one coefficient"),
        )),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn different_coefficients_are_a_fault() {
        let mut coefficients = Coefficients::default();
        coefficients.add(true, 0.2);
        coefficients.add(false, 0.8);
        coefficients.add(false, 0.8);
        assert_eq!(coefficients.finish().unwrap(), Friction { others: 0.8, table: 0.2 });

        let mut coefficients = Coefficients::default();
        coefficients.add(true, 0.2);
        coefficients.add(false, 0.8);
        coefficients.add(false, 0.9);
        assert_eq!(coefficients.finish().unwrap_err().kind, FaultKind::NotApplied);
    }
}
