//! The settings of the active stage.

use std::ops::Range;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// The plan of the active stage, which replaces the boundary stage.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ActiveStage {
    /// The largest number of episodes.
    pub episodes: u64,
    /// The growth of each round over the previous one. The first has half as many episodes as the uniform stage, at least 20.
    #[serde(default = "default_growth")]
    pub growth: f64,
    /// The share of each round that is sampled from the operating distribution, above 0 and at most 0.5.
    #[serde(default = "default_uniform_share")]
    pub uniform_share: f64,
    /// The number of candidates of which each episode chooses one.
    #[serde(default = "default_candidates")]
    pub candidates: usize,
    /// Stop when the root mean square error of the model is at most this, with 95 % confidence. Absent: run all episodes.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub until_rms: Option<f64>,
    /// The share of each round that measures this error. Without `until_rms` it is not used.
    #[serde(default = "default_pair_share")]
    pub pair_share: f64,
    /// Sample where this failure mode is likely, instead of where the outcome is least certain.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub seek: Option<String>,
}

fn default_growth() -> f64 {
    1.5
}

fn default_uniform_share() -> f64 {
    0.5
}

fn default_candidates() -> usize {
    32
}

fn default_pair_share() -> f64 {
    0.3
}

/// The smallest first round. Fewer episodes teach a model nothing.
const SMALLEST_ROUND: u64 = 20;

/// Limits of the settings, with the reason for a rejection.
const MOST_CANDIDATES: usize = 10_000;

impl ActiveStage {
    /// The default settings with this number of episodes.
    pub fn new(episodes: u64) -> Self {
        Self {
            episodes,
            growth: default_growth(),
            uniform_share: default_uniform_share(),
            candidates: default_candidates(),
            until_rms: None,
            pair_share: default_pair_share(),
            seek: None,
        }
    }

    /// The same stage, which samples where this failure mode is likely. A rare mode needs more candidates, so that some of
    /// them are likely to fail in this way.
    #[must_use]
    pub fn seeking(self, mode: &str) -> Self {
        Self { seek: Some(mode.to_owned()), candidates: 256, uniform_share: 0.3, ..self }
    }

    /// The setting that is out of range, its value and the expected range.
    pub(crate) fn problem(&self) -> Option<(&'static str, f64, &'static str)> {
        let within = |x: f64, low: f64, high: f64| x > low && x <= high;
        let until = self.until_rms.unwrap_or(0.1);
        let checks = [
            (within(self.growth, 0.999, 100.0), "active.growth", self.growth, "a number from 1 to 100"),
            (
                within(self.uniform_share, 0.0, 0.5),
                "active.uniform_share",
                self.uniform_share,
                "a number above 0 and at most 0.5",
            ),
            (
                (2..=MOST_CANDIDATES).contains(&self.candidates),
                "active.candidates",
                self.candidates as f64,
                "an integer from 2 to 10000",
            ),
            (within(until, 0.0, 0.5), "active.until_rms", until, "a number above 0 and at most 0.5"),
            (
                within(self.pair_share, 0.0, 0.5),
                "active.pair_share",
                self.pair_share,
                "a number above 0 and at most 0.5",
            ),
        ];
        checks.into_iter().find(|(valid, ..)| !valid).map(|(_, key, value, expected)| (key, value, expected))
    }

    /// The indices of each round, after a uniform stage of this many episodes.
    pub fn rounds(&self, uniform: u64) -> Vec<Range<u64>> {
        let mut rounds = Vec::new();
        let (mut first, end) = (uniform, uniform + self.episodes);
        let mut size = uniform.div_ceil(2).max(SMALLEST_ROUND);
        while first < end {
            let next = end.min(first.saturating_add(size));
            rounds.push(first..next);
            first = next;
            // Far below 2^53.
            size = ((size as f64 * self.growth).ceil() as u64).max(size);
        }
        rounds
    }

    /// The episodes of a round that belong to pairs: the first ones, an even number.
    pub(super) fn pairs(&self, round: &Range<u64>) -> u64 {
        match self.until_rms {
            // A share of at most 0.5 of a count far below 2^53.
            Some(_) => 2 * (0.5 * self.pair_share * (round.end - round.start) as f64).round() as u64,
            None => 0,
        }
    }
}
