//! Dictionaries side by side: robots, policies, simulators.

mod axis;
mod curves;
mod differences;
mod entrant;
mod error;
mod paired;
mod reach;
mod sensitivity;

use std::path::PathBuf;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

pub use curves::{SharedCell, SharedCurve, UniversalZone, UniversalZones, ZoneSide};
pub use differences::RateDifference;
pub use error::ComparisonError;
pub use paired::{CrossTable, DisagreementCell, DisagreementMap, Flip, PairedComparison, PairedInvalid};
pub use reach::ReachRow;
pub use sensitivity::{Effect, Sensitivity, Slope};

use crate::analysis::Subject;
use crate::comparison::axis::SharedAxis;
use crate::comparison::entrant::Entrant;
use crate::failures::{DANGER_LIMIT, FailureModes};
use crate::rate::Finding;
use crate::task::TaskAnalysis;
use crate::{AnalysisError, Population, Source, Success};

/// Several dictionaries side by side. Only estimates of an operating space are compared; a dictionary that cannot be
/// is shown and says why.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Comparison {
    /// The version of this form.
    pub version: u32,
    /// The dictionaries, in the order given.
    pub dictionaries: Vec<ComparedDictionary>,
    /// Names of those whose figures are compared, in their order: the order of every list of rates below.
    pub compared: Vec<String>,
    /// What all of them vary, and what only some do.
    pub parameters: SharedParameters,
    /// Differences of success rates, every two of them, paired where both ran the same scenarios; empty where `paired`
    /// holds them.
    pub differences: Vec<RateDifference>,
    /// The same scenarios, run twice; empty unless asked for.
    pub paired: Vec<PairedComparison>,
    /// Success along each shared parameter, in the same bins.
    pub along: Vec<SharedCurve>,
    /// Where all of them fail most of the time.
    pub universal_zones: UniversalZones,
    /// What the parameter that the task names does to each.
    pub sensitivity: Finding<Sensitivity>,
    /// The workspace in each robot's reach.
    pub reach: Vec<ReachRow>,
}

/// One dictionary of a comparison.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ComparedDictionary {
    /// Its name in this comparison.
    pub name: String,
    /// What it holds.
    pub subject: Subject,
    /// What its figures speak of.
    pub population: Population,
    /// Why it is not compared; absent where it is.
    pub left_out: Option<String>,
    /// How often it succeeds.
    pub success: Success,
    /// How it fails.
    pub failure_modes: FailureModes,
}

/// What the dictionaries vary.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct SharedParameters {
    /// Parameters that all compared dictionaries have in common.
    pub shared: Vec<String>,
    /// Parameters that they do not.
    pub not_shared: Vec<NotShared>,
}

/// A parameter that is not common to all.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct NotShared {
    /// The parameter.
    pub parameter: String,
    /// The compared dictionaries that have it.
    pub of: Vec<String>,
    /// Why it is not shared.
    pub because: String,
}

/// How to compare.
#[derive(Debug, Clone, PartialEq)]
pub struct ComparisonOptions {
    /// Names of the dictionaries in their order; none: whatever tells them apart.
    pub names: Vec<String>,
    /// The success rate below which a cell is a danger.
    pub danger_limit: f64,
    /// The two parameters whose cells are looked at together; none: the task's pair, where it is shared.
    pub pair: Option<(String, String)>,
    /// A robot's reach in metres by the dictionary's name.
    pub reach_m: Vec<(String, f64)>,
    /// Distance from base to workspace in metres, for dictionaries that do not carry it.
    pub workspace_m: Option<f64>,
    /// Whether to pair scenario with scenario.
    pub paired: bool,
    /// Flips listed for each direction.
    pub most_flips: usize,
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
            most_flips: 10,
        }
    }
}

impl Comparison {
    /// The version of this form that is written here.
    pub const VERSION: u32 = 2;

    /// Compares sources, each with the path that it was opened from.
    ///
    /// # Errors
    /// Fewer than two of them, one of them twice, an option that names what is not there, or `paired` without the
    /// same scenarios.
    pub fn of(sources: &[(Source, PathBuf)], options: &ComparisonOptions) -> Result<Self, ComparisonError> {
        entrant::check_distinct(sources)?;
        let names = entrant::names(sources, &options.names)?;
        check(options, &names)?;
        let all = sources.iter().zip(names).map(|((source, path), name)| Entrant::read(source, path, name));
        let all: Vec<Entrant<'_>> = all.collect::<Result<_, AnalysisError>>()?;
        let compared: Vec<&Entrant<'_>> = all.iter().filter(|entrant| entrant.why_not_compared().is_none()).collect();
        let (parameters, axes) = shared(&compared);
        let task = task(&compared);
        let pair = pair(&compared, &axes, options, task)?;
        let smallest = compared.iter().map(|entrant| entrant.base.len()).min().unwrap_or(0);
        // As many cells as let each hold about 25 episodes of the smallest dictionary.
        let side = ((smallest / 25) as f64).sqrt() as usize;
        let coarse = pair.as_ref().and_then(|(up, across)| {
            let axis = |parameter: &str| SharedAxis::of(&compared, parameter, side.clamp(2, 5)).ok();
            Some((axis(up)?, axis(across)?))
        });
        let names_of_pair = pair.as_ref().map(|(up, across)| (up.as_str(), across.as_str()));
        let paired = if options.paired {
            paired::paired(&all.iter().collect::<Vec<_>>(), names_of_pair, options.most_flips)?
        } else {
            Vec::new()
        };
        Ok(Self {
            version: Self::VERSION,
            compared: compared.iter().map(|entrant| entrant.name.clone()).collect(),
            parameters,
            differences: if options.paired { Vec::new() } else { differences::differences(&compared)? },
            paired,
            along: axes.iter().map(|axis| curves::curve(&compared, axis)).collect(),
            universal_zones: if compared.len() < 2 {
                curves::universal(&[], &[], None, options.danger_limit)
            } else {
                let coarse = coarse.as_ref().map(|(up, across)| (up, across));
                curves::universal(&compared, &axes, coarse, options.danger_limit)
            },
            sensitivity: sensitivity::sensitivity(&compared, &axes, task.sensitivity),
            reach: reach::reach(&compared, &options.reach_m, options.workspace_m),
            dictionaries: all.iter().map(dictionary).collect(),
        })
    }

    /// Whether at least two of them could be compared.
    pub fn has_evidence(&self) -> bool {
        if self.paired.is_empty() { self.compared.len() >= 2 } else { self.paired.iter().any(|of| of.valid_pairs > 0) }
    }
}

fn dictionary(entrant: &Entrant<'_>) -> ComparedDictionary {
    ComparedDictionary {
        name: entrant.name.clone(),
        subject: Subject::of(entrant.source, entrant.path),
        population: entrant.population,
        left_out: entrant.why_not_compared().map(str::to_owned),
        success: Success::of(&entrant.rows, &entrant.base, entrant.focused.as_ref(), entrant.population),
        failure_modes: FailureModes::of(&entrant.rows, &entrant.base),
    }
}

fn check(options: &ComparisonOptions, names: &[String]) -> Result<(), ComparisonError> {
    let limit = options.danger_limit;
    if !(limit > 0.0 && limit < 1.0) {
        let must = "above 0 and below 1 (0.4 for 40 %)";
        return Err(ComparisonError::Setting { what: "the danger limit", value: limit, must });
    }
    let lengths = options.reach_m.iter().map(|(_, reach)| ("a reach", *reach));
    for (what, value) in lengths.chain(options.workspace_m.map(|workspace| ("the workspace's distance", workspace))) {
        if !(value > 0.0 && value.is_finite()) {
            return Err(ComparisonError::Setting { what, value, must: "above 0 metres" });
        }
    }
    match options.reach_m.iter().find(|(name, _)| !names.contains(name)) {
        Some((name, _)) => Err(ComparisonError::NoSuchName { name: name.clone(), known: names.join(", ") }),
        None => Ok(()),
    }
}

/// What is shared, cut alike for all, and what is not.
fn shared(entrants: &[&Entrant<'_>]) -> (SharedParameters, Vec<SharedAxis>) {
    let smallest = entrants.iter().map(|entrant| entrant.base.len()).min().unwrap_or(0);
    let bins = (smallest / 25).clamp(3, crate::along::BINS);
    let mut every: Vec<&str> = Vec::new();
    for column in entrants.iter().flat_map(|entrant| &entrant.base.parameters) {
        if !every.contains(&column.name.as_str()) {
            every.push(&column.name);
        }
    }
    let mut parameters = SharedParameters { shared: Vec::new(), not_shared: Vec::new() };
    let mut axes = Vec::new();
    for parameter in every {
        match SharedAxis::of(entrants, parameter, bins) {
            Ok(axis) => {
                parameters.shared.push(parameter.to_owned());
                axes.push(axis);
            }
            Err(because) => {
                let has = entrants.iter().filter(|entrant| entrant.parameter(parameter).is_some());
                let of = has.map(|entrant| entrant.name.clone()).collect();
                parameters.not_shared.push(NotShared { parameter: parameter.to_owned(), of, because });
            }
        }
    }
    (parameters, axes)
}

/// The plug-in of the task that all of them ran; of none where they differ in it.
fn task(entrants: &[&Entrant<'_>]) -> &'static TaskAnalysis {
    let mut names = entrants.iter().map(|entrant| TaskAnalysis::of_dictionary(entrant.provenance()).task);
    let first = names.next().unwrap_or_default();
    TaskAnalysis::of(if names.all(|name| name == first) { first } else { "" })
}

/// The pair that is looked at together: the one named, else the task's, else the first two numbers.
fn pair(
    entrants: &[&Entrant<'_>],
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
        let number = |name: &&&str| entrants.iter().all(|e| e.parameter(name).is_some_and(|p| p.is_numeric()));
        let numbers: Vec<&&str> = shared.iter().filter(number).collect();
        return Ok(match numbers.as_slice() {
            [up, across, ..] => Some(both(up, across)),
            _ => None,
        });
    };
    for name in [up, across] {
        if !shared.contains(&name.as_str()) {
            let because = SharedAxis::of(entrants, name, 3).err();
            return Err(ComparisonError::Pair {
                name: name.clone(),
                reason: because.unwrap_or_else(|| "it is not shared".to_owned()),
                known: shared.join(", "),
            });
        }
    }
    if up == across {
        return Err(ComparisonError::Pair {
            name: up.clone(),
            reason: "it is there twice".to_owned(),
            known: shared.join(", "),
        });
    }
    Ok(Some((up.clone(), across.clone())))
}
