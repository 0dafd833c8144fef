//! Whether episodes repeat: the same scenarios run in two processes of the environment, in two orders, with the same actions.
//!
//! An episode should follow from its seed and its parameters. If the start of an episode also depends on the episodes before it or
//! on the process, the rows do not describe what ran, and a later episode may depend on an earlier one: then they are no evidence.
//! The same holds if earlier episodes decide how one ends. If only later bits of a trajectory differ, or if a difference is noise, the
//! rate still holds, but two policies cannot be paired.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// How many of the episodes that ran twice were different. The second time, each ran with the actions of the first.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Repeats {
    /// Number of episodes that ran twice.
    pub episodes: u64,
    /// Whether they ran in two processes. Otherwise both times in the same one, in two orders.
    pub fresh_process: bool,
    /// Number of them with another start.
    pub other_start: u64,
    /// Number of them with the same start and, after the same actions, another trajectory or ending.
    pub other_trajectory: u64,
    /// Number of those of `other_trajectory` with another outcome or another duration.
    #[serde(default)]
    pub other_ending: u64,
    /// Whether the same differences came again, in the same order or in the same process: then noise does not explain them.
    #[serde(default)]
    pub systematic: bool,
    /// Number of them in which the policy acted in another way, although the environment repeats.
    #[serde(default)]
    pub other_actions: u64,
    /// Whether an episode with another seed was the same: start, trajectory and ending.
    #[serde(default)]
    pub seeds_without_effect: bool,
}

impl Repeats {
    /// Both results together. The processes, and whether seeds have an effect, are those of the first.
    #[must_use]
    pub fn and(self, other: Self) -> Self {
        Self {
            episodes: self.episodes.saturating_add(other.episodes),
            fresh_process: self.fresh_process,
            other_start: self.other_start.saturating_add(other.other_start),
            other_trajectory: self.other_trajectory.saturating_add(other.other_trajectory),
            other_ending: self.other_ending.saturating_add(other.other_ending),
            systematic: self.systematic || other.systematic,
            other_actions: self.other_actions.saturating_add(other.other_actions),
            seeds_without_effect: self.seeds_without_effect,
        }
    }

    /// What the episodes depend on beside their seeds.
    fn cause(&self) -> &'static str {
        if self.fresh_process { "the order or the process" } else { "the order" }
    }

    /// Why the episodes cannot be used as evidence. `None` if each seed gives the same start again, and earlier episodes do not
    /// decide how one ends.
    pub fn failure(&self) -> Option<String> {
        let Self { episodes, other_start, other_ending, .. } = self;
        let cause = self.cause();
        if *other_start > 0 {
            return Some(format!(
                "episodes depend on {cause}: {other_start} of {episodes} episodes that ran twice had another start with the same seed. \
                 Let the reset of the environment set everything that varies from its seed"
            ));
        }
        (self.systematic && *other_ending > 0).then(|| {
            format!(
                "episodes depend on {cause}: {other_ending} of {episodes} episodes that ran twice, from the same start with the same \
                 actions, ended in another way. The environment carries something from one episode to the next. Let its reset set \
                 everything that decides an episode"
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
        let Self { episodes, other_trajectory, other_ending, other_actions, .. } = self;
        if let Some(why) = self.failure() {
            return Some(format!("Repetition: {why}"));
        }
        if *other_trajectory > 0 {
            let ended = match other_ending {
                0 => String::new(),
                n => format!(", and {n} of them ended in another way"),
            };
            return Some(format!(
                "Repetition: episodes depend on {}. {other_trajectory} of {episodes} episodes that ran twice had the same start and \
                 another trajectory{ended}. The rate holds if that is noise which is new in each episode; a replay differs, and another \
                 policy cannot be compared episode by episode",
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

    /// That seeds have no effect, for reports. `None` if they have, or if this was not tried.
    pub fn seeds_line(&self) -> Option<String> {
        self.seeds_without_effect.then(|| {
            "Seeds: an episode with another seed had the same observations. If seeds have no effect, only parameters make episodes differ"
                .to_owned()
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
        assert!(late.line().is_some_and(|line| line.contains("The rate holds if that is noise")));
        let noise = Repeats { other_ending: 1, ..late };
        assert_eq!(noise.failure(), None);
        assert!(noise.line().is_some_and(|line| line.contains("1 of them ended in another way")));
        let carried = Repeats { systematic: true, ..noise };
        assert!(carried.failure().is_some_and(|why| why.contains("carries something from one episode to the next")));
        assert_eq!(Repeats { systematic: true, ..late }.failure(), None);
        let samples = Repeats { other_actions: 3, ..same };
        assert_eq!((samples.failure(), samples.unpaired()), (None, None));
        assert!(samples.line().is_some_and(|line| line.contains("the environment repeats")));
    }
}
