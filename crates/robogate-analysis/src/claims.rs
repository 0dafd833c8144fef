//! Claims of the headline, as data: failure regions, and advice that the figures support.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::marginal::{Cell, Correlation, CriticalThreshold, MarginalEffect, ParameterType, Zone};
use crate::replay::ReplayReason;
use crate::{Analysis, Population};

/// Maximum number of failure regions.
const MAX_REGIONS: usize = 3;
/// Maximum number of recommendations that name a parameter.
const MAX_ADVICE: usize = 2;
/// Share of the bootstrap replicates that must cross 50 % before advice names a threshold.
const MIN_CROSSING_SHARE: f64 = 0.95;
/// Invalid episodes come first in the advice if there is more than one of them per this many valid ones.
const VALID_PER_INVALID: u64 = 50;
/// Valid episodes that a cell needs before advice names it.
const MIN_EPISODES: u64 = 20;

/// The claims that the headline may state.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Claims {
    /// Where the policy fails: neighbouring cells of one parameter that are all danger zones and below the overall
    /// rate. The parameter that is most correlated with success comes first.
    pub failure_regions: Vec<FailureRegion>,
    /// Recommendations, the most urgent first.
    pub advice: Vec<Advice>,
}

/// Neighbouring cells of one parameter in which the policy fails.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct FailureRegion {
    /// The parameter.
    pub parameter: String,
    /// The first cell of the region, and the last one.
    pub cells: [String; 2],
    /// The values that it covers; absent for levels.
    pub range: Option<[f64; 2]>,
    /// Success rate in it.
    pub rate: f64,
    /// Valid episodes in it.
    pub n: u64,
}

/// A cell of a parameter with its observed rate.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct RatedCell {
    /// The cell.
    pub cell: String,
    /// Its success rate.
    pub rate: f64,
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
    /// Keep a parameter on one side of its critical threshold.
    Keep {
        /// The parameter.
        parameter: String,
        /// Whether to stay above the threshold, otherwise below it.
        above: bool,
        /// The threshold, in the parameter's unit.
        threshold: f64,
    },
    /// Narrow the range of a parameter.
    Narrow {
        /// The parameter.
        parameter: String,
        /// Its cell with the highest success rate.
        best: RatedCell,
        /// Its cell with the lowest.
        worst: RatedCell,
    },
    /// These parameters are sampled jointly, so there is no advice on one of them alone.
    Joint {
        /// The parameters.
        parameters: Vec<String>,
    },
    /// Operate in the safe cells of a map, or in none if none is safe.
    Operate {
        /// The parameters of the map: upwards and across.
        parameters: [String; 2],
        /// The number of safe cells.
        safe_cells: u64,
    },
    /// Replay the failures that the risk model did not expect.
    Replay {
        /// The first of them.
        episode: u64,
    },
}

pub(crate) fn claims(analysis: &Analysis) -> Claims {
    Claims { failure_regions: failure_regions(analysis), advice: advice(analysis) }
}

/// The strength of a parameter's correlation with success. 0 if it cannot be estimated.
fn strength(effect: &MarginalEffect) -> f64 {
    effect.correlation.estimated().map_or(0.0, |c| c.strength())
}

/// For each parameter, the region around its worst cell.
fn failure_regions(analysis: &Analysis) -> Vec<FailureRegion> {
    let overall = analysis.success.rate.rate.unwrap_or(0.0);
    let mut found: Vec<(f64, FailureRegion)> = Vec::new();
    for effect in &analysis.marginal_effects {
        let zones = &analysis.danger_zones.zones;
        let fails = |cell: &Cell| {
            let zone =
                |z: &&crate::DangerZone| z.significant && z.parameter == effect.parameter && z.cell == cell.label;
            cell.rate.wilson_95[1] < overall && zones.iter().any(|z| zone(&z))
        };
        let cells = &effect.cells;
        let low = |i: &usize| cells[*i].rate.rate.unwrap_or(1.0);
        let Some(worst) = (0..cells.len()).filter(|i| fails(&cells[*i])).min_by(|a, b| low(a).total_cmp(&low(b)))
        else {
            continue;
        };
        let (mut from, mut to) = (worst, worst);
        // Categories have no neighbours.
        if !matches!(effect.kind, ParameterType::Categorical) {
            while from > 0 && fails(&cells[from - 1]) {
                from -= 1;
            }
            while to + 1 < cells.len() && fails(&cells[to + 1]) {
                to += 1;
            }
        }
        let n: u64 = cells[from..=to].iter().map(|c| c.rate.n).sum();
        let successes: u64 = cells[from..=to].iter().map(|c| c.rate.successes).sum();
        let range = match (cells[from].range, cells[to].range) {
            (Some([low, _]), Some([_, high])) => Some([low, high]),
            _ => None,
        };
        let region = FailureRegion {
            parameter: effect.parameter.clone(),
            cells: [from, to].map(|i| cells[i].label.clone()),
            range,
            rate: successes as f64 / n.max(1) as f64,
            n,
        };
        found.push((strength(effect), region));
    }
    found.sort_by(|a, b| b.0.total_cmp(&a.0));
    found.into_iter().take(MAX_REGIONS).map(|(_, region)| region).collect()
}

fn advice(analysis: &Analysis) -> Vec<Advice> {
    let rate = &analysis.success.rate;
    if rate.n == 0 {
        return vec![Advice::ExplainInvalid];
    }
    let mut advice = Vec::new();
    let invalid = analysis.success.bounds.invalid;
    if invalid * VALID_PER_INVALID > rate.n {
        advice.push(Advice::ReduceInvalid { invalid });
    }
    let limits = thresholds(analysis);
    if limits.is_empty() {
        advice.extend(ranges(analysis))
    } else {
        advice.extend(limits)
    }
    let parameters = analysis.jointly_sampled();
    if !parameters.is_empty() {
        advice.push(Advice::Joint { parameters });
    }
    // In a suite, a cell of the map contains a few selected scenarios, so it cannot be recommended.
    let map = analysis.envelopes.first().and_then(|e| e.map.estimated());
    if let Some(map) = map.filter(|_| analysis.population != Population::Suite) {
        let safe = map.cells.iter().filter(|c| c.zone == Zone::Safe).count();
        let parameters = [map.y.parameter.clone(), map.x.parameter.clone()];
        advice.push(Advice::Operate { parameters, safe_cells: safe as u64 });
    }
    let unexpected = analysis.replay.iter().find(|group| group.reason == ReplayReason::UnexpectedFailure);
    if let (Some(first), true) = (unexpected.and_then(|g| g.episodes.first()), analysis.subject.replayable) {
        advice.push(Advice::Replay { episode: first.index });
    }
    advice
}

/// The thresholds with the highest bootstrap support.
fn thresholds(analysis: &Analysis) -> Vec<Advice> {
    let mut found: Vec<(f64, Advice)> = analysis
        .marginal_effects
        .iter()
        .filter(|effect| !analysis.is_jointly_sampled(&effect.parameter))
        .filter_map(|effect| match effect.threshold.estimated()? {
            CriticalThreshold::Crosses { at, rising, crossing_share, .. } if *crossing_share >= MIN_CROSSING_SHARE => {
                let parameter = effect.parameter.clone();
                Some((strength(effect), Advice::Keep { parameter, above: *rising, threshold: *at }))
            }
            _ => None,
        })
        .collect();
    found.sort_by(|a, b| b.0.total_cmp(&a.0));
    found.into_iter().take(MAX_ADVICE).map(|(_, advice)| advice).collect()
}

/// The parameters with the strongest correlation, with their best and worst cells.
fn ranges(analysis: &Analysis) -> Vec<Advice> {
    let advised = |effect: &&MarginalEffect| matters(effect) && !analysis.is_jointly_sampled(&effect.parameter);
    let mut ranked: Vec<&MarginalEffect> = analysis.marginal_effects.iter().filter(advised).collect();
    ranked.sort_by(|a, b| strength(b).total_cmp(&strength(a)));
    ranked
        .into_iter()
        .take(MAX_ADVICE)
        .filter_map(|effect| {
            let rated = |pick: fn(f64, f64) -> bool| {
                let mut best: Option<RatedCell> = None;
                for cell in effect.cells.iter().filter(|c| c.rate.n >= MIN_EPISODES) {
                    if let Some(rate) = cell.rate.rate.filter(|r| best.as_ref().is_none_or(|b| pick(*r, b.rate))) {
                        best = Some(RatedCell { cell: cell.label.clone(), rate });
                    }
                }
                best
            };
            let (best, worst) = (rated(|a, b| a > b)?, rated(|a, b| a < b)?);
            Some(Advice::Narrow { parameter: effect.parameter.clone(), best, worst })
        })
        .collect()
}

/// Whether a parameter is correlated with success. The limit of 0.001 keeps false positives rare for many parameters.
fn matters(effect: &MarginalEffect) -> bool {
    let ln_p = match effect.correlation.estimated() {
        Some(Correlation::Number { ln_p, .. }) => *ln_p,
        Some(Correlation::Category { ln_p, .. }) => Some(*ln_p),
        None => None,
    };
    ln_p.is_some_and(|p| p < 0.001_f64.ln())
}
