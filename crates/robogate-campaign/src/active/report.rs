//! The report on the models of the active stage.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// A report on the active stage, in `active.json`.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ActiveReport {
    /// The version of the file format.
    pub version: u32,
    /// The rounds in order. The last entry, without episodes, describes the model of all episodes.
    pub rounds: Vec<ActiveRound>,
}

impl ActiveReport {
    /// The version of the file format that is written.
    pub const VERSION: u32 = 1;

    /// The report on these rounds.
    pub(crate) fn of(rounds: Vec<ActiveRound>) -> Self {
        Self { version: Self::VERSION, rounds }
    }
}

/// The model that chose the episodes of a round.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ActiveRound {
    /// The number of episodes of the round.
    pub episodes: u64,
    /// The number of episodes to which the model was fitted.
    pub trained_on: u64,
    /// The scores of the model in cross-validation. Absent if there were too few failures or successes: then the round is
    /// uniform.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub model: Option<ModelScore>,
    /// The reason why no model could be fitted, if it was another one. Then the round is uniform as well.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub problem: Option<String>,
    /// The error of the model, if the plan measures it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub certificate: Option<Certificate>,
}

/// Scores of a model in cross-validation. It knows the hidden draws of the episodes, if the task declares any.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ModelScore {
    /// Share of the boosting in the model; the rest is logistic regression on splines.
    pub boosting_share: f64,
    /// Brier score.
    pub brier: f64,
    /// Mean log loss.
    pub log_loss: f64,
}

/// The error of the model of the parameters, averaged over hidden draws, from pairs that it has not seen.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Certificate {
    /// The number of pairs.
    pub pairs: u64,
    /// Estimate of the mean squared error. It may be negative by chance.
    pub mean_square: f64,
    /// Upper bound of the root mean square error. All bounds of the campaign hold with 95 % confidence.
    pub rms_bound: f64,
    /// Estimate of the mean of p(1 - p), the noise that no model of the parameters can explain.
    pub noise: f64,
    /// Whether the bound reaches the error of the plan.
    pub reached: bool,
}
