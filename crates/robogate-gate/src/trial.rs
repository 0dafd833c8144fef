//! The part of a row that the gate uses.

use robogate_core::{Assignment, FailureMode, Fault, Measures, Outcome, Word};
use robogate_dictionary::{Entry, Label};

/// How an episode ended.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Ending {
    /// Success.
    Success,
    /// Failure. The mode is `None` if it is unknown (imported results often record only success).
    Failure(Option<FailureMode>),
    /// Invalid: no information about the policy.
    Invalid(Fault),
}

impl Ending {
    /// The name: `success`, the failure mode, `failure` or `invalid`.
    pub fn as_str(&self) -> &'static str {
        match self {
            Self::Success => "success",
            Self::Failure(Some(mode)) => mode.as_str(),
            Self::Failure(None) => "failure",
            Self::Invalid(_) => "invalid",
        }
    }

    /// Whether the episode is valid.
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

/// One episode.
#[derive(Debug, Clone, PartialEq)]
pub struct Trial {
    /// Its index in its campaign.
    pub index: u64,
    /// Its campaign's seed. Two trials with equal seed, index and parameters had the same scenario.
    pub seed: u64,
    /// Its scenario in a suite. Empty if it was sampled from a parameter space.
    pub label: Label,
    /// The requested parameters.
    pub requested: Assignment,
    /// How the episode ended.
    pub ending: Ending,
    /// Its duration in simulated seconds. `None` if it was not recorded.
    pub time_s: Option<f64>,
    /// Its measures.
    pub measures: Measures,
    /// Hash of its trajectory. `None` if it was not recorded.
    pub trajectory: Option<u64>,
    /// Failure modes that its source does not record. Any episode, even a success, may have been one of these.
    pub unseen: Vec<FailureMode>,
    /// The number of its group in each division of imported episodes that depend on each other ([`crate::RowGroups`]).
    pub groups: Vec<usize>,
    /// Whether a contact exceeds each force limit of the requirements. `None` if the forces are unknown.
    pub forces: Vec<(Word, Option<bool>)>,
}

impl Trial {
    /// The trial of a row whose source does not record these failure modes.
    pub fn of(entry: &Entry, unseen: &[FailureMode]) -> Self {
        Self { unseen: unseen.to_vec(), ..Self::from(entry) }
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
            trajectory: Some(episode.trajectory_hash).filter(|hash| *hash != 0),
            unseen: Vec::new(),
            groups: Vec::new(),
            forces: Vec::new(),
        }
    }
}
