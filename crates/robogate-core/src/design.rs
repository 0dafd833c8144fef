//! Sets of points and what draws them.

use std::sync::Arc;

use crate::{Assignment, ParameterSpace, SpaceError, Stream};

/// A set of points of a space, in one flat table: a million points of eight parameters are 64 MB.
#[derive(Debug, Clone, PartialEq)]
pub struct Design {
    space: Arc<ParameterSpace>,
    /// (points x parameters), row by row; a category is the index of its choice.
    coded: Vec<f64>,
}

impl Design {
    /// The design whose points stand in the unit cube, row by row: `unit` has
    /// `space.len()` entries in [0, 1) for each point, mapped by [`crate::Domain::from_unit`].
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

    /// The space the points belong to.
    pub fn space(&self) -> &ParameterSpace {
        &self.space
    }

    /// How many points there are.
    pub fn len(&self) -> usize {
        self.coded.len() / self.space.len()
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.coded.is_empty()
    }

    /// Point `i` as coded numbers (a category is the index of its choice), if there is one.
    pub fn coded(&self, i: usize) -> Option<&[f64]> {
        let d = self.space.len();
        self.coded.get(i * d..(i + 1) * d)
    }

    /// Point `i` as named values, if there is one.
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

/// Draws designs. The same (space, n, stream) gives the same design.
pub trait Sampler {
    /// The sampler's name in data and settings.
    fn name(&self) -> &'static str;

    /// `n` points of `space`.
    fn design(&self, space: &Arc<ParameterSpace>, n: usize, stream: Stream) -> Result<Design, DesignError>;
}

/// Why a design could not be drawn.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum DesignError {
    /// A design of no points is no design.
    #[error("a design needs at least one point (asked for 0)")]
    Empty,
    /// Correlations that no distribution has.
    #[error(transparent)]
    Space(#[from] SpaceError),
    /// The sampler's tables end before.
    #[error("{sampler} is defined up to {limit} {what} (asked for {asked})")]
    Limit {
        /// The sampler.
        sampler: &'static str,
        /// Of what there are too many: points or parameters.
        what: &'static str,
        /// How many it can.
        limit: usize,
        /// How many were asked for.
        asked: usize,
    },
}
