//! Chunks of actions.

use super::array::Array;
use super::error::PolicyError;
use super::profile::{MAX_CHUNK, Profile};

/// A chunk: consecutive actions of a model as raw numbers.
#[derive(Debug, Clone, PartialEq)]
pub struct Chunk {
    rows: Vec<Vec<f64>>,
}

impl Chunk {
    /// Create a chunk from an array of shape `(length, size)`, or `(size,)` for one action. Leading axes of size 1 are
    /// ignored.
    pub(crate) fn of_array(array: &Array) -> Result<Self, PolicyError> {
        let mut shape = array.shape();
        while let (3.., [1, rest @ ..]) = (shape.len(), shape) {
            shape = rest;
        }
        let width = match shape {
            [width] | [_, width] if *width > 0 => *width,
            _ => {
                return Err(PolicyError::Shape(format!("the actions have the shape {array}. Expected (length, size)")));
            }
        };
        Self::of_rows(array.numbers().chunks_exact(width).map(<[f64]>::to_vec).collect())
    }

    /// Create a chunk from a list of actions.
    ///
    /// # Errors
    /// No actions, or too many.
    pub fn of_rows(rows: Vec<Vec<f64>>) -> Result<Self, PolicyError> {
        if rows.is_empty() || rows.len() > MAX_CHUNK {
            return Err(PolicyError::Shape(format!("the reply has {} actions. Expected 1 to {MAX_CHUNK}", rows.len())));
        }
        Ok(Self { rows })
    }

    /// One part of each action, from an array of shape `(1, T, D)`, `(T, D)` or `(T,)`.
    pub(crate) fn columns(array: &Array, key: &str) -> Result<Vec<Vec<f64>>, PolicyError> {
        let width = match array.shape() {
            [1, _, width] | [_, width] if *width > 0 => *width,
            [_] => 1,
            _ => return Err(PolicyError::Shape(format!("`{key}` has the shape {array}. Expected (length, size)"))),
        };
        Ok(array.numbers().chunks_exact(width).map(<[f64]>::to_vec).collect())
    }

    /// Append one part to each action. `rows` is empty before the first part.
    pub(crate) fn join(rows: &mut Vec<Vec<f64>>, part: Vec<Vec<f64>>, key: &str) -> Result<(), PolicyError> {
        if rows.is_empty() {
            *rows = part;
        } else if rows.len() == part.len() {
            rows.iter_mut().zip(part).for_each(|(row, more)| row.extend(more));
        } else {
            let (got, expected) = (part.len(), rows.len());
            return Err(PolicyError::Shape(format!(
                "`{key}` has {got} actions, but the parts before it have {expected}"
            )));
        }
        Ok(())
    }

    /// The raw numbers of each action.
    pub fn rows(&self) -> &[Vec<f64>] {
        &self.rows
    }

    pub(crate) fn into_rows(self) -> Vec<Vec<f64>> {
        self.rows
    }

    /// Check the length, the size and the numbers against the profile.
    pub fn check(&self, profile: &Profile) -> Result<(), PolicyError> {
        let size = profile.action.size;
        if let Some(row) = self.rows.iter().find(|row| row.len() != size) {
            return Err(PolicyError::Shape(format!(
                "an action has {} numbers, but action.size of the profile is {size}",
                row.len()
            )));
        }
        let got = self.rows.len();
        match (profile.chunk.length, profile.chunk.execute) {
            (Some(length), _) if length != got => {
                return Err(PolicyError::Shape(format!(
                    "the reply has {got} actions, but chunk.length of the profile is {length}. Hint: set it in a copy of the profile, or \
                     leave it out there"
                )));
            }
            (_, execute) if got < execute => {
                return Err(PolicyError::Shape(format!(
                    "the reply has {got} actions, but chunk.execute of the profile is {execute}"
                )));
            }
            _ => {}
        }
        for (row, numbers) in self.rows.iter().enumerate() {
            if let Some(column) = numbers.iter().position(|n| !n.is_finite()) {
                return Err(PolicyError::NotFinite { row, column, value: numbers[column].to_string() });
            }
        }
        Ok(())
    }
}
