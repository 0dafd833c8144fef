//! What the gate needs of a row.

use robogate_core::{Assignment, FailureMode, Fault, Measures, Outcome};
use robogate_dictionary::{Entry, Label, SchemaVersion};

/// How an episode ended, as far as the gate asks.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Ending {
    /// The task was done.
    Success,
    /// The policy failed; `None` where it is not known in which way (others' results often keep only success).
    Failure(Option<FailureMode>),
    /// Nothing can be said about the policy.
    Invalid(Fault),
}

impl Ending {
    /// `success`, the failure mode, `failure` or `invalid`.
    pub fn as_str(&self) -> &'static str {
        match self {
            Self::Success => "success",
            Self::Failure(Some(mode)) => mode.as_str(),
            Self::Failure(None) => "failure",
            Self::Invalid(_) => "invalid",
        }
    }

    /// Whether it says anything about the policy.
    pub fn is_valid(&self) -> bool {
        !matches!(self, Self::Invalid(_))
    }
}

impl From<&Outcome> for Ending {
    fn from(outcome: &Outcome) -> Self {
        match outcome {
            Outcome::Success => Self::Success,
            Outcome::Failure(mode) => Self::Failure(Some(*mode).filter(|mode| *mode != FailureMode::UNKNOWN)),
            Outcome::Invalid(fault) => Self::Invalid(fault.clone()),
        }
    }
}

/// One episode, as the gate sees it.
#[derive(Debug, Clone, PartialEq)]
pub struct Trial {
    /// Its index in its campaign.
    pub index: u64,
    /// Its campaign's seed: two trials with the same seed, index and parameters met the same world.
    pub seed: u64,
    /// Its place in a suite; empty where it was drawn from a parameter space.
    pub label: Label,
    /// The requested parameters.
    pub requested: Assignment,
    /// How it ended.
    pub ending: Ending,
    /// How long it took, in simulated seconds; `None` where that was not recorded.
    pub time_s: Option<f64>,
    /// What was measured.
    pub measures: Measures,
    /// What its source does not record: any episode, a success too, may have been one of these.
    pub unseen: Vec<FailureMode>,
}

impl Trial {
    /// The trial of a row whose source does not record these modes of failure. Imports of version 0.1 hold a failure of
    /// unknown kind as a timeout.
    pub fn of(entry: &Entry, unseen: &[FailureMode], version: SchemaVersion) -> Self {
        let trial = Self::from(entry);
        let ending = match trial.ending {
            Ending::Failure(Some(FailureMode::TIMEOUT)) if !unseen.is_empty() && version.major < 2 => {
                Ending::Failure(None)
            }
            ending => ending,
        };
        Self { ending, unseen: unseen.to_vec(), ..trial }
    }
}

impl From<&Entry> for Trial {
    fn from(entry: &Entry) -> Self {
        let episode = &entry.episode;
        Self {
            index: entry.index(),
            seed: episode.scenario.seed.campaign_number(),
            label: entry.label.clone(),
            requested: episode.scenario.requested.clone(),
            ending: Ending::from(&episode.outcome),
            time_s: Some(episode.time_s).filter(|t| t.is_finite() && *t >= 0.0),
            measures: episode.measures.clone(),
            unseen: Vec::new(),
        }
    }
}
