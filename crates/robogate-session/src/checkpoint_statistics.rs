//! The statistics of a checkpoint.

use std::path::PathBuf;

use anyhow::Context;
use robogate_core::Observation;
use robogate_dictionary::read_text;
use robogate_policy::{Profile, Statistics, state_sizes};

use crate::failure::{Failure, OrFailure};
use crate::policy_source::policy_error;

/// The statistics that are published with a checkpoint.
#[derive(Debug, Clone, Default)]
pub struct CheckpointStatistics {
    /// The file with the range of each state in the training data: openpi's `norm_stats.json`, OpenVLA's
    /// `dataset_statistics.json`, GR00T's `statistics.json` or LeRobot's `stats.json`.
    pub file: Option<PathBuf>,
    /// The training set or the embodiment in that file, if it has several.
    pub group: Option<String>,
}

impl CheckpointStatistics {
    /// Whether a file is given.
    pub fn is_given(&self) -> bool {
        self.file.is_some()
    }

    /// The profile with the ranges of the file, if one is given. The observation shows how many numbers each state has.
    pub fn add_to(&self, profile: &Profile, observation: &Observation) -> Result<Profile, Failure> {
        let Some(path) = &self.file else { return Ok(profile.clone()) };
        let sizes = state_sizes(profile, observation).map_err(policy_error)?;
        let place = || format!("--statistics {}", path.display());
        let text = read_text(path).with_context(place).or_request()?;
        let group = self.group.as_deref();
        let ranged = Statistics::from_json(&text, group).and_then(|statistics| statistics.apply(profile, &sizes));
        ranged.with_context(place).or_request()
    }
}
