//! What a model saw at earlier actions of the episode.

use std::collections::VecDeque;

use robogate_core::{Image, Observation};

use super::error::PolicyError;
use super::profile::Profile;
use super::query;

/// The images and states of earlier actions, as far as the profile sends them. The present ones are last.
///
/// Before the first action they are those of the first action. With latency the robot may wait between two actions, so the
/// items are those of control periods, and an offset counts the periods that an action takes.
#[derive(Debug, Default)]
pub(crate) struct History {
    images: Past<Vec<Image>>,
    states: Past<Vec<Vec<f64>>>,
}

/// The items of the last actions, or of the last control periods.
#[derive(Debug)]
struct Past<T> {
    /// Number of actions before the present one that are kept. With 0, nothing is kept.
    depth: usize,
    /// Items for each action.
    stride: usize,
    items: VecDeque<T>,
}

impl History {
    /// The history that a profile needs.
    pub(crate) fn new(profile: &Profile) -> Self {
        Self {
            images: Past::new(profile.cameras.iter().flat_map(|camera| &camera.history)),
            states: Past::new(profile.states.iter().flat_map(|state| &state.history)),
        }
    }

    /// Forget everything, for a new episode.
    pub(crate) fn clear(&mut self) {
        self.images.items.clear();
        self.states.items.clear();
    }

    /// Whether the model sees images of earlier actions.
    pub(crate) fn has_images(&self) -> bool {
        self.images.depth > 0
    }

    /// Keep what the model sees at the present action.
    pub(crate) fn push(&mut self, profile: &Profile, observation: &Observation) -> Result<(), PolicyError> {
        if self.images.depth > 0 {
            self.images.push(observation.images.clone());
        }
        if self.states.depth > 0 {
            self.states.push(query::numbers(profile, observation)?);
        }
        Ok(())
    }

    /// Keep what the model sees in the present control period. An action takes so many of them.
    pub(crate) fn push_period(
        &mut self,
        profile: &Profile,
        observation: &Observation,
        periods: u32,
    ) -> Result<(), PolicyError> {
        (self.images.stride, self.states.stride) = (periods.max(1) as usize, periods.max(1) as usize);
        self.push(profile, observation)
    }

    /// The images of an action: the present one for the offset 0, earlier ones for negative offsets. `None` if none are
    /// kept.
    pub(crate) fn images(&self, offset: i32) -> Option<&[Image]> {
        self.images.at(offset).map(Vec::as_slice)
    }

    /// The numbers of each state at an action, with offsets as for [`Self::images`].
    pub(crate) fn states(&self, offset: i32) -> Option<&[Vec<f64>]> {
        self.states.at(offset).map(Vec::as_slice)
    }
}

impl<T> Past<T> {
    fn new<'a>(offsets: impl Iterator<Item = &'a i32>) -> Self {
        let depth = offsets.map(|offset| offset.unsigned_abs() as usize).max().unwrap_or(0);
        Self { depth, ..Self::default() }
    }

    fn push(&mut self, item: T) {
        self.items.push_back(item);
        self.items.drain(..self.items.len().saturating_sub(self.depth * self.stride + 1));
    }

    fn at(&self, offset: i32) -> Option<&T> {
        let back = offset.unsigned_abs() as usize * self.stride;
        self.items.get(self.items.len().saturating_sub(1 + back))
    }
}

impl<T> Default for Past<T> {
    fn default() -> Self {
        Self { depth: 0, stride: 1, items: VecDeque::new() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn actions_of_two_periods_skip_every_other_one() {
        let mut past: Past<u32> = Past::new([0, -2].iter());
        past.stride = 2;
        for period in 0..=7 {
            past.push(period);
        }
        assert_eq!([0, -1, -2].map(|offset| past.at(offset).copied()), [Some(7), Some(5), Some(3)]);
        assert_eq!(past.items.len(), 5);
        let mut early: Past<u32> = Past::new([-3].iter());
        early.stride = 2;
        early.push(1);
        assert_eq!(early.at(-3), Some(&1));
    }
}
