//! Whether episodes repeat: the same scenarios run in two processes of the environment, in opposite orders.
//!
//! An episode should follow from its seed and its parameters. If the start of an episode also depends on the episodes before it or
//! on the process, the rows do not describe what ran, and a later episode may depend on an earlier one: then they are no evidence.
//! If only later bits of a trajectory differ, the rate is still one over these starts, but two policies cannot be paired.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// How many of the episodes that ran twice were different.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Repeats {
    /// Number of episodes that ran twice.
    pub episodes: u64,
    /// Whether they ran in two processes. Otherwise both times in the same one, in opposite orders.
    pub fresh_process: bool,
    /// Number of them with another start.
    pub other_start: u64,
    /// Number of them with the same start and, after the same actions, another trajectory.
    pub other_trajectory: u64,
    /// Number of them in which the policy acted in another way, although the environment repeats.
    #[serde(default)]
    pub other_actions: u64,
}

impl Repeats {
    /// What the episodes depend on beside their seeds.
    fn cause(&self) -> &'static str {
        if self.fresh_process { "the order or the process" } else { "the order" }
    }

    /// Why the episodes cannot be used as evidence. `None` if each seed gives the same start again.
    pub fn failure(&self) -> Option<String> {
        let Self { episodes, other_start, .. } = self;
        (*other_start > 0).then(|| {
            format!(
                "episodes depend on {}: {other_start} of {episodes} episodes that ran twice had another start with the same seed. \
                 Let the reset of the environment set everything that varies from its seed",
                self.cause()
            )
        })
    }

    /// Why the episodes cannot be compared one by one with those of another policy. `None` if they can.
    pub fn unpaired(&self) -> Option<String> {
        let different = self.other_start + self.other_trajectory;
        (different > 0).then(|| {
            format!(
                "episodes depend on {}: {different} of {} episodes that ran twice were different",
                self.cause(),
                self.episodes
            )
        })
    }

    /// What does not repeat and what still holds, for reports. `None` if everything repeats.
    pub fn line(&self) -> Option<String> {
        let Self { episodes, other_trajectory, other_actions, .. } = self;
        if self.other_start > 0 {
            return self.failure().map(|why| format!("Repetition: {why}"));
        }
        if *other_trajectory > 0 {
            return Some(format!(
                "Repetition: episodes depend on {}. {other_trajectory} of {episodes} episodes that ran twice had the same start and \
                 another trajectory. The rate holds for these starts; a replay differs, and another policy cannot be compared episode \
                 by episode",
                self.cause()
            ));
        }
        (*other_actions > 0).then(|| {
            format!(
                "Repetition: the policy acted in another way in {other_actions} of {episodes} episodes that ran twice, and the \
                 environment repeats. The rate holds; a replay differs"
            )
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn says_what_still_holds() {
        let same = Repeats { episodes: 3, fresh_process: true, ..Repeats::default() };
        assert_eq!((same.failure(), same.unpaired(), same.line()), (None, None, None));
        let start = Repeats { other_start: 2, ..same };
        assert!(start.failure().is_some_and(|why| why.contains("the order or the process: 2 of 3 episodes")));
        assert!(start.unpaired().is_some());
        let late = Repeats { other_trajectory: 1, fresh_process: false, ..same };
        assert_eq!(late.failure(), None);
        assert!(late.unpaired().is_some_and(|why| why.starts_with("episodes depend on the order: 1 of 3")));
        assert!(late.line().is_some_and(|line| line.contains("The rate holds for these starts")));
        let samples = Repeats { other_actions: 3, ..same };
        assert_eq!((samples.failure(), samples.unpaired()), (None, None));
        assert!(samples.line().is_some_and(|line| line.contains("the environment repeats")));
    }
}
