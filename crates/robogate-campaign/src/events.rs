//! Events of a campaign: one stream for the progress bar, JSON lines and other listeners.
//!
//! Events have no time stamp. A listener that computes rates uses its own clock.

use robogate_core::{Episode, Outcome};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::{BoundaryReport, OutcomeCounts, Stage, Summary};

/// An event of a campaign. In JSON, the field `event` has its name.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(tag = "event", rename_all = "snake_case")]
pub enum Event {
    /// A run starts or resumes.
    Started {
        /// Episodes of all stages.
        episodes: u64,
        /// The number of episodes recorded by earlier processes.
        already_done: u64,
        /// The number of threads that run episodes.
        threads: usize,
    },
    /// A stage starts or resumes.
    StageStarted {
        /// The stage.
        stage: Stage,
        /// Episodes of the stage.
        episodes: u64,
        /// Outcomes of the episodes recorded by earlier processes.
        already_done: OutcomeCounts,
    },
    /// An episode ran and was recorded. Events arrive in the order in which episodes finish.
    Episode {
        /// The stage of the episode.
        stage: Stage,
        /// The index of the episode in the campaign.
        index: u64,
        /// `success`, the failure mode, or `invalid`.
        outcome: String,
        /// The fault of an invalid episode.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        fault: Option<String>,
        /// Simulated time of the decisive event, in seconds.
        time_s: f64,
        /// The number of control periods that ran.
        ticks: u32,
    },
    /// A stage is complete.
    StageFinished {
        /// The stage.
        stage: Stage,
        /// The outcomes of its episodes.
        outcomes: OutcomeCounts,
    },
    /// The first stage found the boundary between success and failure.
    BoundaryFound {
        /// The boundary report.
        boundary: BoundaryReport,
    },
    /// A condition that the user should know about. The run continues.
    Warning {
        /// The warning as data.
        warning: Warning,
        /// The warning as text.
        message: String,
    },
    /// The run was stopped. It can be resumed.
    Interrupted {
        /// The number of recorded episodes.
        done: u64,
        /// Episodes of all stages.
        episodes: u64,
    },
    /// The run is complete and all files are written.
    Finished {
        /// Whether the run was already complete and nothing was done.
        already: bool,
        /// The summary of the campaign.
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

/// A condition that the user should know about.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema, thiserror::Error)]
#[serde(tag = "kind", rename_all = "snake_case")]
pub enum Warning {
    /// All episodes so far are invalid.
    #[error(
        "all {episodes} episodes so far are invalid, the first because of {first}\nHint: the run continues. Stop it with Ctrl-C, fix the cause and start a new run"
    )]
    AllInvalid {
        /// The number of episodes so far.
        episodes: u64,
        /// The fault of the first one.
        first: String,
    },
    /// More than half of the episodes so far are invalid.
    #[error(
        "{invalid} of {episodes} episodes so far are invalid, the first because of {first}\nHint: the run continues. Stop it with Ctrl-C, fix the cause and start a new run"
    )]
    MostlyInvalid {
        /// The number of episodes so far.
        episodes: u64,
        /// The number of invalid episodes among them.
        invalid: u64,
        /// The fault of the first of these.
        first: String,
    },
    /// The first stage has no valid episodes.
    #[error(
        "no episode of the uniform stage is valid, so no boundary is known; the boundary stage samples its fallback ranges"
    )]
    NoEvidence,
    /// An earlier process was killed while it recorded an episode.
    #[error(
        "the last record of the journal was incomplete ({bytes} bytes) and was removed: its episode runs again, all others are intact"
    )]
    RecordCut {
        /// The number of removed bytes.
        bytes: u64,
    },
}
