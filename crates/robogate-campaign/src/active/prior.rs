//! The episodes of an earlier campaign, from which the risk model starts.

use std::path::Path;

use robogate_core::{Domain, FailureMode, Outcome, ParameterSpace, Scenario, Seed, TaskSpec};
use robogate_dictionary::{Dictionary, DictionaryError, Robot, hex};
use robogate_risk::{RiskModel, Sample};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

use super::chooser::{Choice, FEWEST_SOUGHT};
use crate::{RunError, Stage, folder};

/// The largest number of episodes of a prior. More hardly change its model, and the fit takes seconds.
const MOST: usize = 5_000;

/// The identity of a prior, in the plan. Its episodes are in `prior.json`, beside the plan.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct PriorRun {
    /// SHA-256 (hex) of `prior.json`.
    pub sha256: String,
    /// The dataset hash of the earlier campaign.
    pub dataset_sha256: String,
    /// Its policy.
    pub policy: String,
    /// Its engine.
    pub engine: String,
    /// Its robot.
    pub robot: String,
    /// Whether its model is told the hidden draws. They are known if the robot is the same.
    pub told_draws: bool,
}

/// The episodes of an earlier campaign of the same task, with another policy, engine or robot.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Prior {
    version: u32,
    dataset_sha256: String,
    task: String,
    policy: String,
    engine: String,
    robot: Robot,
    seed: u64,
    space: ParameterSpace,
    episodes: Vec<PriorEpisode>,
}

/// A valid episode of a prior.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct PriorEpisode {
    index: u64,
    /// The code of each parameter of the space.
    point: Vec<f64>,
    outcome: String,
    /// Whether a model that knew the draws chose the point.
    chosen: bool,
}

/// The reason why a campaign cannot be a prior.
#[derive(Debug, thiserror::Error)]
pub enum PriorError {
    /// Its rows cannot be read.
    #[error(transparent)]
    Dictionary(#[from] DictionaryError),
    /// It was imported.
    #[error("its episodes were imported\nhint: a prior is a finished run of robogate")]
    Imported,
    /// It is a campaign of another task.
    #[error("its task is {found}. Expected {expected}, the task of this run")]
    OtherTask {
        /// Its task.
        found: String,
        /// The task of the new campaign.
        expected: String,
    },
    /// It varies a parameter that the new campaign does not have.
    #[error(
        "its episodes vary `{parameter}`, which is not a parameter of this run\nhint: use a space that contains all parameters of the prior"
    )]
    Parameter {
        /// The parameter.
        parameter: String,
    },
    /// A parameter is numeric in one campaign and categorical in the other.
    #[error("`{parameter}` is numeric in one of the runs and categorical in the other")]
    Kind {
        /// The parameter.
        parameter: String,
    },
    /// It has too few episodes of one outcome.
    #[error("it has {successes} successes and {failures} failures. Expected at least {least} of each")]
    TooFew {
        /// Its successes, or the episodes without the failure mode that the plan seeks.
        successes: usize,
        /// Its failures, or the episodes with that mode.
        failures: usize,
        /// Expected number of each.
        least: usize,
    },
}

impl Prior {
    const VERSION: u32 = 1;

    /// The valid episodes of a finished run. Of more than 5,000 episodes it takes every second, third, and so on.
    ///
    /// # Errors
    /// Rows that cannot be read, or that were imported.
    pub fn of(dictionary: &Dictionary) -> Result<Self, PriorError> {
        let provenance = dictionary.provenance();
        if provenance.source.is_some() {
            return Err(PriorError::Imported);
        }
        let mut episodes = Vec::new();
        for entry in dictionary.entries() {
            let entry = entry?;
            let requested = &entry.episode.scenario.requested;
            let codes = provenance.space.parameters().iter().map(|of| of.domain.encode(requested.get(&of.name)?));
            // A row without a value of a parameter teaches nothing about it.
            let Some(point) = codes.collect::<Option<Vec<f64>>>() else { continue };
            if matches!(entry.episode.outcome, Outcome::Invalid(_)) {
                continue;
            }
            let chosen = entry.stage == Stage::Active.as_str() && entry.design == Choice::Active.as_str();
            let outcome = entry.episode.outcome.as_str().to_owned();
            episodes.push(PriorEpisode { index: entry.index(), point, outcome, chosen });
        }
        let step = episodes.len().div_ceil(MOST).max(1);
        Ok(Self {
            version: Self::VERSION,
            dataset_sha256: dictionary.dataset_hash().to_owned(),
            task: provenance.task.name.to_string(),
            policy: provenance.policy.clone(),
            engine: provenance.engine.name.clone(),
            robot: provenance.robot.clone(),
            seed: provenance.seed,
            space: provenance.space.clone(),
            episodes: episodes.into_iter().step_by(step).collect(),
        })
    }

    /// Checks that a campaign of this task and space can start from these episodes, and seek this failure mode.
    ///
    /// The new campaign may have more parameters, other ranges and another robot.
    ///
    /// # Errors
    /// The first reason why it cannot.
    pub fn check(&self, task: &TaskSpec, space: &ParameterSpace, seek: Option<&str>) -> Result<(), PriorError> {
        if task.name != *self.task.as_str() {
            return Err(PriorError::OtherTask { found: self.task.clone(), expected: task.name.to_string() });
        }
        let is_category = |domain: &Domain| matches!(domain, Domain::Categorical { .. });
        for own in self.space.parameters() {
            let parameter = || own.name.to_string();
            let Some(at) = space.position(&own.name) else {
                return Err(PriorError::Parameter { parameter: parameter() });
            };
            let other = &space.parameters()[at].domain;
            if is_category(other) != is_category(&own.domain) {
                return Err(PriorError::Kind { parameter: parameter() });
            }
        }
        let least = if seek.is_some() { FEWEST_SOUGHT } else { RiskModel::LEAST };
        let successes = self.episodes.iter().filter(|episode| episode.is_success(seek)).count();
        let failures = self.episodes.len() - successes;
        if successes.min(failures) < least {
            return Err(PriorError::TooFew { successes, failures, least });
        }
        Ok(())
    }

    /// The identity of the prior in the plan of a campaign with this robot.
    ///
    /// # Errors
    /// If it cannot be written as JSON.
    pub fn identity(&self, robot: &Robot) -> serde_json::Result<PriorRun> {
        Ok(PriorRun {
            sha256: hex(&Sha256::digest(self.document()?)),
            dataset_sha256: self.dataset_sha256.clone(),
            policy: self.policy.clone(),
            engine: self.engine.clone(),
            robot: self.robot.name.clone(),
            told_draws: self.robot.name == robot.name && self.robot.sha256 == robot.sha256,
        })
    }

    /// The content of `prior.json`.
    ///
    /// # Errors
    /// If it cannot be written as JSON.
    pub fn document(&self) -> serde_json::Result<Vec<u8>> {
        serde_json::to_vec(self)
    }

    /// Parses the content of `prior.json` at `path`, which the plan names.
    pub(crate) fn parse(path: &Path, text: &[u8], plan: &PriorRun) -> Result<Self, RunError> {
        let present = hex(&Sha256::digest(text));
        if present != plan.sha256 {
            return Err(RunError::Mismatch { what: "prior".to_owned(), recorded: plan.sha256.clone(), present });
        }
        let prior: Self = folder::parse(path, text)?;
        crate::run::known_version(path, prior.version, Self::VERSION)?;
        Ok(prior)
    }

    /// The parameter space of the earlier campaign.
    pub(super) fn space(&self) -> &ParameterSpace {
        &self.space
    }

    /// The episodes for training. A model of the parameters alone leaves out those that were chosen with knowledge of the draws.
    pub(super) fn samples(&self, told_draws: bool, seek: Option<FailureMode>) -> Vec<Sample> {
        let seed = Seed::campaign(self.seed);
        let seek = seek.map(FailureMode::as_str);
        let sample = |episode: &PriorEpisode| {
            let parameters = self.space.parameters().iter().zip(&episode.point);
            let requested = parameters.map(|(of, code)| (of.name.clone(), of.domain.decode(*code))).collect();
            let scenario = Scenario { index: episode.index, seed: seed.episode(episode.index), requested };
            Sample { scenario, success: episode.is_success(seek) }
        };
        self.episodes.iter().filter(|episode| told_draws || !episode.chosen).map(sample).collect()
    }
}

impl PriorEpisode {
    /// Whether the episode succeeded, or did not fail in the mode `seek`.
    fn is_success(&self, seek: Option<&str>) -> bool {
        seek.map_or(self.outcome == Outcome::Success.as_str(), |mode| self.outcome != mode)
    }
}
