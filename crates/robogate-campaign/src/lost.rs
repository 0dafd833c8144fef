//! Attempts to run an episode that an infrastructure fault lost.

use std::collections::BTreeSet;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::RunError;
use crate::folder::{Folder, LOST};

/// An attempt to run an episode that a fault of the policy server, the simulator or the worker lost.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct LostEpisode {
    /// The index of the episode in the campaign.
    pub index: u64,
    /// The fault.
    pub fault: String,
}

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
    pub(crate) fn of(folder: &Folder) -> Result<Option<Self>, RunError> {
        if !folder.has(LOST) {
            return Ok(None);
        }
        let path = folder.path(LOST);
        let text = std::fs::read_to_string(&path).map_err(RunError::io(&path, "read"))?;
        // A killed process may leave an incomplete last line. The attempt was lost in any case.
        let lost: Vec<LostEpisode> = text.lines().filter_map(|line| serde_json::from_str(line).ok()).collect();
        let episodes: BTreeSet<u64> = lost.iter().map(|attempt| attempt.index).collect();
        Ok(lost.first().map(|first| Self {
            episodes: episodes.len() as u64,
            lost_attempts: lost.len() as u64,
            first_fault: first.fault.clone(),
        }))
    }
}
