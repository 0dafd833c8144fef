//! Designs (sets of points) and the samplers that draw them.

use std::sync::Arc;

use crate::{Assignment, ParameterSpace, SpaceError, Stream};

/// A set of points of a space, stored as one flat table. A million points of eight parameters take 64 MB.
#[derive(Debug, Clone, PartialEq)]
pub struct Design {
    space: Arc<ParameterSpace>,
    /// Coded values (points x parameters), row by row. A category is the index of its choice.
    coded: Vec<f64>,
}

impl Design {
    /// Builds a design from points in the unit cube. `unit` holds `space.len()` entries in [0, 1) per point, row by
    /// row; [`crate::Domain::from_unit`] maps them to values.
    pub fn from_unit(space: Arc<ParameterSpace>, mut unit: Vec<f64>) -> Self {
        let d = space.len();
        debug_assert!(d > 0 && unit.len().is_multiple_of(d));
        for point in unit.chunks_exact_mut(d) {
            for (u, parameter) in point.iter_mut().zip(space.parameters()) {
                *u = parameter.domain.from_unit(*u);
            }
        }
        Self { space, coded: unit }
    }

    /// Builds a design from the coded numbers of its points, row by row, as [`Self::coded`] returns them. `None` if the last row is
    /// incomplete, or if a number does not stand for a value of its parameter.
    pub fn from_coded(space: Arc<ParameterSpace>, coded: Vec<f64>) -> Option<Self> {
        let d = space.len();
        let belongs =
            |point: &[f64]| space.parameters().iter().zip(point).all(|(one, code)| one.domain.has_code(*code));
        (d > 0 && coded.len().is_multiple_of(d) && coded.chunks_exact(d).all(belongs)).then_some(Self { space, coded })
    }

    /// The space of the points.
    pub fn space(&self) -> &ParameterSpace {
        &self.space
    }

    /// The number of points.
    pub fn len(&self) -> usize {
        self.coded.len() / self.space.len()
    }

    /// Whether the design has no points.
    pub fn is_empty(&self) -> bool {
        self.coded.is_empty()
    }

    /// Point `i` as coded numbers (a category is the index of its choice). `None` if `i` is out of range.
    pub fn coded(&self, i: usize) -> Option<&[f64]> {
        let d = self.space.len();
        self.coded.get(i * d..(i + 1) * d)
    }

    /// Point `i` as named values. `None` if `i` is out of range.
    pub fn assignment(&self, i: usize) -> Option<Assignment> {
        let coded = self.coded(i)?;
        Some(
            self.space
                .parameters()
                .iter()
                .zip(coded)
                .map(|(parameter, code)| (Arc::clone(&parameter.name), parameter.domain.decode(*code)))
                .collect(),
        )
    }
}

/// A method that draws designs. The same (space, n, stream) gives the same design.
pub trait Sampler {
    /// The sampler's name in data files and settings.
    fn name(&self) -> &'static str;

    /// Draws `n` points of `space`.
    fn design(&self, space: &Arc<ParameterSpace>, n: usize, stream: Stream) -> Result<Design, DesignError>;
}

/// The reason why a design could not be drawn.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum DesignError {
    /// The requested design has no points.
    #[error("a design needs at least one point (requested: 0)")]
    Empty,
    /// The space has invalid correlations.
    #[error(transparent)]
    Space(#[from] SpaceError),
    /// The request exceeds a limit of the sampler.
    #[error("{sampler} is defined up to {limit} {what} (requested: {asked})")]
    Limit {
        /// The sampler.
        sampler: &'static str,
        /// The exceeded quantity: points or parameters.
        what: &'static str,
        /// The largest accepted number.
        limit: usize,
        /// The requested number.
        asked: usize,
    },
}
