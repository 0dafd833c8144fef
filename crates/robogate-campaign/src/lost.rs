//! Episodes that ran again.

use std::collections::BTreeSet;

use robogate_dictionary::LostEpisode;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Episodes of a campaign that ran more than once, because infrastructure faults lost earlier attempts.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct RunAgain {
    /// The number of episodes that lost at least one attempt.
    pub episodes: u64,
    /// The number of lost attempts.
    pub lost_attempts: u64,
    /// The fault of the first lost attempt.
    pub first_fault: String,
}

impl RunAgain {
    /// Counts the lost attempts of a run. `None` if there were none.
    pub(crate) fn of(lost: &[LostEpisode]) -> Option<Self> {
        let episodes: BTreeSet<u64> = lost.iter().map(|attempt| attempt.index).collect();
        lost.first().map(|first| Self {
            episodes: episodes.len() as u64,
            lost_attempts: lost.len() as u64,
            first_fault: first.fault.clone(),
        })
    }
}
