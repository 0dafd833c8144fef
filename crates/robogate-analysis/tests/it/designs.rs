//! Synthetic designs of one law.

use std::path::Path;
use std::sync::Arc as Shared;

use robogate_core::{FailureMode, Outcome, ParameterSpace};
use robogate_dictionary::{Dictionary, Entry};

use crate::synthetic::{entry, unit, write};

/// The probability of success at a point of the unit cube: logarithm of friction, mass, obstacles.
pub(crate) type Law = fn(&[f64]) -> f64;
/// How a design moves a point of the unit cube.
pub(crate) type Focus = fn(&mut [f64]);

pub(crate) fn even(_: &mut [f64]) {}

/// `n` episodes of a law. Those from `n - focused` on are moved by `focus` and belong to the boundary stage.
pub(crate) fn sampled(space: &ParameterSpace, seed: u64, n: u64, focused: u64, law: Law, focus: Focus) -> Vec<Entry> {
    let one = |index: u64| {
        let of = seed * 1_000_003 + index;
        let mut at: Vec<f64> = (1..=space.len() as u64).map(|salt| unit(of, salt)).collect();
        let is_focused = index >= n - focused;
        if is_focused {
            focus(&mut at);
        }
        let value = |(p, u): (&robogate_core::Parameter, &f64)| {
            (Shared::clone(&p.name), p.domain.decode(p.domain.from_unit(*u)))
        };
        let requested = space.parameters().iter().zip(&at).map(value).collect();
        let success = unit(of, 99) < law(&at);
        let outcome = if success { Outcome::Success } else { Outcome::Failure(FailureMode::constant("grip_loss")) };
        let mut entry = entry(index, requested, outcome);
        if is_focused {
            entry.stage = "boundary".to_owned();
            entry.weight = 0.5;
        }
        entry
    };
    (0..n).map(one).collect()
}

pub(crate) fn dictionary(dir: &Path, name: &str, space: &ParameterSpace, entries: Vec<Entry>) -> Dictionary {
    let path = dir.join(name);
    write(&path, space, entries);
    Dictionary::open(&path).unwrap()
}
