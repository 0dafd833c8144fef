//! Claims of the headline, as data: failure regions, and advice that the figures support.
//!
//! A claim names a parameter only if its effect is significant ([`crate::Effects`]), so that noise alone names something
//! in at most 2.5 % of all reports.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::effects::EffectShape;
use crate::replay::ReplayReason;
use crate::{Analysis, Population};

/// Maximum number of failure regions.
const MAX_REGIONS: usize = 3;
/// Invalid episodes come first in the advice if there is more than one of them per this many valid ones.
const VALID_PER_INVALID: u64 = 50;

/// The claims that the headline may state.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Claims {
    /// Where the policy fails more often than elsewhere: the parameters with a significant effect, the most influential
    /// first.
    pub failure_regions: Vec<FailureRegion>,
    /// Pairs of parameters with a significant interaction.
    pub interactions: Vec<[String; 2]>,
    /// Recommendations, the most urgent first.
    pub advice: Vec<Advice>,
}

/// The values of one parameter for which the policy fails more often.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct FailureRegion {
    /// The parameter.
    pub parameter: String,
    /// Share of the variance of the outcome that the parameter explains alone.
    pub influence: f64,
    /// p-value of the effect, adjusted for everything that the headline could have named.
    pub adjusted_p: f64,
    /// Where the rate is low and where it is high.
    pub shape: EffectShape,
}

/// A recommendation.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case", tag = "kind")]
pub enum Advice {
    /// No episode is valid: find the cause.
    ExplainInvalid,
    /// More than 2 % of the episodes are invalid: investigate them first.
    ReduceInvalid {
        /// Invalid episodes.
        invalid: u64,
    },
    /// The whole space reaches the target rate.
    WholeSpace {
        /// The target rate.
        target: f64,
    },
    /// Operate in the verified box of the analysis.
    Operate {
        /// The target rate.
        target: f64,
    },
    /// A box probably reaches the target rate. Verify it with more episodes.
    RunMore {
        /// The target rate.
        target: f64,
        /// The estimated number of further episodes.
        episodes: u64,
    },
    /// No box of at most three parameters was found that reaches the target rate.
    NoBox {
        /// The target rate.
        target: f64,
    },
    /// These parameters are sampled jointly, so the effect of one may be caused by another.
    Joint {
        /// The parameters.
        parameters: Vec<String>,
    },
    /// Replay the failures that the risk model did not expect.
    Replay {
        /// The first of them.
        episode: u64,
    },
}

pub(crate) fn claims(analysis: &Analysis) -> Claims {
    Claims {
        failure_regions: failure_regions(analysis),
        interactions: analysis.effects.interactions.iter().take(2).map(|pair| pair.parameters.clone()).collect(),
        advice: advice(analysis),
    }
}

fn failure_regions(analysis: &Analysis) -> Vec<FailureRegion> {
    let region = |effect: &crate::ParameterEffect| {
        Some(FailureRegion {
            parameter: effect.parameter.clone(),
            influence: effect.influence,
            adjusted_p: effect.adjusted_p,
            shape: effect.shape.estimated()?.clone(),
        })
    };
    analysis.effects.significant().filter_map(region).take(MAX_REGIONS).collect()
}

fn advice(analysis: &Analysis) -> Vec<Advice> {
    let rate = &analysis.success.rate;
    if rate.n == 0 {
        return vec![Advice::ExplainInvalid];
    }
    let mut advice = Vec::new();
    let invalid = analysis.success.bounds.invalid;
    let many_invalid = invalid * VALID_PER_INVALID > rate.n;
    if many_invalid {
        advice.push(Advice::ReduceInvalid { invalid });
    }
    // A box of valid episodes says nothing about starts that make episodes invalid.
    if let Some(found) = analysis.safe_box.estimated().filter(|_| !many_invalid) {
        let target = found.target;
        advice.push(match (found.verified, found.limits.is_empty(), found.more_episodes) {
            (true, true, _) => Advice::WholeSpace { target },
            (true, false, _) => Advice::Operate { target },
            (false, _, Some(episodes)) => Advice::RunMore { target, episodes },
            (false, _, None) => Advice::NoBox { target },
        });
    }
    let parameters = analysis.jointly_sampled();
    if !parameters.is_empty() && analysis.population != Population::Suite {
        advice.push(Advice::Joint { parameters });
    }
    // Without an effect, the risk model expects nothing in particular.
    let unexpected = analysis.replay.iter().find(|group| group.reason == ReplayReason::UnexpectedFailure);
    let named = analysis.effects.significant().next().is_some();
    if let (Some(first), true) = (unexpected.and_then(|g| g.episodes.first()), analysis.subject.replayable && named) {
        advice.push(Advice::Replay { episode: first.index });
    }
    advice
}
