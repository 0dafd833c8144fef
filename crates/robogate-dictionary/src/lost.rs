//! Attempts to run an episode that an infrastructure fault lost.

use std::io;
use std::path::Path;

use serde::{Deserialize, Serialize};

use crate::read_regular_text;

/// An attempt to run an episode that a fault of the policy server, the simulator or the worker lost.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct LostEpisode {
    /// The index of the episode in the campaign.
    pub index: u64,
    /// The fault.
    pub fault: String,
    /// Whether the episode may have begun: the policy may have seen an observation of it.
    #[serde(default)]
    pub began: bool,
}

impl LostEpisode {
    /// The file of a run, with one JSON object per line.
    pub const FILE: &'static str = "lost_episodes.jsonl";

    /// The lost attempts of the run in `folder`.
    ///
    /// # Errors
    /// A file that cannot be read.
    pub fn all(folder: &Path) -> io::Result<Vec<Self>> {
        let path = folder.join(Self::FILE);
        if !path.exists() {
            return Ok(Vec::new());
        }
        Ok(Self::parse(&read_regular_text(&path)?))
    }

    /// The attempts in the text of such a file. A killed process may leave an incomplete last line, whose attempt is not known.
    pub fn parse(text: &str) -> Vec<Self> {
        text.lines().filter_map(|line| serde_json::from_str(line).ok()).collect()
    }
}
