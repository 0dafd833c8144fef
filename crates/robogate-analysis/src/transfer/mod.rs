//! Inference about the real robot from a simulation and a few real trials.
//!
//! The simulation's episodes train a model of P(success). The model never sees a trial. Its predictions for the trials
//! and for the population narrow the interval of the real success rate ([`robogate_stats::prediction_powered`]); the more
//! the predictions agree with the trials, the narrower. The exact interval of two strata
//! ([`robogate_stats::exact_strata`]) is the basis of requirements on the real rate.

mod corrected;
mod differences;
mod map;
mod next;
mod predictor;
mod trials;

use std::path::{Path, PathBuf};

use robogate_core::{Domain, Parameter, ParameterSpace};
use robogate_dictionary::TaskIdentity;
use robogate_stats::clusters::{Clusters, RateByCluster};
use robogate_stats::exact_strata::{self, Stratum};
use robogate_stats::format::{counted, list};
use robogate_stats::prediction_powered::{self, Predicted};
use robogate_stats::recalibration::{Posterior, log_odds};
use robogate_stats::{Confidence, Trials};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

pub use corrected::CorrectedParameter;
pub use differences::{EndingDifference, ParameterDifference, SettingsCheck};
pub use map::CorrectedMap;
pub use next::{NextTrial, NextTrials};
pub use predictor::Predictions;
pub use trials::{RealTrial, RealTrials};

use self::corrected::CorrectedModel;
use self::map::Places;
use crate::effects::Effects;
use crate::labels::parameter_label;
use crate::rate::ends;
use crate::table::EpisodeTable;
use crate::weighting::Counted;
use crate::{AnalysisError, Finding, Population, Rate, Source, Subject};

/// Shares of the population that a stratum may have.
const STRATUM: [f64; 2] = [0.15, 0.85];
/// Error of a statement about a difference.
const LEVEL: f64 = 0.05;

/// The real success rate and the differences between simulation and reality.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Transfer {
    /// The version of this document.
    pub version: u32,
    /// The simulation.
    pub simulation: Subject,
    /// Its task.
    pub task: TaskIdentity,
    /// Its success rate over the operating space.
    pub simulated: Rate,
    /// The mean of the model's predictions over the population.
    pub predicted: f64,
    /// The trials.
    pub real: RealData,
    /// The population that the real rate applies to, in one sentence.
    pub population: String,
    /// The real success rate from trials and simulation.
    pub rate: Finding<RealRate>,
    /// The success rate of the trials alone.
    pub alone: Rate,
    /// The exact interval, for requirements.
    pub exact: Finding<ExactRate>,
    /// The parameters with an effect on success in the simulation, the most influential first.
    #[serde(default)]
    pub effects: Effects,
    /// The correction of the simulation's model.
    pub correction: Correction,
    /// The corrected model over the two most influential parameters.
    #[serde(default = "unknown_map")]
    pub map: Finding<CorrectedMap>,
    /// Endings of trials and simulation. Empty if they cannot be compared.
    pub endings: Vec<EndingDifference>,
    /// Which endings are not compared, and why, in one sentence.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub not_compared: Option<String>,
    /// Effects of parameters beyond shift and slope of the corrected simulation, the most significant first.
    pub parameters: Vec<ParameterDifference>,
    /// Whether the trials' settings look like a sample of the population.
    pub settings: Vec<SettingsCheck>,
    /// The trials to run next.
    pub next: Option<NextTrials>,
}

/// The map of documents from earlier versions.
fn unknown_map() -> Finding<CorrectedMap> {
    Finding::not("it comes from an earlier version")
}

/// The file of trials.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct RealData {
    /// The path as given.
    pub path: String,
    /// SHA-256 (hex) of the file.
    pub sha256: String,
    /// Trials that are used.
    pub trials: u64,
    /// Lines of trials outside the simulated space, which are not used.
    pub outside: Vec<u64>,
    /// The groupings of the trials, with the number of groups.
    pub groupings: Vec<(String, u64)>,
    /// Columns that would group the trials, but have the same entry for all of them: the name and the entry.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub constant: Vec<(String, String)>,
    /// Parameters without any value. The prediction is averaged over them.
    pub missing: Vec<String>,
    /// Trials with other missing values.
    pub incomplete: u64,
    /// Columns that were ignored.
    pub ignored: Vec<String>,
}

/// The real success rate.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct RealRate {
    /// The estimate.
    pub rate: f64,
    /// Its 95 % interval (approximate; coverage in docs/results/transfer.md).
    pub interval_95: [f64; 2],
    /// The 95 % interval of the trials alone, for the same groups.
    pub alone_95: [f64; 2],
    /// Correlation of trials and predictions. `None` if either does not vary.
    pub correlation: Option<f64>,
    /// The weight λ of the predictions.
    pub tuning: f64,
    /// The number of independent real trials that would give an interval of this width without the simulation.
    pub worth_trials: f64,
}

/// The exact interval of the real success rate.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ExactRate {
    /// The interval: each end is wrong with probability at most 2.5 %, for any quality of the simulation.
    pub interval_95: [f64; 2],
    /// Settings with a predicted success below this are the first stratum.
    pub cut: f64,
    /// The strata, the harder one first. The first one is empty, and the second one is the whole population, if trials lack parameters, or
    /// if the simulation predicts about the same success for all of them.
    pub strata: [RealStratum; 2],
}

/// One stratum of the population.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct RealStratum {
    /// Its share of the population.
    pub share: f64,
    /// Trials in it.
    pub trials: u64,
    /// Successes among them.
    pub successes: u64,
}

/// A quantity with its 95 % interval.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct WithInterval {
    /// The posterior mean.
    pub mean: f64,
    /// The central 95 % interval of the posterior.
    pub interval_95: [f64; 2],
}

impl From<Posterior> for WithInterval {
    fn from(of: Posterior) -> Self {
        Self { mean: of.mean, interval_95: ends(of.interval) }
    }
}

/// The corrected model: log-odds of real success = shift + slope x log-odds of simulated success + the effects of single
/// parameters, each times the parameter's distance from its mean in standard deviations. Boundary and curve apply where
/// these parameters have their means.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Correction {
    /// The shift. 0 if the simulation is right.
    pub shift: WithInterval,
    /// The slope. 1 if the simulation is right, 0 if it says nothing about reality.
    pub slope: WithInterval,
    /// The parameters whose effect the trials show beyond shift and slope, the most significant first.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub parameters: Vec<CorrectedParameter>,
    /// The simulated success rate of settings whose real one is 50 %. `None` if the trials do not show that the slope is
    /// positive.
    pub boundary: Option<WithInterval>,
    /// Real success at some simulated rates.
    pub curve: Vec<CorrectedRate>,
}

/// The real success rate of settings with one simulated rate.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct CorrectedRate {
    /// The simulated rate.
    pub simulated: f64,
    /// The real rate.
    pub real: WithInterval,
}

/// The options of a transfer.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct TransferOptions {
    /// Columns that group the trials.
    pub groups: Vec<String>,
    /// The policy in the trials that is the simulated one, if its name there differs.
    pub policy: Option<String>,
    /// A file of settings that the real robot meets. Without it, the population is the simulated operating space.
    pub population: Option<PathBuf>,
}

/// A step of an inference, for a live view.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum TransferStep<'a> {
    /// The simulation was read.
    Simulated {
        /// Valid episodes over the operating space.
        episodes: u64,
        /// How many of them ended so: `success` first, then the failure modes, the most frequent first.
        endings: &'a [(&'static str, u64)],
    },
    /// The trials of the real robot were read. Those outside the simulated space are left out.
    Trials(&'a [RealTrial]),
    /// A candidate of the model was fitted to the simulation.
    Fitted {
        /// The number of fits so far.
        done: u32,
        /// The number of all fits.
        all: u32,
    },
}

/// A simulation whose model predicts trials.
pub struct Simulation<'a> {
    source: &'a Source,
    table: EpisodeTable,
    points: Vec<Vec<f64>>,
}

fn no(reason: impl Into<String>) -> AnalysisError {
    AnalysisError::NoTransfer { reason: reason.into() }
}

/// Imported rows may lack values. The model would take them as a level of their own, which trials cannot have.
fn check_numbers(table: &EpisodeTable, space: &ParameterSpace) -> Result<(), AnalysisError> {
    let incomplete = |parameter: &&Parameter| {
        let column = table.parameters.iter().find(|column| *column.name == *parameter.name);
        !matches!(parameter.domain, Domain::Categorical { .. }) && column.is_some_and(|column| !column.is_numeric())
    };
    match space.parameters().iter().find(incomplete) {
        Some(parameter) => Err(no(format!("its column `{}` has empty cells", parameter.name))),
        None => Ok(()),
    }
}

impl<'a> Simulation<'a> {
    /// Reads a simulation, and the population of the real rate.
    ///
    /// # Errors
    /// A dictionary that cannot be read, without episodes sampled from a space or with missing values, or a problem in the
    /// file of settings.
    pub fn open(source: &'a Source, population: Option<&Path>) -> Result<Self, AnalysisError> {
        let provenance = source.dictionary().provenance();
        let table = EpisodeTable::read(source.dictionary())?;
        check_numbers(&table, &provenance.space)?;
        if population.is_none() && Counted::of(&table, None).population == Population::Suite {
            return Err(no(
                "its episodes are those of a suite, not a sample of an operating space. Expected a run of `robogate run`, or \
                 the settings that the real robot meets (--population)",
            ));
        }
        let points = match population {
            Some(path) => trials::settings(path, &provenance.space)?,
            None => predictor::points(&provenance.space).map_err(no)?,
        };
        if table.sample(false).len() == 0 {
            return Err(no("it has no valid episode over its operating space"));
        }
        Ok(Self { source, table, points })
    }

    /// The space of its parameters.
    pub fn space(&self) -> &ParameterSpace {
        &self.source.dictionary().provenance().space
    }

    /// The predictions for trials and population.
    ///
    /// # Errors
    /// If the episodes do not determine a model.
    pub fn predictions(&self, trials: &RealTrials) -> Result<Predictions, AnalysisError> {
        self.predictions_watched(trials, Vec::new(), &mut |_, _| {})
    }

    fn predictions_watched(
        &self,
        trials: &RealTrials,
        map: Vec<Vec<f64>>,
        fitted: &mut dyn FnMut(u32, u32),
    ) -> Result<Predictions, AnalysisError> {
        predictor::predict(&self.table, self.space(), trials, &self.points, map, fitted).map_err(no)
    }

    /// The number of valid episodes over the operating space, and of those that ended so: `success` first, then the failure
    /// modes that occurred.
    fn endings(&self) -> (u64, Vec<(&'static str, u64)>) {
        let sample = self.table.sample(false);
        let mut counts: Vec<(&'static str, u64)> = vec![("success", 0)];
        for row in &sample.rows {
            let name = self.table.outcome_name(self.table.outcome[*row as usize]);
            match counts.iter_mut().find(|(known, _)| *known == name) {
                Some((_, count)) => *count += 1,
                None => counts.push((name, 1)),
            }
        }
        counts[1..].sort_by(|a, b| b.1.cmp(&a.1).then(a.0.cmp(b.0)));
        (sample.len() as u64, counts)
    }
}

/// The strata of the population with the largest predicted difference, as counts of trials. The choice depends on the
/// settings of the trials, not on their outcomes: each stratum has at least one trial, because an empty one would leave its
/// rate unknown.
pub fn strata(predictions: &Predictions, outcomes: &[bool]) -> Option<(f64, [Stratum; 2])> {
    let mut sorted = predictions.population.clone();
    sorted.sort_by(f64::total_cmp);
    let n = sorted.len() as f64;
    let total: f64 = sorted.iter().sum();
    let tried = predictions.trials.iter().copied();
    let (least, most) = (tried.clone().reduce(f64::min)?, tried.reduce(f64::max)?);
    let (mut below, mut best) = (0.0, None);
    for (i, pair) in sorted.windows(2).enumerate() {
        below += pair[0];
        let (count, cut) = ((i + 1) as f64, 0.5 * (pair[0] + pair[1]));
        let share = count / n;
        if pair[0] < pair[1] && (STRATUM[0]..=STRATUM[1]).contains(&share) && least < cut && cut <= most {
            let gap = (total - below) / (n - count) - below / count;
            let between = share * (1.0 - share) * gap * gap;
            if best.is_none_or(|(_, _, most)| between > most) {
                best = Some((cut, share, between));
            }
        }
    }
    let (cut, share, _) = best?;
    let of = |hard: bool| {
        let inside = predictions.trials.iter().zip(outcomes).filter(|(p, _)| (**p < cut) == hard);
        Trials::count(inside.map(|(_, success)| *success))
    };
    Some((cut, [Stratum { share, trials: of(true) }, Stratum { share: 1.0 - share, trials: of(false) }]))
}

impl Transfer {
    /// The version of the document.
    pub const VERSION: u32 = 1;

    /// Infers the real success rate from a simulation and a file of trials.
    ///
    /// # Errors
    /// A problem in a file, or a simulation without a model.
    pub fn of(source: &Source, path: &Path, real: &Path, options: &TransferOptions) -> Result<Self, AnalysisError> {
        Self::watched(source, path, real, options, &mut |_| {})
    }

    /// As [`Self::of`]. `hear` receives the steps of the inference.
    ///
    /// # Errors
    /// As [`Self::of`].
    pub fn watched(
        source: &Source,
        path: &Path,
        real: &Path,
        options: &TransferOptions,
        hear: &mut dyn FnMut(TransferStep<'_>),
    ) -> Result<Self, AnalysisError> {
        let simulation = Simulation::open(source, options.population.as_deref())?;
        let (episodes, endings) = simulation.endings();
        hear(TransferStep::Simulated { episodes, endings: &endings });
        let policy = options.policy.as_deref().unwrap_or(&source.dictionary().provenance().policy);
        let trials = RealTrials::open(real, simulation.space(), &options.groups, policy)?;
        if options.policy.is_some() && !trials.names_policy {
            return Err(no(format!("{} has no column `policy`, so --policy has no effect", real.display())));
        }
        hear(TransferStep::Trials(&trials.trials));
        if trials.trials.is_empty() {
            let names: Vec<String> = trials.outside_in.iter().cloned().collect();
            let of = match &names[..] {
                [] => String::new(),
                names => format!(": all are outside in {}. Are the units the same?", list(names)),
            };
            return Err(no(format!("{} has no trial inside the simulated space{of}", real.display())));
        }
        let population = Counted::of(&simulation.table, None).population;
        let mut base = simulation.table.sample(false);
        base.depend(&simulation.table, population, &[])?;
        let effects = Effects::of(&base);
        let places = Places::of(simulation.space(), &base, &effects, predictor::training(&simulation.table).len());
        let others = map::others(&simulation.points, options.population.is_some());
        let on_map = places.estimated().map_or_else(Vec::new, |places| places.settings(&others));
        let mut fitted = |done, all| hear(TransferStep::Fitted { done, all });
        let predictions = simulation.predictions_watched(&trials, on_map, &mut fitted)?;
        Ok(assemble(&simulation, path, real, &trials, &predictions, (effects, places, &others), options))
    }

    /// Settings whose distribution differs significantly from the population.
    pub fn unlike(&self) -> impl Iterator<Item = &SettingsCheck> {
        self.settings.iter().filter(|check| check.adjusted_p <= LEVEL)
    }

    /// Endings whose rates differ significantly.
    pub fn different_endings(&self) -> impl Iterator<Item = &EndingDifference> {
        self.endings.iter().filter(|ending| ending.adjusted_p <= LEVEL)
    }

    /// Parameters with a significant effect beyond shift and slope of the corrected simulation.
    pub fn different_parameters(&self) -> impl Iterator<Item = &ParameterDifference> {
        self.parameters.iter().filter(|parameter| parameter.adjusted_p <= LEVEL)
    }
}

fn assemble(
    simulation: &Simulation<'_>,
    path: &Path,
    real: &Path,
    trials: &RealTrials,
    predictions: &Predictions,
    (effects, places, others): (Effects, Finding<Places>, &[&Vec<f64>]),
    options: &TransferOptions,
) -> Transfer {
    let space = simulation.space();
    let simulated = simulation.table.sample(false);
    let outcomes = trials.outcomes();
    let settings = differences::settings(space, trials, &simulation.points);
    let unlike = settings.iter().filter(|check| check.adjusted_p <= LEVEL);
    let unlike: Vec<String> = unlike.map(|check| parameter_label(&check.parameter)).collect();
    let population = Predicted::of(&predictions.population);
    // The points of the space are a quasi-random sequence: their mean is known far better than that of a sample.
    let population = Predicted {
        points: if options.population.is_some() { population.points } else { f64::INFINITY },
        ..population
    };
    let no_sample = if !unlike.is_empty() {
        Some(format!(
            "the trials are not a random sample of the population: their values of {} differ from it (p < 0.05). Choose \
             settings at random, or pass the settings that the real robot meets with --population",
            list(&unlike)
        ))
    } else if trials.one_setting {
        Some("all trials have the same setting, and say nothing about other settings".to_owned())
    } else {
        None
    };
    let groups = trials.groups();
    let alone = if groups.is_empty() {
        Rate::of(Trials::count(outcomes.iter().copied()))
    } else {
        let clusters: Vec<Clusters> = groups.iter().map(|of| Clusters::of_labels(of.iter().copied())).collect();
        Rate::by_cluster(&RateByCluster::of(&clusters.iter().collect::<Vec<_>>(), &outcomes, |_| true))
    };
    let rate = match &no_sample {
        Some(because) => Finding::not(because.clone()),
        None => prediction_powered::rate(&outcomes, &predictions.trials, population, &groups, Confidence::P95)
            .map(|found| RealRate {
                rate: found.rate,
                interval_95: ends(found.interval),
                alone_95: ends(found.alone),
                correlation: found.correlation,
                tuning: found.tuning,
                worth_trials: found.worth,
            })
            .into(),
    };
    let exact = if let Some(because) = &no_sample {
        Finding::not(because.clone())
    } else if let Some((name, _)) = trials.groupings.first() {
        Finding::not(format!("the trials share groups ({name}), and the exact test needs independent trials"))
    } else {
        // The shares of the strata are those of complete settings. Without strata the trials speak alone.
        let complete = trials.missing.is_empty() && trials.incomplete == 0;
        let divided = if complete { strata(predictions, &outcomes) } else { None };
        let (cut, strata) = divided.unwrap_or_else(|| {
            let all = Stratum { share: 1.0, trials: Trials::count(outcomes.iter().copied()) };
            (0.0, [Stratum { share: 0.0, trials: Trials::NONE }, all])
        });
        Finding::Estimated(ExactRate {
            interval_95: ends(exact_strata::bounds(strata, Confidence::P95.tail())),
            cut,
            strata: strata.map(|s| RealStratum {
                share: s.share,
                trials: s.trials.n(),
                successes: s.trials.successes(),
            }),
        })
    };
    let design_effect = prediction_powered::design_effect(&outcomes, &groups, Confidence::P95);
    let episodes = predictor::training(&simulation.table).len();
    let (model, mut parameters) =
        CorrectedModel::of(space, trials, (&predictions.trials, episodes), &simulation.points, design_effect);
    let posterior = model.posterior();
    let curve = [0.1, 0.3, 0.5, 0.7, 0.9]
        .map(|simulated| CorrectedRate { simulated, real: posterior.success(log_odds(simulated), &[]).into() });
    parameters.sort_by(|a, b| a.adjusted_p.total_cmp(&b.adjusted_p).then(b.effect.abs().total_cmp(&a.effect.abs())));
    let next = no_sample.is_none().then(|| {
        let n = outcomes.len() as f64;
        // Too few trials have no rate with the simulation yet.
        let ([low, high], worth) = match rate.estimated() {
            Some(found) => (found.interval_95, found.worth_trials),
            None => (alone.wilson_95, n),
        };
        let corrected = |p: f64, setting: &[f64]| model.success(p, setting).mean;
        next::next(space, &simulation.points, &predictions.population, corrected, 0.5 * (high - low), [n, worth])
    });
    let (endings, not_compared) = if no_sample.is_some() {
        let because = "Rates of success and failure modes are not compared, because the trials are not a random sample of the \
                       operating space.";
        (Vec::new(), Some(because.to_owned()))
    } else if options.population.is_some() {
        let because = "Rates of success and failure modes are not compared, because those of the simulation are rates over its \
                       operating space.";
        (Vec::new(), Some(because.to_owned()))
    } else {
        let missing = Some(trials.without_mode()).filter(|count| trials.has_modes && *count > 0);
        let because = missing.map(|count| {
            format!(
                "Failure modes are not compared, because {} not name theirs.",
                counted(count, "failed trial") + if count == 1 { " does" } else { " do" }
            )
        });
        (differences::endings(&simulation.table, &simulated, trials), because)
    };
    Transfer {
        version: Transfer::VERSION,
        simulation: Subject::of(simulation.source, path),
        task: TaskIdentity::of(&simulation.source.dictionary().provenance().task),
        simulated: Rate::of(Trials::count(simulated.success.iter().copied())),
        predicted: population.mean,
        real: RealData {
            path: real.display().to_string(),
            sha256: trials.sha256.clone(),
            trials: outcomes.len() as u64,
            outside: trials.outside.clone(),
            groupings: trials
                .groupings
                .iter()
                .map(|(name, groups)| (name.clone(), groups.iter().max().map_or(0, |most| *most as u64 + 1)))
                .collect(),
            constant: trials.constant.clone(),
            missing: trials.missing.clone(),
            incomplete: trials.incomplete,
            ignored: trials.ignored.clone(),
        },
        population: match &options.population {
            Some(path) => format!("the settings in {}", path.display()),
            None => format!("the operating space `{}` of the simulation", space.name()),
        },
        rate,
        alone,
        exact,
        effects,
        correction: Correction {
            shift: posterior.shift().into(),
            slope: posterior.slope().into(),
            parameters: model.parameters(),
            boundary: posterior.boundary(0.5).map(WithInterval::from),
            curve: curve.to_vec(),
        },
        map: match places {
            Finding::Estimated(places) => Finding::Estimated(places.map(&predictions.map, others, trials, &model)),
            Finding::CannotBeEstimated { because } => Finding::CannotBeEstimated { because },
        },
        endings,
        not_compared,
        parameters,
        settings,
        next,
    }
}
