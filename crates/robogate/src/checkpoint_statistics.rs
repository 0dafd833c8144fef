//! The statistics of a checkpoint on the command line.

use std::path::PathBuf;

use anyhow::Context;
use clap::Args;
use robogate_core::Observation;
use robogate_dictionary::read_text;
use robogate_policy::{Profile, Statistics, state_sizes};

use crate::exit::{Exit, OrExit};
use crate::policy_source::policy_error;

/// The statistics that are published with a checkpoint.
#[derive(Debug, Clone, Default, Args)]
pub(crate) struct CheckpointStatistics {
    /// Read the range of each state in the training data from the statistics that are published with the checkpoint:
    /// openpi's norm_stats.json, OpenVLA's dataset_statistics.json, GR00T's statistics.json or LeRobot's stats.json.
    /// A run counts the states outside of it
    #[arg(long, value_name = "FILE")]
    statistics: Option<PathBuf>,
    /// Choose the training set or the embodiment in that file, if it has several
    #[arg(long, value_name = "NAME", requires = "statistics")]
    statistics_group: Option<String>,
}

impl CheckpointStatistics {
    /// Whether a file is given.
    pub(crate) fn is_given(&self) -> bool {
        self.statistics.is_some()
    }

    /// The profile with the ranges of the file, if one is given. The observation shows how many numbers each state has.
    pub(crate) fn add_to(&self, profile: &Profile, observation: &Observation) -> Result<Profile, Exit> {
        let Some(path) = &self.statistics else { return Ok(profile.clone()) };
        let sizes = state_sizes(profile, observation).map_err(policy_error)?;
        let place = || format!("--statistics {}", path.display());
        let text = read_text(path).with_context(place).or_usage()?;
        let group = self.statistics_group.as_deref();
        let ranged = Statistics::from_json(&text, group).and_then(|statistics| statistics.apply(profile, &sizes));
        ranged.with_context(place).or_usage()
    }
}
