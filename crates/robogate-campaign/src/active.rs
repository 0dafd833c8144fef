//! The active stage: rounds that sample where the outcome is least certain.
//!
//! The uniform stage comes first. Then each round fits a risk model to all episodes so far, and samples the next ones.
//! Episode i, whose seed determines its hidden draws, chooses one of M candidates from the operating distribution. It
//! chooses candidate j with the probability
//!
//! ```text
//! pi_j = a/M + (1 - a) s_j / (s_1 + ... + s_M),   s = p (1 - p),
//! ```
//!
//! with the predicted chance of success p of the candidate's parameters *and the draws of this episode*, and the uniform
//! share a. Its weight is 1/(M pi_j), at most 1/a. Given everything before, the expected value of weight times outcome is
//! the mean outcome over the operating distribution, so weighted means are unbiased, although the model depends on earlier
//! outcomes. Source: sampling-importance-resampling (Rubin 1987) with one draw per set of candidates; defensive mixtures
//! (Hesterberg 1995).
//!
//! If the plan states an error of the model ([`ActiveStage::until_rms`]), a share of each round are pairs: two episodes
//! with the same parameters, from the operating distribution, and different seeds. Pairs never enter the model. They bound
//! its error ([`robogate_stats::model_error`]), and the stage ends when the bound reaches the stated error.
//!
//! The points of a round depend on the plan and on the recorded episodes of earlier rounds only, so a run that was
//! interrupted chooses the same ones.

use std::collections::BTreeMap;
use std::ops::Range;
use std::sync::Arc;

use robogate_core::{Assignment, Foresight, Outcome, ParameterSpace, Scenario, Seed, samplers};
use robogate_dictionary::Entry;
use robogate_risk::{Inputs, Learner, RiskError, RiskModel, Sample};
use robogate_stats::model_error::{Pair, model_error};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::{Plan, RunError};

/// The design of episodes that the model selected.
const ACTIVE: &str = "active";
/// The design of pairs for the error of the model.
pub(crate) const PAIR: &str = "pair";
/// Fresh draws over which the model is averaged where its error is measured.
const DRAWS: u64 = 32;
/// Probability that any of the bounds of a campaign fails.
const ALPHA: f64 = 0.05;

/// The plan of the active stage, which replaces the boundary stage.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ActiveStage {
    /// The largest number of episodes.
    pub episodes: u64,
    /// The growth of each round over the previous one. The first has half as many episodes as the uniform stage.
    #[serde(default = "default_growth")]
    pub growth: f64,
    /// The share of the operating distribution in the mixture from which episodes are sampled, above 0 and at most 0.5.
    #[serde(default = "default_uniform_share")]
    pub uniform_share: f64,
    /// The number of candidates of which each episode chooses one.
    #[serde(default = "default_candidates")]
    pub candidates: usize,
    /// Stop when the root mean square error of the model is at most this, with 95 % confidence. Absent: run all episodes.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub until_rms: Option<f64>,
    /// The share of each round that measures this error. Without `until_rms` it is not used.
    #[serde(default = "default_pair_share")]
    pub pair_share: f64,
}

fn default_growth() -> f64 {
    1.5
}

fn default_uniform_share() -> f64 {
    0.25
}

fn default_candidates() -> usize {
    32
}

fn default_pair_share() -> f64 {
    0.3
}

/// Limits of the settings, with the reason for a rejection.
const MOST_CANDIDATES: usize = 10_000;

impl ActiveStage {
    /// The default settings with this number of episodes.
    pub fn new(episodes: u64) -> Self {
        Self {
            episodes,
            growth: default_growth(),
            uniform_share: default_uniform_share(),
            candidates: default_candidates(),
            until_rms: None,
            pair_share: default_pair_share(),
        }
    }

    /// The setting that is out of range, its value and the expected range.
    pub(crate) fn problem(&self) -> Option<(&'static str, f64, &'static str)> {
        let within = |x: f64, low: f64, high: f64| x > low && x <= high;
        let until = self.until_rms.unwrap_or(0.1);
        let checks = [
            (within(self.growth, 0.999, 100.0), "active.growth", self.growth, "a number from 1 to 100"),
            (
                within(self.uniform_share, 0.0, 0.5),
                "active.uniform_share",
                self.uniform_share,
                "a number above 0 and at most 0.5",
            ),
            (
                (2..=MOST_CANDIDATES).contains(&self.candidates),
                "active.candidates",
                self.candidates as f64,
                "an integer from 2 to 10000",
            ),
            (within(until, 0.0, 0.5), "active.until_rms", until, "a number above 0 and at most 0.5"),
            (
                within(self.pair_share, 0.0, 0.5),
                "active.pair_share",
                self.pair_share,
                "a number above 0 and at most 0.5",
            ),
        ];
        checks.into_iter().find(|(valid, ..)| !valid).map(|(_, key, value, expected)| (key, value, expected))
    }

    /// The indices of each round, after a uniform stage of this many episodes.
    pub fn rounds(&self, uniform: u64) -> Vec<Range<u64>> {
        let mut rounds = Vec::new();
        let (mut first, end) = (uniform, uniform + self.episodes);
        let mut size = uniform.div_ceil(2).max(1);
        while first < end {
            let next = end.min(first.saturating_add(size));
            rounds.push(first..next);
            first = next;
            // Far below 2^53.
            size = ((size as f64 * self.growth).ceil() as u64).max(size);
        }
        rounds
    }

    /// The episodes of a round that belong to pairs: the first ones, an even number.
    fn pairs(&self, round: &Range<u64>) -> u64 {
        match self.until_rms {
            // A share of at most 0.5 of a count far below 2^53.
            Some(_) => 2 * (0.5 * self.pair_share * (round.end - round.start) as f64).round() as u64,
            None => 0,
        }
    }
}

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
    /// The error of the model, if the plan measures it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub certificate: Option<Certificate>,
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

/// The chosen point of an episode.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Chosen {
    pub(crate) requested: Assignment,
    pub(crate) weight: f64,
    pub(crate) design: &'static str,
}

/// A round that is about to start: its points and the report on its model.
#[derive(Debug)]
pub(crate) struct Opened {
    pub(crate) report: ActiveRound,
    /// The points, in order of index. Empty if the stage is over.
    pub(crate) points: Vec<Chosen>,
}

/// Chooses the points of the active stage.
pub(crate) struct Chooser {
    stage: ActiveStage,
    rounds: Vec<Range<u64>>,
    space: Arc<ParameterSpace>,
    inputs: Arc<Inputs>,
    seed: Seed,
    /// The episodes for training so far.
    samples: Vec<Sample>,
    /// The outcomes of pairs so far: the first index of the pair, parameters, and outcomes of valid episodes.
    pairs: BTreeMap<u64, (Assignment, Vec<bool>)>,
}

impl Chooser {
    /// `None` if the plan has no active stage.
    pub(crate) fn new(plan: &Plan, space: &Arc<ParameterSpace>, foresight: Option<Arc<dyn Foresight>>) -> Option<Self> {
        let stage = plan.active.clone()?;
        Some(Self {
            rounds: stage.rounds(plan.uniform.episodes),
            stage,
            space: Arc::clone(space),
            inputs: Arc::new(Inputs::new(space, foresight)),
            seed: Seed::campaign(plan.seed),
            samples: Vec::new(),
            pairs: BTreeMap::new(),
        })
    }

    /// The rounds of the stage.
    pub(crate) fn rounds(&self) -> &[Range<u64>] {
        &self.rounds
    }

    /// Adds a recorded episode. Episodes must come in order of index.
    pub(crate) fn add(&mut self, entry: &Entry) {
        let scenario = &entry.episode.scenario;
        let success = match entry.episode.outcome {
            Outcome::Success => true,
            Outcome::Failure(_) => false,
            Outcome::Invalid(_) => return,
        };
        if entry.design != PAIR {
            self.samples.push(Sample { scenario: scenario.clone(), success });
        } else if let Some(round) = self.rounds.iter().find(|round| round.contains(&scenario.index)) {
            let first = scenario.index - (scenario.index - round.start) % 2;
            let pair = self.pairs.entry(first).or_insert_with(|| (scenario.requested.clone(), Vec::new()));
            pair.1.push(success);
        }
    }

    /// Fits the model to the episodes so far, and chooses the points of round `number`. The number after the last round
    /// has no points.
    pub(crate) fn open(&self, number: usize) -> Result<Opened, RunError> {
        let round = self.rounds.get(number).cloned().unwrap_or(0..0);
        let model = match RiskModel::fit(Arc::clone(&self.inputs), &self.samples, Learner::Chosen) {
            Ok(model) => Some(model),
            Err(RiskError::TooFew { .. }) => None,
            Err(error) => return Err(RunError::Model(error)),
        };
        let certificate = match (&model, self.stage.until_rms) {
            (Some(model), Some(until)) => self.certificate(model, until),
            _ => None,
        };
        let over = certificate.is_some_and(|found| found.reached);
        let points = if over { Vec::new() } else { self.choose(&round, model.as_ref())? };
        let score = |model: &RiskModel| {
            let choice = model.choice();
            ModelScore { boosting_share: choice.boosting_share, brier: choice.brier, log_loss: choice.log_loss }
        };
        let report = ActiveRound {
            episodes: points.len() as u64,
            trained_on: self.samples.len() as u64,
            model: model.as_ref().map(score),
            certificate,
        };
        Ok(Opened { report, points })
    }

    /// The error of the model from all complete pairs. The confidence is divided among the looks, one for each round and
    /// one at the end.
    fn certificate(&self, model: &RiskModel, until: f64) -> Option<Certificate> {
        let pairs: Vec<Pair> = self
            .pairs
            .values()
            .filter_map(|(requested, outcomes)| {
                let success = <[bool; 2]>::try_from(outcomes.as_slice()).ok()?;
                // Without a prediction the pair says nothing about the model.
                let predicted = model.averaged(requested, DRAWS).ok()?;
                Some(Pair { predicted, success })
            })
            .collect();
        let looks = self.rounds.len() as f64 + 1.0;
        let found = model_error(&pairs, ALPHA / looks).ok()??;
        Some(Certificate {
            pairs: found.pairs as u64,
            mean_square: found.mean_square,
            rms_bound: found.rms_bound,
            noise: found.noise,
            reached: found.rms_bound <= until,
        })
    }

    fn choose(&self, round: &Range<u64>, model: Option<&RiskModel>) -> Result<Vec<Chosen>, RunError> {
        let paired = round.start + self.stage.pairs(round);
        let mut points: Vec<Chosen> = Vec::new();
        for index in round.clone() {
            let seed = self.seed.episode(index);
            let point = if index >= paired {
                self.one(index, model)?
            } else if (index - round.start).is_multiple_of(2) {
                let requested = self.candidates(seed, 1)?.pop().unwrap_or_default();
                Chosen { requested, weight: 1.0, design: PAIR }
            } else {
                points.last().cloned().unwrap_or(Chosen { requested: Assignment::default(), weight: 1.0, design: PAIR })
            };
            points.push(point);
        }
        Ok(points)
    }

    /// Points from the operating distribution.
    fn candidates(&self, seed: Seed, count: usize) -> Result<Vec<Assignment>, RunError> {
        use robogate_core::Sampler;
        let design = samplers::Uniform.design(&self.space, count, seed.stream("active-candidates"))?;
        Ok((0..count).filter_map(|i| design.assignment(i)).collect())
    }

    /// The point of one episode.
    fn one(&self, index: u64, model: Option<&RiskModel>) -> Result<Chosen, RunError> {
        let seed = self.seed.episode(index);
        let count = if model.is_some() { self.stage.candidates } else { 1 };
        let mut candidates = self.candidates(seed, count)?;
        // A candidate that cannot be set up is as uninteresting as a certain one.
        let uncertainty = |requested: &Assignment| {
            let scenario = Scenario { index, seed, requested: requested.clone() };
            model.map_or(0.0, |model| model.told(&scenario).map_or(0.0, |p| p * (1.0 - p)))
        };
        let scores: Vec<f64> = candidates.iter().map(uncertainty).collect();
        let chances = chances(&scores, self.stage.uniform_share);
        let mut left = seed.stream("active-choice").uniform();
        let mut chosen = candidates.len().saturating_sub(1);
        for (at, chance) in chances.iter().enumerate() {
            left -= chance;
            if left < 0.0 {
                chosen = at;
                break;
            }
        }
        let weight = chances.get(chosen).map_or(1.0, |chance| 1.0 / (chances.len() as f64 * chance));
        let requested = if candidates.is_empty() { Assignment::default() } else { candidates.swap_remove(chosen) };
        Ok(Chosen { requested, weight, design: ACTIVE })
    }
}

/// The probability of each candidate.
fn chances(scores: &[f64], uniform_share: f64) -> Vec<f64> {
    let (n, sum) = (scores.len() as f64, scores.iter().sum::<f64>());
    let chance = |score: &f64| match sum > 0.0 {
        true => uniform_share / n + (1.0 - uniform_share) * score / sum,
        false => 1.0 / n,
    };
    scores.iter().map(chance).collect()
}

#[cfg(test)]
mod tests {
    use robogate_core::Stream;
    use robogate_stats::{Confidence, weighted::hajek};

    use super::*;

    #[test]
    fn rounds_grow_to_the_budget() {
        let rounds = ActiveStage::new(1500).rounds(500);
        let sizes: Vec<u64> = rounds.iter().map(|round| round.end - round.start).collect();
        assert_eq!(sizes, [250, 375, 563, 312]);
        assert_eq!((rounds[0].start, rounds[3].end), (500, 2000));
        assert!(ActiveStage::new(0).rounds(10).is_empty());
        assert_eq!(ActiveStage::new(3).rounds(0).len(), 2);
    }

    #[test]
    fn settings_are_checked() {
        assert_eq!(ActiveStage::new(10).problem(), None);
        let bad = |change: fn(&mut ActiveStage)| {
            let mut stage = ActiveStage::new(10);
            change(&mut stage);
            stage.problem().map(|(key, ..)| key)
        };
        assert_eq!(bad(|s| s.growth = 0.5), Some("active.growth"));
        assert_eq!(bad(|s| s.uniform_share = 0.0), Some("active.uniform_share"));
        assert_eq!(bad(|s| s.candidates = 1), Some("active.candidates"));
        assert_eq!(bad(|s| s.until_rms = Some(f64::NAN)), Some("active.until_rms"));
        assert_eq!(bad(|s| s.pair_share = 0.6), Some("active.pair_share"));
    }

    #[test]
    fn chances_are_probabilities() {
        let found = chances(&[0.0, 0.25, 0.25], 0.3);
        for (found, expected) in found.iter().zip([0.1, 0.45, 0.45]) {
            assert!((found - expected).abs() < 1e-12, "{found} {expected}");
        }
        assert!(chances(&[0.0; 4], 0.3).iter().all(|chance| (chance - 0.25).abs() < 1e-12));
    }

    /// Samples 1 of 16 candidates by a wrong model that learns from earlier outcomes, 500 times with 300 episodes. The
    /// weighted rate is unbiased, and its interval covers the true rate.
    #[test]
    fn weighted_rate_is_unbiased_and_covers() {
        // Failures are rare below 0.8 and frequent above: the true rate is 0.8 x 0.98 + 0.2 x 0.3.
        let truth = 0.8 * 0.98 + 0.2 * 0.3;
        let p = |x: f64| if x < 0.8 { 0.98 } else { 0.3 };
        let (runs, mut sum, mut covered, mut kish) = (500, 0.0, 0, 0.0);
        for run in 0..runs {
            let mut stream: Stream = Seed::campaign(run).stream("coverage");
            let (mut outcomes, mut weights) = (Vec::new(), Vec::new());
            // The model: the failure rate above and below 0.7 so far, which is wrong on purpose.
            let mut counts = [[1.0_f64, 2.0]; 2];
            for _ in 0..300 {
                let xs: Vec<f64> = (0..16).map(|_| stream.uniform()).collect();
                let score = |x: &f64| {
                    let [failures, all] = counts[usize::from(*x > 0.7)];
                    let q = failures / all;
                    q * (1.0 - q)
                };
                let chances = chances(&xs.iter().map(score).collect::<Vec<_>>(), 0.25);
                let mut left = stream.uniform();
                let at = chances
                    .iter()
                    .position(|chance| {
                        left -= chance;
                        left < 0.0
                    })
                    .unwrap_or(15);
                let success = stream.uniform() < p(xs[at]);
                let count = &mut counts[usize::from(xs[at] > 0.7)];
                *count = [count[0] + f64::from(u8::from(!success)), count[1] + 1.0];
                outcomes.push(success);
                weights.push(1.0 / (16.0 * chances[at]));
            }
            let found = hajek(&outcomes, &weights, Confidence::P95).unwrap();
            sum += found.rate.unwrap() - truth;
            covered += usize::from(found.interval.low <= truth && truth <= found.interval.high);
            kish += found.effective;
        }
        let bias = sum / runs as f64;
        assert!(bias.abs() < 0.004, "bias {bias}");
        assert!(covered as f64 >= 0.93 * runs as f64, "{covered} of {runs}");
        assert!(kish / runs as f64 > 100.0);
    }
}
