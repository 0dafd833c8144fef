//! The analysis of one dictionary. Every figure names the population that it applies to.

use std::path::Path;

use robogate_core::OutsideRange;
use robogate_dictionary::{Dictionary, Provenance};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::claims::{Claims, claims};
use crate::conditions::Conditions;
use crate::danger::DangerZones;
use crate::dependence::ClusterReport;
use crate::effects::Effects;
use crate::failures::FailureModes;
use crate::marginal::{MarginalEffect, marginal_effect};
use crate::models::{Frontier, Regression, RiskModel, frontier, interactions, risk};
use crate::pairs::{self, PairMap, check as check_pair, default_pairs};
use crate::replay::{ReplayGroup, replay_groups};
use crate::safe_box::{DEFAULT_TARGET, SafeBox, safe_box};
use crate::sampling::{Sampling, sampling};
use crate::table::{EpisodeTable, Sample};
use crate::task::TaskAnalysis;
use crate::weighting::Counted;
use crate::{AnalysisError, Finding, Population, Source, Success};

/// The analysis of one dictionary as one document.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Analysis {
    /// The version of this document.
    pub version: u32,
    /// The dictionary that was analysed.
    pub subject: Subject,
    /// The claims that the headline may state.
    pub claims: Claims,
    /// The population that every figure below applies to, unless it names another one.
    pub population: Population,
    /// The clusters of the episodes. Absent if the episodes are independent as far as known.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub clusters: Option<ClusterReport>,
    /// How often the policy succeeds.
    pub success: Success,
    /// The parameters with an effect on success, the most influential first.
    pub effects: Effects,
    /// Where the policy fails, and what these episodes could have shown.
    #[serde(default)]
    pub conditions: Conditions,
    /// The largest box of parameters in which success is at least the target rate.
    pub safe_box: Finding<SafeBox>,
    /// Success over two parameters at once, with the frontier between success and failure.
    pub envelopes: Vec<Envelope>,
    /// The marginal effect of each parameter.
    pub marginal_effects: Vec<MarginalEffect>,
    /// How the policy fails.
    pub failure_modes: FailureModes,
    /// Where the policy significantly fails most of the time.
    pub danger_zones: DangerZones,
    /// The published model of the task, standardised, with interactions.
    pub interactions: Finding<Regression>,
    /// The paper's risk model.
    pub risk: Finding<RiskModel>,
    /// How often the policy saw states outside of the published range of its checkpoint. Absent if the range is unknown.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub outside_range: Option<OutsideRange>,
    /// How the points were sampled.
    pub sampling: Sampling,
    /// Episodes that are worth replaying.
    pub replay: Vec<ReplayGroup>,
    /// The provenance of the rows.
    pub provenance: Provenance,
}

/// The options of an analysis.
#[derive(Debug, Clone, PartialEq)]
pub struct AnalysisOptions {
    /// Pairs of parameters that are mapped in addition to the default pairs.
    pub pairs: Vec<(String, String)>,
    /// The success rate that the advice aims at, between 0 and 1.
    pub target_rate: f64,
    /// Whether to fit the risk model and to draw maps. No claim of the headline depends on them.
    pub models: bool,
    /// Columns whose equal values mark rows that depend on each other. Empty: found by their names and by equal settings.
    pub groups: Vec<String>,
}

impl Default for AnalysisOptions {
    fn default() -> Self {
        Self { pairs: Vec::new(), target_rate: DEFAULT_TARGET, models: true, groups: Vec::new() }
    }
}

/// The dictionary of an analysis.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct Subject {
    /// The path as given: the run's folder or a file.
    pub path: String,
    /// Whether the path is a run's folder, so that episodes can be replayed.
    pub replayable: bool,
    /// The task. Empty if it is unknown.
    pub task: String,
    /// The robot.
    pub robot: String,
    /// SHA-256 (hex) over the files of the robot. Absent if it is unknown.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub robot_sha256: Option<String>,
    /// The policy.
    pub policy: String,
    /// SHA-256 (hex) of the policy. Absent if it is unknown, and for a policy that is built into RoboGate.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub policy_sha256: Option<String>,
    /// The engine, with its version.
    pub engine: String,
    /// Episodes of all stages, invalid ones included.
    pub episodes: u64,
    /// The content hash of the rows.
    pub dataset_hash: String,
}

impl Subject {
    pub(crate) fn of(source: &Source, path: &Path) -> Self {
        let dictionary = source.dictionary();
        let provenance = dictionary.provenance();
        Self {
            path: path.display().to_string(),
            replayable: source.folder().is_some() && provenance.source.is_none(),
            task: provenance.task.name.as_str().to_owned(),
            robot: provenance.robot.name.clone(),
            robot_sha256: provenance.robot.sha256.clone(),
            policy: provenance.policy.clone(),
            policy_sha256: provenance.policy_sha256(),
            engine: match &provenance.engine.version {
                Some(version) => format!("{} {version}", provenance.engine.name),
                None => provenance.engine.name.clone(),
            },
            episodes: dictionary.len(),
            dataset_hash: dictionary.dataset_hash().to_owned(),
        }
    }
}

/// Success rates over two parameters.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Envelope {
    /// The observed rates.
    pub map: Finding<PairMap>,
    /// The frontier in closed form, solved for the parameter upwards.
    pub frontier: Finding<Frontier>,
}

impl Analysis {
    /// The version of the document that this build writes.
    pub const VERSION: u32 = 4;

    /// Analyses a source that was opened from `path`. `pairs` are mapped in addition to the default pairs.
    ///
    /// # Errors
    /// If a column cannot be read, or if a parameter of a pair does not exist.
    pub fn of(source: &Source, path: &Path, pairs: &[(String, String)]) -> Result<Self, AnalysisError> {
        Self::with(source, path, &AnalysisOptions { pairs: pairs.to_vec(), ..AnalysisOptions::default() })
    }

    /// Analyses a source that was opened from `path`, with options.
    ///
    /// # Errors
    /// As [`Analysis::of`], for a target rate that is not between 0 and 1, and for a column of groups that does not exist.
    pub fn with(source: &Source, path: &Path, options: &AnalysisOptions) -> Result<Self, AnalysisError> {
        let AnalysisOptions { pairs, target_rate, models, groups } = options;
        if !(*target_rate > 0.0 && *target_rate < 1.0) {
            return Err(AnalysisError::TargetRate { found: *target_rate });
        }
        let dictionary = source.dictionary();
        let table = EpisodeTable::read(dictionary)?;
        let Counted { mut base, population, weighting } = Counted::of(&table, source.boundary());
        base.depend(&table, population, groups)?;
        for (first, second) in pairs {
            check_pair(&base, first, second)?;
        }
        let marginal_effects: Vec<MarginalEffect> =
            base.parameters.iter().map(|parameter| marginal_effect(&table, &base, parameter)).collect();
        let task = TaskAnalysis::of_dictionary(dictionary.provenance());
        let effects = Effects::of(&base);
        let mut wanted: Vec<(String, String)> = default_pairs(&base, &effects, task);
        for pair in pairs {
            if !wanted.contains(pair) {
                wanted.push(pair.clone());
            }
        }
        if !models {
            wanted.clear();
        }
        let envelopes = wanted.iter().filter_map(|(up, across)| envelope(&base, up, across)).collect();
        let fitted = if *models { risk(&table, &base, task) } else { Finding::not("models were not requested") };
        let (risk, scored) = match fitted {
            Finding::Estimated((model, scored)) => (Finding::Estimated(model), Some(scored)),
            Finding::CannotBeEstimated { because } => (Finding::CannotBeEstimated { because }, None),
        };
        let provenance = dictionary.provenance().clone();
        let independent = provenance.space.correlations().is_empty();
        let mut analysis = Self {
            version: Self::VERSION,
            subject: Subject::of(source, path),
            claims: Claims::default(),
            population,
            clusters: base.dependence.as_ref().map(|of| of.report(&base)),
            success: Success::of(&table, &base, population, weighting.as_ref()),
            envelopes,
            failure_modes: FailureModes::of(&table, &base),
            danger_zones: DangerZones::of(&marginal_effects, &effects),
            conditions: Conditions::of(&table, &base, &effects, seek(&provenance)),
            safe_box: safe_box(&table, &base, population, independent, &effects, *target_rate),
            effects,
            marginal_effects,
            interactions: interactions(&base, task),
            risk,
            outside_range: outside_range(dictionary)?,
            sampling: sampling(source, &table),
            replay: replay_groups(&table, &base, scored.as_ref(), task),
            provenance,
        };
        analysis.claims = claims(&analysis);
        Ok(analysis)
    }

    /// The parameters that the space samples jointly with others, in the order of the space.
    pub fn jointly_sampled(&self) -> Vec<String> {
        let names = self.marginal_effects.iter().map(|effect| &effect.parameter);
        names.filter(|parameter| self.is_jointly_sampled(parameter)).cloned().collect()
    }

    /// Whether the space samples this parameter jointly with another one.
    pub fn is_jointly_sampled(&self, parameter: &str) -> bool {
        let correlations = self.provenance.space.correlations();
        correlations.iter().any(|c| c.parameters.iter().any(|name| **name == *parameter))
    }
}

/// The failure mode that the plan of a run sought.
fn seek(provenance: &Provenance) -> Option<&str> {
    provenance.plan.get("active")?.get("seek")?.as_str()
}

/// Counts the states outside of the range of the checkpoint, in all rows.
fn outside_range(dictionary: &Dictionary) -> Result<Option<OutsideRange>, AnalysisError> {
    let Some(mut outside) = OutsideRange::of(&dictionary.provenance().task) else { return Ok(None) };
    for entry in dictionary.entries() {
        outside.add(&entry?.episode.measures);
    }
    Ok(Some(outside.sorted()))
}

fn envelope(base: &Sample, up: &str, across: &str) -> Option<Envelope> {
    let (up, across) = (base.parameter(up)?, base.parameter(across)?);
    let map = match pairs::map(base, up, across) {
        Some(map) => Finding::Estimated(map),
        None => Finding::not("one of the two parameters has too many levels for a map"),
    };
    Some(Envelope { map, frontier: frontier(base, up, across) })
}
