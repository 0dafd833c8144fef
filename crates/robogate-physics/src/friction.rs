//! The friction coefficients that act on an object, over all of its possible contacts.

use std::collections::BTreeMap;

use robogate_core::{Fault, FaultKind};

use crate::{Scene, Side};

/// The friction coefficients that act on the bodies of a scene.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Friction {
    /// Against everything but the table and the pads.
    pub(crate) others: f64,
    /// Against the table.
    pub(crate) table: f64,
    /// Against the pads of the gripper, if it has pads.
    pub(crate) pads: Option<f64>,
    /// Of each body that has its own coefficient, against everything without one.
    pub(crate) own: Vec<(usize, f64)>,
}

/// Coefficients of single contacts, collected.
#[derive(Debug, Default)]
pub(crate) struct Coefficients {
    others: Vec<f64>,
    table: Vec<f64>,
    pads: Vec<f64>,
    own: BTreeMap<usize, Vec<f64>>,
}

/// What an object touches, as far as it determines the coefficient.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Against {
    /// The table or a receptacle.
    Table,
    /// A pad of the gripper.
    Pad,
    /// Anything else.
    Other,
}

impl Coefficients {
    /// Adds the coefficient of a contact of a body.
    fn add(&mut self, against: Against, coefficient: f64) {
        let list = match against {
            Against::Table => &mut self.table,
            Against::Pad => &mut self.pads,
            Against::Other => &mut self.others,
        };
        list.push(coefficient);
    }

    /// Adds the coefficient of a body of the scene against another side, which is a body of the scene, a fixture or the robot.
    pub(crate) fn contact(&mut self, scene: &Scene, body: usize, other: (Side, Against), coefficient: f64) {
        let (side, against) = other;
        // The larger coefficient of two sides acts, so a side that has its own says nothing about this body.
        let stated = match side {
            Side::Body(other) => scene.free_body(other).friction,
            Side::Fixture(fixture) => scene.fixtures[fixture].friction,
            Side::Robot => None,
        };
        match (stated, scene.free_body(body).friction) {
            (Some(_), _) => {}
            (None, None) => self.add(against, coefficient),
            // Of two free bodies the other one has the coefficient of the scene.
            (None, Some(_)) if matches!(side, Side::Body(_)) => {}
            (None, Some(_)) => self.own.entry(body).or_default().push(coefficient),
        }
    }

    /// The one coefficient of each kind of contact.
    ///
    /// # Errors
    /// If contacts of one kind have different coefficients, or there is none.
    pub(crate) fn finish(self) -> Result<Friction, Fault> {
        let own = self.own.iter().map(|(body, all)| Ok((*body, one("other bodies", all)?)));
        let own = own.collect::<Result<Vec<_>, Fault>>()?;
        if self.others.is_empty() && self.table.is_empty() && !own.is_empty() {
            return Ok(Friction { others: f64::NAN, table: f64::NAN, pads: None, own });
        }
        Ok(Friction {
            others: one("other bodies", &self.others)?,
            table: one("the table", &self.table)?,
            pads: if self.pads.is_empty() { None } else { Some(one("the pads", &self.pads)?) },
            own,
        })
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
        coefficients.add(Against::Table, 0.2);
        coefficients.add(Against::Other, 0.8);
        coefficients.add(Against::Other, 0.8);
        assert_eq!(coefficients.finish().unwrap(), Friction { others: 0.8, table: 0.2, pads: None, own: Vec::new() });

        let mut coefficients = Coefficients::default();
        coefficients.add(Against::Table, 0.2);
        coefficients.add(Against::Other, 0.8);
        coefficients.add(Against::Other, 0.9);
        assert_eq!(coefficients.finish().unwrap_err().kind, FaultKind::NotApplied);
    }
}
