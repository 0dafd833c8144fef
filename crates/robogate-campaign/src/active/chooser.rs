//! Chooses the points of the active stage.

use std::collections::BTreeMap;
use std::num::NonZeroUsize;
use std::ops::Range;
use std::sync::Arc;

use robogate_core::{Assignment, FailureMode, Foresight, Outcome, ParameterSpace, Sampler, Scenario, Seed, samplers};
use robogate_dictionary::Entry;
use robogate_risk::{Fitting, Inputs, RiskError, RiskModel, Sample, in_parallel};
use robogate_stats::model_error::{Pair, model_error};
use serde::{Deserialize, Serialize};

use super::{ActiveRound, ActiveStage, Certificate, ModelScore};
use crate::{Plan, RunError};

/// Fresh draws over which the model is averaged where its error is measured.
const DRAWS: u64 = 96;
/// Probability that any of the bounds of a campaign fails.
const ALPHA: f64 = 0.05;
/// Fewest failures of the mode that a plan seeks for a model.
const FEWEST_SOUGHT: usize = 3;

/// How the point of an episode was chosen: its design in the dictionary.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum Choice {
    /// By the model.
    Active,
    /// From the operating distribution.
    Uniform,
    /// From the operating distribution, twice, for the error of the model.
    Pair,
}

impl Choice {
    pub(crate) fn as_str(self) -> &'static str {
        match self {
            Self::Active => "active",
            Self::Uniform => "uniform",
            Self::Pair => "pair",
        }
    }
}

/// The chosen point of an episode.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) struct Chosen {
    pub(crate) requested: Assignment,
    pub(crate) weight: f64,
    pub(crate) choice: Choice,
}

/// A round that is about to start: its points and the report on its model.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
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
    /// The largest number of threads for a model.
    threads: NonZeroUsize,
    /// The failure mode that the plan seeks.
    seek: Option<FailureMode>,
    /// The episodes for training so far.
    samples: Vec<Sample>,
    /// The outcomes of pairs so far: the first index of the pair, parameters, and outcomes of valid episodes.
    pairs: BTreeMap<u64, (Assignment, Vec<bool>)>,
}

impl Chooser {
    /// `None` if the plan has no active stage.
    pub(crate) fn new(
        plan: &Plan,
        space: &Arc<ParameterSpace>,
        foresight: Option<Arc<dyn Foresight>>,
        threads: NonZeroUsize,
    ) -> Option<Self> {
        let stage = plan.active.clone()?;
        let seek = stage.seek.as_deref().map(FailureMode::from_foreign);
        Some(Self {
            rounds: stage.rounds(plan.uniform.episodes),
            seek,
            stage,
            space: Arc::clone(space),
            inputs: Arc::new(Inputs::new(space, foresight)),
            seed: Seed::campaign(plan.seed),
            threads,
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
            Outcome::Failure(mode) => self.seek.is_some_and(|seek| seek != mode),
            Outcome::Invalid(_) => return,
        };
        if entry.design != Choice::Pair.as_str() {
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
        let (model, problem) = match self.fit() {
            Ok(model) => (model, None),
            Err(error) => (None, Some(error.to_string())),
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
            problem,
            certificate,
        };
        Ok(Opened { report, points })
    }

    /// Fits a model. `None` if there are too few episodes of one outcome.
    fn fit(&self) -> Result<Option<RiskModel>, RiskError> {
        // Failures of a rare mode are few. The rounds would be uniform for too long with the usual number.
        let least = if self.seek.is_some() { FEWEST_SOUGHT } else { RiskModel::LEAST };
        let how = Fitting { least, threads: self.threads, ..Fitting::default() };
        match RiskModel::fit(Arc::clone(&self.inputs), &self.samples, how) {
            Ok(model) => Ok(Some(model)),
            Err(RiskError::TooFew { .. }) => Ok(None),
            Err(error) => Err(error),
        }
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
        for index in round.start..paired {
            let seed = self.seed.episode(index);
            let point = if (index - round.start).is_multiple_of(2) {
                let requested = self.candidates(seed, 1, "active-uniform")?.pop().unwrap_or_default();
                Chosen { requested, weight: 1.0, choice: Choice::Pair }
            } else {
                let point = || Chosen { requested: Assignment::default(), weight: 1.0, choice: Choice::Pair };
                points.last().cloned().unwrap_or_else(point)
            };
            points.push(point);
        }
        let single: Vec<u64> = (paired..round.end).collect();
        for point in in_parallel(self.threads, single.len(), |at| self.one(single[at], model)) {
            points.push(point?);
        }
        Ok(points)
    }

    /// Points from the operating distribution.
    fn candidates(&self, seed: Seed, count: usize, purpose: &str) -> Result<Vec<Assignment>, RunError> {
        let design = samplers::Uniform.design(&self.space, count, seed.stream(purpose))?;
        Ok((0..count).filter_map(|i| design.assignment(i)).collect())
    }

    /// The point of one episode.
    fn one(&self, index: u64, model: Option<&RiskModel>) -> Result<Chosen, RunError> {
        let seed = self.seed.episode(index);
        let mut candidates = self.candidates(seed, 1, "active-uniform")?;
        let mut stream = seed.stream("active-choice");
        let is_uniform = stream.uniform() < self.stage.uniform_share;
        let Some(model) = model else {
            let requested = candidates.pop().unwrap_or_default();
            return Ok(Chosen { requested, weight: 1.0, choice: Choice::Uniform });
        };
        candidates.extend(self.candidates(seed, self.stage.candidates - 1, "active-candidates")?);
        let score = |requested: &Assignment| {
            let scenario = Scenario { index, seed, requested: requested.clone() };
            match (model.told(&scenario), self.seek) {
                (Ok(p), None) => p * (1.0 - p),
                (Ok(p), Some(_)) => 1.0 - p,
                // A candidate that cannot be set up says nothing.
                (Err(_), _) => 0.0,
            }
        };
        let scores: Vec<f64> = candidates.iter().map(score).collect();
        let chances = chances(&scores, self.stage.uniform_share);
        let chosen = if is_uniform { 0 } else { pick(&scores, stream.uniform()) };
        let weight = chances.get(chosen).map_or(1.0, |chance| 1.0 / (chances.len() as f64 * chance));
        let requested = if candidates.is_empty() { Assignment::default() } else { candidates.swap_remove(chosen) };
        let choice = if is_uniform { Choice::Uniform } else { Choice::Active };
        Ok(Chosen { requested, weight, choice })
    }
}

/// Chooses a candidate in proportion to its score, with a number `at` in [0, 1). The first one if all scores are 0.
fn pick(scores: &[f64], at: f64) -> usize {
    let mut left = at * scores.iter().sum::<f64>();
    let found = scores.iter().position(|score| {
        left -= score;
        left < 0.0
    });
    // Rounding may leave nothing for the last candidate. All scores may be 0.
    found.or_else(|| scores.iter().rposition(|score| *score > 0.0)).unwrap_or(0)
}

/// The probability of each candidate.
pub(super) fn chances(scores: &[f64], uniform_share: f64) -> Vec<f64> {
    let (n, sum) = (scores.len() as f64, scores.iter().sum::<f64>());
    let chance = |score: &f64| match sum > 0.0 {
        true => uniform_share / n + (1.0 - uniform_share) * score / sum,
        false => 1.0 / n,
    };
    scores.iter().map(chance).collect()
}
