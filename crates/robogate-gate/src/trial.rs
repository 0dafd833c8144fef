//! What the gate needs of a row.

use robogate_core::{Assignment, FailureMode, Fault, Outcome};
use robogate_dictionary::{Entry, Label};

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
    pub fn word(&self) -> &'static str {
        match self {
            Self::Success => "success",
            Self::Failure(Some(mode)) => mode.word(),
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
            Outcome::Failure(mode) => Self::Failure(Some(*mode)),
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
    /// The parameters asked for.
    pub requested: Assignment,
    /// How it ended.
    pub ending: Ending,
    /// How long it took, in simulated seconds; `None` where that was not recorded.
    pub time_s: Option<f64>,
    /// What its source does not record: any episode, a success too, may have been one of these.
    pub unseen: Vec<FailureMode>,
}

impl Trial {
    /// The trial of a row whose source does not record these modes of failure.
    pub fn of(entry: &Entry, unseen: &[FailureMode]) -> Self {
        let trial = Self::from(entry);
        let ending = match trial.ending {
            // An import has a failure of no known kind as a timeout.
            Ending::Failure(Some(FailureMode::Timeout)) if !unseen.is_empty() => Ending::Failure(None),
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
            unseen: Vec::new(),
        }
    }
}
