//! States that a policy saw outside of the range of its training data, as measures of each episode.
//!
//! A model that sees such states answers with actions that mean nothing. The range is published with a checkpoint. The
//! measures are shares of the policy's requests, so they are part of the record, of its hash and of the evidence.

use std::fmt;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::{Better, MeasureSpec, Measures, TaskSpec, Word};

/// The measure with the share of an episode's requests in which any number of a state was outside of its range.
pub const OUTSIDE_RANGE: Word = Word::constant("outside_range");
/// The measures with the share for a single number begin with this.
const NUMBER: &str = "outside_range.";
/// Numbers that are named in a sentence.
const NAMED: usize = 3;

/// The measure for one number of a state, by its position. `None` if no measure can have this name.
pub fn outside_range_measure(state: &str, position: usize, low: f64, high: f64) -> Option<MeasureSpec> {
    // The end of a long name tells more than its beginning.
    let room = Word::MAX_LENGTH - NUMBER.len() - 6;
    let start = state.char_indices().rev().nth(room.saturating_sub(1)).map_or(0, |(at, _)| at);
    let name = Word::nearest(&format!("{NUMBER}{}.{position}", state.get(start..)?))?;
    Some(MeasureSpec {
        name,
        unit: String::new(),
        meaning: format!(
            "Share of the policy's requests in which number {position} of the state `{state}` was outside of the published range \
             {low} to {high}."
        ),
        better: Better::Lower,
    })
}

/// The measure for all numbers together.
pub fn outside_any_range() -> MeasureSpec {
    MeasureSpec {
        name: OUTSIDE_RANGE,
        unit: String::new(),
        meaning: "Share of the policy's requests with a state outside of the published range of the checkpoint."
            .to_owned(),
        better: Better::Lower,
    }
}

/// How often a policy saw states outside of the range of its training data.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct OutsideRange {
    /// The number of episodes with at least one such state.
    pub episodes: u64,
    /// The number of episodes with a request.
    pub of: u64,
    /// The numbers of the states that were outside, those of most episodes first.
    pub numbers: Vec<OutsideNumber>,
}

/// A number of a state that was outside of its range.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct OutsideNumber {
    /// The name of the state and the position in it, from 0: `state.2`.
    pub number: String,
    /// The number of episodes in which it was outside at least once.
    pub episodes: u64,
    /// The largest share of the requests of an episode in which it was outside.
    pub largest_share: f64,
}

impl OutsideRange {
    /// An empty count. `None` if the ranges are unknown: then the task does not declare the measures.
    pub fn of(task: &TaskSpec) -> Option<Self> {
        task.measure(OUTSIDE_RANGE.as_str()).map(|_| Self::default())
    }

    /// Counts an episode.
    pub fn add(&mut self, measures: &Measures) {
        let Some(share) = measures.get(OUTSIDE_RANGE.as_str()) else { return };
        self.of += 1;
        self.episodes += u64::from(share > 0.0);
        for (name, share) in measures.iter().filter(|(_, share)| *share > 0.0) {
            let Some(number) = name.as_str().strip_prefix(NUMBER) else { continue };
            match self.numbers.iter_mut().find(|known| known.number == number) {
                Some(known) => {
                    known.episodes += 1;
                    known.largest_share = known.largest_share.max(share);
                }
                None => {
                    self.numbers.push(OutsideNumber { number: number.to_owned(), episodes: 1, largest_share: share });
                }
            }
        }
    }

    /// The count with the numbers in their order, which does not depend on that of the episodes.
    #[must_use]
    pub fn sorted(mut self) -> Self {
        self.numbers.sort_by(|a, b| b.episodes.cmp(&a.episodes).then_with(|| a.number.cmp(&b.number)));
        self
    }
}

impl fmt::Display for OutsideRange {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { episodes, of, numbers } = self;
        if *episodes == 0 {
            return write!(f, "All states were inside the published range of the checkpoint, in all {of} episodes.");
        }
        let named = numbers.iter().take(NAMED).map(|one| {
            let OutsideNumber { number, episodes, largest_share } = one;
            let percent = (100.0 * largest_share).ceil();
            format!("{number} ({episodes} episodes, up to {percent} % of the requests)")
        });
        let more = match numbers.len().saturating_sub(NAMED) {
            0 => String::new(),
            more => format!(" and {more} more"),
        };
        write!(
            f,
            "States were outside of the published range of the checkpoint in {episodes} of {of} episodes: {}{more}.",
            named.collect::<Vec<_>>().join(", ")
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn episode(shares: &[(&str, f64)]) -> Measures {
        let name = |suffix: &str| Word::new(&format!("{NUMBER}{suffix}")).unwrap();
        let any = shares.iter().map(|(_, share)| *share).fold(0.0, f64::max);
        let numbers = shares.iter().map(|(suffix, share)| (name(suffix), Some(*share)));
        numbers.chain([(OUTSIDE_RANGE, Some(any))]).collect()
    }

    #[test]
    fn episodes_and_numbers_are_counted() {
        let mut count = OutsideRange::default();
        for measures in [
            episode(&[("state.0", 0.0), ("state.2", 0.25)]),
            episode(&[("state.0", 0.5), ("state.2", 1.0)]),
            episode(&[("state.0", 0.0), ("state.2", 0.0)]),
            // The reset failed.
            Measures::default(),
        ] {
            count.add(&measures);
        }
        let count = count.sorted();
        assert_eq!((count.episodes, count.of), (2, 3));
        assert_eq!(
            count.to_string(),
            "States were outside of the published range of the checkpoint in 2 of 3 episodes: state.2 (2 episodes, up to 100 % of \
             the requests), state.0 (1 episodes, up to 50 % of the requests)."
        );
        let mut inside = OutsideRange::default();
        inside.add(&episode(&[("state.0", 0.0)]));
        assert_eq!(
            inside.to_string(),
            "All states were inside the published range of the checkpoint, in all 1 episodes."
        );
    }

    #[test]
    fn long_names_of_states_keep_their_end() {
        let long = format!("observation/{}/eef_position", "x".repeat(80));
        let measure = outside_range_measure(&long, 12, -1.0, 1.0).unwrap();
        assert!(measure.name.as_str().ends_with("/eef_position.12".replace('/', "_").as_str()), "{}", measure.name);
        assert_eq!(
            outside_range_measure("observation/state", 3, -1.0, 1.0).unwrap().name.as_str(),
            "outside_range.observation_state.3"
        );
    }
}
