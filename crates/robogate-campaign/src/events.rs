//! What happens in a campaign, in one stream: progress bar, JSON lines and whoever else listens get the
//! same. There is no clock in it; a listener that wants rates has one of its own.

use robogate_core::{Episode, Outcome};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::{BoundaryReport, OutcomeCounts, Stage, Summary};

/// Something that happened. Written as JSON, its name is in the field `event`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(tag = "event", rename_all = "snake_case")]
pub enum Event {
    /// A run begins, or goes on.
    Started {
        /// Episodes of all stages.
        episodes: u64,
        /// How many of them an earlier process has recorded.
        already_done: u64,
        /// Threads that will run them.
        threads: usize,
    },
    /// A stage begins, or goes on.
    StageStarted {
        /// The stage.
        stage: Stage,
        /// Its episodes.
        episodes: u64,
        /// How those went that an earlier process has recorded.
        already_done: OutcomeCounts,
    },
    /// An episode was run and recorded. They come in the order in which they finish.
    Episode {
        /// Its stage.
        stage: Stage,
        /// Its index in the campaign.
        index: u64,
        /// `success`, the failure mode, or `invalid`.
        outcome: String,
        /// Why it is invalid.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        fault: Option<String>,
        /// When it was decided, in simulated seconds.
        time_s: f64,
        /// Control ticks run.
        ticks: u32,
    },
    /// A stage is complete.
    StageFinished {
        /// The stage.
        stage: Stage,
        /// How its episodes went.
        outcomes: OutcomeCounts,
    },
    /// The first stage shows where success turns into failure.
    BoundaryFound {
        /// What was found.
        boundary: BoundaryReport,
    },
    /// Something that a person should know; the run goes on.
    Warning {
        /// What it is.
        warning: Warning,
        /// The same in words.
        message: String,
    },
    /// The run was stopped; it can be resumed.
    Interrupted {
        /// Episodes that are recorded.
        done: u64,
        /// Episodes of all stages.
        episodes: u64,
    },
    /// The run is complete and its files are there.
    Finished {
        /// Whether it was so before: then nothing was done.
        already: bool,
        /// What came of it.
        summary: Box<Summary>,
    },
}

impl Event {
    pub(crate) fn episode(stage: Stage, episode: &Episode) -> Self {
        Self::Episode {
            stage,
            index: episode.scenario.index,
            outcome: episode.outcome.as_str().to_owned(),
            fault: match &episode.outcome {
                Outcome::Invalid(fault) => Some(fault.to_string()),
                _ => None,
            },
            time_s: episode.time_s,
            ticks: episode.ticks,
        }
    }

    pub(crate) fn warning(warning: Warning) -> Self {
        Self::Warning { message: warning.to_string(), warning }
    }
}

/// Something that a person should know.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema, thiserror::Error)]
#[serde(tag = "kind", rename_all = "snake_case")]
pub enum Warning {
    /// No evidence so far.
    #[error(
        "all {episodes} episodes so far are invalid, the first because of {first}\nhint: stop and mend this; the run goes on meanwhile"
    )]
    AllInvalid {
        /// Episodes so far.
        episodes: u64,
        /// Why the first one is invalid.
        first: String,
    },
    /// The first stage says nothing about the boundary.
    #[error(
        "no episode of the uniform stage is valid, so the boundary stage has nothing to go by and draws from its fallback ranges"
    )]
    NoEvidence,
    /// The process that ran before died while it recorded an episode.
    #[error(
        "the last record was unfinished ({bytes} bytes) and was cut off: its episode is run again, nothing else is lost"
    )]
    RecordCut {
        /// What was cut off.
        bytes: u64,
    },
}
