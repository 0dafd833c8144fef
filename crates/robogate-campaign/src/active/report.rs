//! The report on the models of the active stage.

use robogate_stats::Confidence;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// A report on the active stage, in `active.json`.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ActiveReport {
    /// The version of the file format.
    pub version: u32,
    /// The rounds in order. The last entry, without episodes, describes the model of all episodes.
    pub rounds: Vec<ActiveRound>,
    /// Whether the prior helped, over all rounds. Absent without a prior, or without episodes that show it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub prior: Option<PriorResult>,
}

impl ActiveReport {
    /// The version of the file format that is written.
    pub const VERSION: u32 = 1;

    /// The report on these rounds.
    pub(crate) fn of(rounds: Vec<ActiveRound>) -> Self {
        let prior = PriorResult::of(&rounds);
        Self { version: Self::VERSION, rounds, prior }
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
    /// Whether the prior helped to predict the round before this one. Absent without a prior, and in the first round.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub prior: Option<PriorRound>,
}

/// The log loss of two models on the uniform episodes of a round, fitted before it with and without the prior. A model without
/// the prior that cannot be fitted yet predicts the success rate so far.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct PriorRound {
    /// The number of these episodes.
    pub episodes: u64,
    /// The slope of the prior in the model. 0 if cross-validation did not choose it.
    pub slope: f64,
    /// Mean log loss with the prior.
    pub with: f64,
    /// Mean log loss without it.
    pub without: f64,
    /// Standard error of the mean difference.
    pub se: f64,
}

/// Whether the prior helped: the log loss over the uniform episodes of all rounds.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct PriorResult {
    /// The number of these episodes.
    pub episodes: u64,
    /// Mean log loss with the prior.
    pub with: f64,
    /// Mean log loss without it.
    pub without: f64,
    /// 95 % interval of the loss without the prior minus that with it.
    pub gain_95: [f64; 2],
    /// The decision.
    pub effect: PriorEffect,
}

/// The effect of a prior on the predictions.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum PriorEffect {
    /// The predictions are significantly better with the prior.
    Helped,
    /// The losses do not differ significantly.
    NoDifference,
    /// The predictions are significantly worse with the prior.
    Hurt,
}

impl PriorResult {
    /// Pools the rounds, weighted by their episodes. The models of a round follow from earlier episodes, so the differences of
    /// rounds are uncorrelated. The interval is the normal one.
    fn of(rounds: &[ActiveRound]) -> Option<Self> {
        let rounds: Vec<PriorRound> = rounds.iter().filter_map(|round| round.prior).collect();
        let episodes: u64 = rounds.iter().map(|round| round.episodes).sum();
        let mean = |of: fn(&PriorRound) -> f64| {
            rounds.iter().map(|round| round.episodes as f64 * of(round)).sum::<f64>() / episodes as f64
        };
        let (with, without) = (mean(|round| round.with), mean(|round| round.without));
        let variance: f64 = rounds.iter().map(|round| (round.episodes as f64 * round.se).powi(2)).sum();
        let half = Confidence::P95.z() * variance.sqrt() / episodes as f64;
        let gain_95 = [without - with - half, without - with + half];
        let effect = match gain_95 {
            [low, _] if low > 0.0 => PriorEffect::Helped,
            [_, high] if high < 0.0 => PriorEffect::Hurt,
            _ => PriorEffect::NoDifference,
        };
        (episodes > 0).then_some(Self { episodes, with, without, gain_95, effect })
    }
}

/// Scores of a model in cross-validation, told the hidden draws.
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
