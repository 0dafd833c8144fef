//! What the evidence says about each demand.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::{Baseline, Bound, ConfidenceScore, Population, Requirement, Requirements, Verdict};

/// How the number of episodes came about: it decides which test is valid.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Sampling {
    /// It was fixed before the first episode: exact binomial tests.
    Fixed,
    /// Somebody looked and decided whether to go on: anytime-valid tests, at the end of each round.
    Sequential,
}

/// What the evidence says about one demand.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Status {
    /// It holds.
    Met,
    /// It does not.
    Violated,
    /// Neither is shown.
    Undecided,
    /// There is no evidence about it.
    NoEvidence,
}

/// How many episodes there are.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct Counts {
    /// All that were judged.
    pub episodes: u64,
    /// Those that say something about the policy.
    pub valid: u64,
    /// Those that say nothing.
    pub invalid: u64,
    /// Whole rounds of the suite among them; absent without a suite.
    pub rounds: Option<u64>,
    /// Episodes after the last whole round, which are not judged.
    pub left_over: u64,
}

/// A figure over the valid episodes, and what it could have been.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Extremes {
    /// The figure; absent without a valid episode.
    pub observed: Option<f64>,
    /// The least and most it could be, whatever the invalid episodes could have been.
    pub possible: [f64; 2],
}

/// One demand and what the evidence says about it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Finding {
    /// Its name in reports: metric and scope.
    pub id: String,
    /// The demand.
    pub requirement: Requirement,
    /// The demand with its limit as a number.
    pub bound: Bound,
    /// Valid episodes in its scope.
    pub valid: u64,
    /// Invalid episodes in its scope.
    pub invalid: u64,
    /// The figure.
    pub figure: Extremes,
    /// Interval for the true figure at the requirements' confidence, for the worst and best that invalid episodes could
    /// have been; absent in point mode.
    pub interval: Option<[f64; 2]>,
    /// p-value against "the demand is not met", for the worst that invalid episodes could have been.
    pub p_met: Option<f64>,
    /// p-value against "the demand is met", for the best that they could have been.
    pub p_violated: Option<f64>,
    /// What follows.
    pub status: Status,
    /// Further episodes after which it would be decided if they went as those so far; absent where it is decided, or
    /// where no number would do.
    pub more_episodes: Option<u64>,
}

/// Success by scenario group, for reading; it decides nothing by itself.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct GroupResult {
    /// The category.
    pub category: String,
    /// The group.
    pub group: String,
    /// Valid episodes.
    pub valid: u64,
    /// Invalid episodes.
    pub invalid: u64,
    /// Successes.
    pub successes: u64,
    /// Exact (Clopper-Pearson) 95 % interval for the success rate.
    pub interval_95: [f64; 2],
    /// Failures by their word, the commonest first.
    pub failures: Vec<(String, u64)>,
}

/// Everything that the gate found: one versioned document.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Evaluation {
    /// Version of this form.
    pub format: u32,
    /// The answer.
    pub verdict: Verdict,
    /// Why, in a sentence.
    pub because: String,
    /// What the figures speak of.
    pub population: Population,
    /// How the number of episodes came about.
    pub sampling: Sampling,
    /// How many there are.
    pub counts: Counts,
    /// What was demanded.
    pub requirements: Requirements,
    /// What relative demands referred to.
    pub baseline: Option<Baseline>,
    /// What the evidence says about each demand.
    pub findings: Vec<Finding>,
    /// Success by scenario group.
    pub groups: Vec<GroupResult>,
    /// The confidence score; absent where the requirements have none.
    pub score: Option<ConfidenceScore>,
}
