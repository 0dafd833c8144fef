//! The controls of a gate: runs that show whether an episode of this policy could be judged at all.
//!
//! As in a laboratory assay, a *positive control* must succeed: an expert acts through the profile of the policy. A
//! *negative control* must not: random actions in the same space. If a control fails, the episodes say nothing about the
//! policy, and the verdict is invalid evidence, never a failure.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::Repeats;

/// Number of episodes of a control and their successes.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ControlResult {
    /// Number of valid episodes.
    pub episodes: u64,
    /// Number of successes.
    pub successes: u64,
    /// Number of invalid episodes.
    pub invalid: u64,
}

/// A step of the profile that differs from the published conventions of the model.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ControlProblem {
    /// The step, for example `action scale` or `gripper sign`.
    pub step: String,
    /// The difference, with the field of the profile.
    pub detail: String,
}

/// The controls of a gate.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Controls {
    /// Why there are no controls: they were skipped, or there is no expert. Empty if they ran.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub without: String,
    /// The profile with the published conventions, with which the expert's actions are encoded. Empty for a policy without a
    /// profile.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub reference: String,
    /// Whether episodes repeat. `None` if this was not tried.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub repeats: Option<Repeats>,
    /// The expert without the profile: the known success rate.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub expert: Option<ControlResult>,
    /// The positive control: the expert through the profile.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub positive: Option<ControlResult>,
    /// The negative control: random actions in the space of the model.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub negative: Option<ControlResult>,
    /// Steps of the profile that differ from the published conventions.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub problems: Vec<ControlProblem>,
}

/// The share of the expert's own successes that the positive control must reach.
const REQUIRED_SHARE: f64 = 0.8;

impl Controls {
    /// The number of successes that the positive control must reach.
    fn required(&self) -> u64 {
        let known = self.expert.map_or(0, |expert| expert.successes);
        ((known as f64 * REQUIRED_SHARE).ceil() as u64).max(1)
    }

    /// Why the episodes of this gate cannot be judged, in one sentence that names the step. `None` if no control failed.
    pub fn failure(&self) -> Option<String> {
        if let Some(why) = self.repeats.and_then(|repeats| repeats.failure()) {
            return Some(why);
        }
        if !self.problems.is_empty() {
            let steps: Vec<String> =
                self.problems.iter().map(|problem| format!("{}: {}", problem.step, problem.detail)).collect();
            return Some(format!("the positive control failed: {}", steps.join("; ")));
        }
        let (expert, positive, negative) = (self.expert?, self.positive?, self.negative?);
        if positive.successes < self.required() {
            return Some(format!(
                "the positive control failed: the expert succeeds in {} of {} episodes, but through the profile in {} of {}. \
                 Its conventions are those of {}, so the cause is the action space: scale, limits, control rate or gripper",
                expert.successes, expert.episodes, positive.successes, positive.episodes, self.reference
            ));
        }
        (negative.successes >= self.required()).then(|| {
            format!(
                "the negative control failed: random actions succeed in {} of {} episodes",
                negative.successes, negative.episodes
            )
        })
    }

    /// One line for each control, for reports.
    pub fn lines(&self) -> Vec<String> {
        let count = |result: ControlResult| {
            let invalid = if result.invalid > 0 { format!(", {} invalid", result.invalid) } else { String::new() };
            format!("{} of {} episodes{invalid}", result.successes, result.episodes)
        };
        let mut lines = Vec::new();
        if !self.without.is_empty() {
            lines.push(format!("Controls: none. {}", self.without));
        }
        if let (Some(expert), Some(positive)) = (self.expert, self.positive) {
            lines.push(format!(
                "Positive control: the expert, acting through the profile with the conventions of {}, succeeds in {}; \
                 acting directly, in {}",
                self.reference,
                count(positive),
                count(expert)
            ));
        }
        if let Some(negative) = self.negative {
            lines.push(format!("Negative control: random actions of the model succeed in {}", count(negative)));
        }
        lines.extend(self.problems.iter().map(|problem| format!("Control, {}: {}", problem.step, problem.detail)));
        lines.extend(self.repeats.and_then(|repeats| repeats.line()));
        lines.extend(self.repeats.and_then(|repeats| repeats.seeds_line()));
        lines
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ran(expert: u64, positive: u64, negative: u64) -> Controls {
        let of = |successes| Some(ControlResult { episodes: 5, successes, invalid: 0 });
        Controls { expert: of(expert), positive: of(positive), negative: of(negative), ..Controls::default() }
    }

    #[test]
    fn failed_controls_are_sentences() {
        assert_eq!(ran(5, 5, 0).failure(), None);
        assert_eq!(ran(5, 4, 1).failure(), None);
        assert!(ran(5, 3, 0).failure().is_some_and(|why| why.contains("through the profile in 3 of 5")));
        assert!(ran(5, 5, 4).failure().is_some_and(|why| why.contains("random actions succeed in 4 of 5")));
        assert_eq!(Controls { without: "skipped".to_owned(), ..Controls::default() }.failure(), None);
        let problem = ControlProblem { step: "action scale".to_owned(), detail: "twice as far".to_owned() };
        let wrong = Controls { problems: vec![problem], ..Controls::default() };
        assert_eq!(wrong.failure().as_deref(), Some("the positive control failed: action scale: twice as far"));
    }
}
