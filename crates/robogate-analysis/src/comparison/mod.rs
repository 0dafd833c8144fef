//! Comparison of datasets: robots, policies, simulators.

mod axis;
mod common;
mod dataset;
mod differences;
mod error;
mod marginal;
mod paired;
mod reach;
mod sensitivity;
mod universal;

use std::path::PathBuf;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

pub use differences::RateDifference;
pub use error::ComparisonError;
pub use marginal::{SharedCell, SharedCurve};
pub use paired::{CrossTable, DisagreementCell, DisagreementMap, Flip, PairedComparison, PairedInvalid};
pub use reach::ReachRow;
pub use sensitivity::{Effect, Sensitivity, Slope};
pub use universal::{UniversalZone, UniversalZones, ZoneSide};

use crate::analysis::Subject;
use crate::comparison::axis::SharedAxis;
use crate::comparison::dataset::Dataset;
use crate::danger::DANGER_LIMIT;
use crate::failures::FailureModes;
use crate::rate::Finding;
use crate::task::TaskAnalysis;
use crate::{AnalysisError, Population, Source, Success};

/// Comparison of several datasets. Only estimates of an operating space are compared. Other datasets are listed with
/// the reason.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Comparison {
    /// The version of this document.
    pub version: u32,
    /// The datasets, in the order given.
    pub datasets: Vec<ComparedDataset>,
    /// Names of the compared datasets, in their order. All lists of rates below have this order.
    pub compared: Vec<String>,
    /// The shared parameters, and those that are not shared.
    pub parameters: SharedParameters,
    /// Differences of success rates between pairs of datasets, paired if both ran the same scenarios. Empty if `paired`
    /// contains them.
    pub differences: Vec<RateDifference>,
    /// Paired comparisons of the same scenarios. Empty unless requested.
    pub paired: Vec<PairedComparison>,
    /// How the datasets were restricted to the shared part of their spaces, in sentences. Empty if their spaces agree.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub restricted: Vec<String>,
    /// The marginal effect of each shared parameter, in the same bins for every dataset.
    pub marginal_effects: Vec<SharedCurve>,
    /// Cells in which all of them fail most of the time.
    pub universal_zones: UniversalZones,
    /// The effect of the parameter that the task declares for comparisons.
    pub sensitivity: Finding<Sensitivity>,
    /// Workspace and reach of each robot.
    pub reach: Vec<ReachRow>,
}

/// One dataset of a comparison.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ComparedDataset {
    /// Its name in this comparison.
    pub name: String,
    /// The dictionary.
    pub subject: Subject,
    /// The population of its figures.
    pub population: Population,
    /// Why it is not compared. `None` if it is compared.
    pub excluded_because: Option<String>,
    /// How often it succeeds.
    pub success: Success,
    /// How it fails.
    pub failure_modes: FailureModes,
}

/// The parameters of the datasets.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct SharedParameters {
    /// Parameters that all compared datasets share.
    pub shared: Vec<String>,
    /// Parameters that they do not share.
    pub not_shared: Vec<NotShared>,
}

/// A parameter that not all datasets share.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct NotShared {
    /// The parameter.
    pub parameter: String,
    /// The compared datasets that have it.
    pub datasets: Vec<String>,
    /// Why it is not shared.
    pub because: String,
}

/// Options of a comparison.
#[derive(Debug, Clone, PartialEq)]
pub struct ComparisonOptions {
    /// Names of the datasets in their order. Empty: chosen from their provenance.
    pub names: Vec<String>,
    /// The success rate below which a cell is a danger zone.
    pub danger_limit: f64,
    /// The two parameters whose cells are compared. `None`: the task's pair, if it is shared.
    pub pair: Option<(String, String)>,
    /// Reach of robots in metres, by the name of the dataset.
    pub reach_m: Vec<(String, f64)>,
    /// Distance from base to workspace in metres, for datasets that do not record it.
    pub workspace_m: Option<f64>,
    /// Whether to pair the runs scenario by scenario.
    pub paired: bool,
    /// Whether datasets with different spaces are restricted to the shared part. Otherwise they are rejected.
    pub common: bool,
    /// Number of flips that are listed for each direction.
    pub max_flips: usize,
    /// Columns whose equal values mark rows that depend on each other. Empty: found by their names and by equal settings.
    pub groups: Vec<String>,
}

impl Default for ComparisonOptions {
    fn default() -> Self {
        Self {
            names: Vec::new(),
            danger_limit: DANGER_LIMIT,
            pair: None,
            reach_m: Vec::new(),
            workspace_m: None,
            paired: false,
            common: false,
            max_flips: 10,
            groups: Vec::new(),
        }
    }
}

impl Comparison {
    /// The version of the document that this build writes.
    pub const VERSION: u32 = 3;

    /// Compares sources. Each comes with the path that it was opened from.
    ///
    /// # Errors
    /// Fewer than two sources, a duplicate source, an invalid option, or `paired` without the same scenarios.
    pub fn of(sources: &[(Source, PathBuf)], options: &ComparisonOptions) -> Result<Self, ComparisonError> {
        dataset::check_distinct(sources)?;
        let names = dataset::names(sources, &options.names)?;
        check(options, &names)?;
        let all =
            sources.iter().zip(names).map(|((source, path), name)| Dataset::read(source, path, name, &options.groups));
        let mut all: Vec<Dataset<'_>> = all.collect::<Result<_, AnalysisError>>()?;
        common::check_tasks(&all)?;
        // Pairs of the same scenarios have the same space by construction.
        let restricted = if options.paired { Vec::new() } else { common::restrict(&mut all, options.common)? };
        let compared: Vec<&Dataset<'_>> = all.iter().filter(|dataset| dataset.excluded_because().is_none()).collect();
        let (parameters, axes) = shared(&compared);
        let task = task(&compared);
        let pair = pair(&compared, &axes, options, task)?;
        let smallest = compared.iter().map(|dataset| dataset.base.len()).min().unwrap_or(0);
        // The number of cells leaves about 25 episodes of the smallest dataset for each.
        let side = ((smallest / 25) as f64).sqrt() as usize;
        let coarse = pair.as_ref().and_then(|(up, across)| {
            let axis = |parameter: &str| SharedAxis::of(&compared, parameter, side.clamp(2, 5)).ok();
            Some((axis(up)?, axis(across)?))
        });
        let names_of_pair = pair.as_ref().map(|(up, across)| (up.as_str(), across.as_str()));
        let paired = if options.paired {
            paired::paired(&all.iter().collect::<Vec<_>>(), names_of_pair, options.max_flips)?
        } else {
            Vec::new()
        };
        Ok(Self {
            version: Self::VERSION,
            compared: compared.iter().map(|dataset| dataset.name.clone()).collect(),
            parameters,
            differences: if options.paired { Vec::new() } else { differences::differences(&compared)? },
            paired,
            marginal_effects: axes.iter().map(|axis| marginal::curve(&compared, axis)).collect(),
            universal_zones: if compared.len() < 2 {
                universal::universal(&[], &[], None, options.danger_limit)
            } else {
                let coarse = coarse.as_ref().map(|(up, across)| (up, across));
                universal::universal(&compared, &axes, coarse, options.danger_limit)
            },
            restricted,
            sensitivity: sensitivity::sensitivity(&compared, &axes, task.sensitivity),
            reach: reach::reach(&compared, &options.reach_m, options.workspace_m),
            datasets: all.iter().map(compared_dataset).collect(),
        })
    }

    /// Whether at least two datasets are compared.
    pub fn has_evidence(&self) -> bool {
        if self.paired.is_empty() { self.compared.len() >= 2 } else { self.paired.iter().any(|of| of.valid_pairs > 0) }
    }
}

fn compared_dataset(dataset: &Dataset<'_>) -> ComparedDataset {
    ComparedDataset {
        name: dataset.name.clone(),
        subject: Subject::of(dataset.source, dataset.path),
        population: dataset.population,
        excluded_because: dataset.excluded_because().map(str::to_owned),
        success: Success::of(&dataset.table, &dataset.base, dataset.population, dataset.weighting.as_ref()),
        failure_modes: FailureModes::of(&dataset.table, &dataset.base),
    }
}

fn check(options: &ComparisonOptions, names: &[String]) -> Result<(), ComparisonError> {
    let limit = options.danger_limit;
    if !(limit > 0.0 && limit < 1.0) {
        let expected = "a success rate in (0, 1), such as 0.4 for 40 %";
        return Err(ComparisonError::Setting { setting: "the danger limit", value: limit, expected });
    }
    let lengths = options.reach_m.iter().map(|(_, reach)| ("the reach", *reach));
    for (setting, value) in lengths.chain(options.workspace_m.map(|workspace| ("the workspace distance", workspace))) {
        if !(value > 0.0 && value.is_finite()) {
            return Err(ComparisonError::Setting { setting, value, expected: "a positive length in metres" });
        }
    }
    match options.reach_m.iter().find(|(name, _)| !names.contains(name)) {
        Some((name, _)) => Err(ComparisonError::NoSuchName { name: name.clone(), known: names.join(", ") }),
        None => Ok(()),
    }
}

/// The shared parameters, with equal bins for all datasets, and those that are not shared.
fn shared(datasets: &[&Dataset<'_>]) -> (SharedParameters, Vec<SharedAxis>) {
    let smallest = datasets.iter().map(|dataset| dataset.base.len()).min().unwrap_or(0);
    let bins = (smallest / 25).clamp(3, crate::marginal::BINS);
    let mut all: Vec<&str> = Vec::new();
    for column in datasets.iter().flat_map(|dataset| &dataset.base.parameters) {
        if !all.contains(&column.name.as_str()) {
            all.push(&column.name);
        }
    }
    let mut parameters = SharedParameters { shared: Vec::new(), not_shared: Vec::new() };
    let mut axes = Vec::new();
    for parameter in all {
        match SharedAxis::of(datasets, parameter, bins) {
            Ok(axis) => {
                parameters.shared.push(parameter.to_owned());
                axes.push(axis);
            }
            Err(because) => {
                let has = datasets.iter().filter(|dataset| dataset.parameter(parameter).is_some());
                let datasets = has.map(|dataset| dataset.name.clone()).collect();
                parameters.not_shared.push(NotShared { parameter: parameter.to_owned(), datasets, because });
            }
        }
    }
    (parameters, axes)
}

/// The plug-in of the task that all of them ran, or an empty one if the tasks differ.
fn task(datasets: &[&Dataset<'_>]) -> &'static TaskAnalysis {
    let mut names = datasets.iter().map(|dataset| TaskAnalysis::of_dictionary(dataset.provenance()).task);
    let first = names.next().unwrap_or_default();
    TaskAnalysis::of(if names.all(|name| name == first) { first } else { "" })
}

/// The pair that is compared: the requested one, otherwise that of the task, otherwise the first two numeric
/// parameters.
fn pair(
    datasets: &[&Dataset<'_>],
    axes: &[SharedAxis],
    options: &ComparisonOptions,
    task: &TaskAnalysis,
) -> Result<Option<(String, String)>, ComparisonError> {
    let shared: Vec<&str> = axes.iter().map(|axis| axis.axis.parameter.as_str()).collect();
    let Some((up, across)) = &options.pair else {
        let both = |up: &str, across: &str| (up.to_owned(), across.to_owned());
        if let Some([up, across]) = task.envelope.filter(|pair| pair.iter().all(|name| shared.contains(name))) {
            return Ok(Some(both(up, across)));
        }
        let number = |name: &&&str| datasets.iter().all(|e| e.parameter(name).is_some_and(|p| p.is_numeric()));
        let numbers: Vec<&&str> = shared.iter().filter(number).collect();
        return Ok(match numbers.as_slice() {
            [up, across, ..] => Some(both(up, across)),
            _ => None,
        });
    };
    for name in [up, across] {
        if !shared.contains(&name.as_str()) {
            let because = SharedAxis::of(datasets, name, 3).err();
            return Err(ComparisonError::Pair {
                name: name.clone(),
                reason: because.unwrap_or_else(|| "the datasets do not share it".to_owned()),
                known: shared.join(", "),
            });
        }
    }
    if up == across {
        return Err(ComparisonError::Pair {
            name: up.clone(),
            reason: "a pair needs two different parameters".to_owned(),
            known: shared.join(", "),
        });
    }
    Ok(Some((up.clone(), across.clone())))
}
