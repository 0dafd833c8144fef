//! What the headline may state: the failure regions and the advice that the figures support, as data.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::along::{Along, AlongKind, Cell, Correlation, CriticalThreshold, Zone};
use crate::replay::ReplayReason;
use crate::{Analysis, Population};

/// Failure regions and advice at most, of each kind.
const MOST_REGIONS: usize = 3;
/// Pieces of advice at most that name a parameter.
const MOST_ADVICE: usize = 2;
/// A crossing of 50 % is advised on where at least this share of the bootstrap replicates cross.
const SURE_CROSSING: f64 = 0.95;
/// Invalid episodes are named first where they are more than one in so many of the valid ones.
const MANY_INVALID: u64 = 50;
/// Valid episodes that a cell must have to be named in advice.
const FEWEST: u64 = 20;

/// What the headline may state.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Claims {
    /// Where the policy fails: neighbouring cells of one parameter that are all danger zones and below the overall rate. The
    /// parameter that is most correlated with success comes first.
    pub failure_regions: Vec<FailureRegion>,
    /// What to do, the most urgent first.
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

/// One cell of a parameter and its observed rate.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct RatedCell {
    /// The cell.
    pub cell: String,
    /// Its success rate.
    pub rate: f64,
}

/// One piece of advice.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case", tag = "kind")]
pub enum Advice {
    /// No episode is valid: find out why.
    ExplainInvalid,
    /// More than 2 % of the evidence is invalid: look into it first.
    ReduceInvalid {
        /// Invalid episodes.
        invalid: u64,
    },
    /// Keep a parameter on one side of its critical threshold.
    Keep {
        /// The parameter.
        parameter: String,
        /// Whether to keep it above the threshold, else below.
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
    /// These parameters are sampled jointly, so that none of them is advised on alone.
    Joint {
        /// The parameters.
        parameters: Vec<String>,
    },
    /// The cells of a map that are safe: operate there. None of them: rely on none.
    Operate {
        /// The parameters of the map: upwards and across.
        parameters: [String; 2],
        /// How many of its cells are safe.
        safe_cells: u64,
    },
    /// Watch the failures that the risk model did not expect.
    Watch {
        /// The first of them.
        episode: u64,
    },
}

pub(crate) fn claims(analysis: &Analysis) -> Claims {
    Claims { failure_regions: failure_regions(analysis), advice: advice(analysis) }
}

/// How strongly a parameter is correlated with success; 0 where that cannot be estimated.
fn strength(along: &Along) -> f64 {
    along.correlation.estimated().map_or(0.0, |c| c.strength())
}

/// For each parameter the region around its worst cell.
fn failure_regions(analysis: &Analysis) -> Vec<FailureRegion> {
    let overall = analysis.success.rate.rate.unwrap_or(0.0);
    let mut found: Vec<(f64, FailureRegion)> = Vec::new();
    for along in &analysis.along {
        let zones = &analysis.danger_zones.zones;
        let fails = |cell: &Cell| {
            let zone = |z: &&crate::DangerZone| z.sure && z.parameter == along.parameter && z.cell == cell.label;
            cell.rate.wilson_95[1] < overall && zones.iter().any(|z| zone(&z))
        };
        let cells = &along.cells;
        let low = |i: &usize| cells[*i].rate.rate.unwrap_or(1.0);
        let Some(worst) = (0..cells.len()).filter(|i| fails(&cells[*i])).min_by(|a, b| low(a).total_cmp(&low(b)))
        else {
            continue;
        };
        let (mut from, mut to) = (worst, worst);
        // Categories have no neighbours.
        if !matches!(along.kind, AlongKind::Categorical) {
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
            parameter: along.parameter.clone(),
            cells: [from, to].map(|i| cells[i].label.clone()),
            range,
            rate: successes as f64 / n.max(1) as f64,
            n,
        };
        found.push((strength(along), region));
    }
    found.sort_by(|a, b| b.0.total_cmp(&a.0));
    found.into_iter().take(MOST_REGIONS).map(|(_, region)| region).collect()
}

fn advice(analysis: &Analysis) -> Vec<Advice> {
    let rate = &analysis.success.rate;
    if rate.n == 0 {
        return vec![Advice::ExplainInvalid];
    }
    let mut advice = Vec::new();
    let invalid = analysis.success.bounds.invalid;
    if invalid * MANY_INVALID > rate.n {
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
    // Where the scenarios were chosen, a cell of the map is a handful of scenarios and no place to operate in.
    let map = analysis.envelopes.first().and_then(|e| e.map.estimated());
    if let Some(map) = map.filter(|_| analysis.population != Population::Suite) {
        let safe = map.cells.iter().filter(|c| c.zone == Zone::Safe).count();
        let parameters = [map.y.parameter.clone(), map.x.parameter.clone()];
        advice.push(Advice::Operate { parameters, safe_cells: safe as u64 });
    }
    let unexpected = analysis.replay.iter().find(|group| group.reason == ReplayReason::UnexpectedFailure);
    if let (Some(first), true) = (unexpected.and_then(|g| g.episodes.first()), analysis.subject.replayable) {
        advice.push(Advice::Watch { episode: first.index });
    }
    advice
}

/// The strongest critical thresholds.
fn thresholds(analysis: &Analysis) -> Vec<Advice> {
    let mut found: Vec<(f64, Advice)> = analysis
        .along
        .iter()
        .filter(|along| !analysis.is_jointly_sampled(&along.parameter))
        .filter_map(|along| match along.threshold.estimated()? {
            CriticalThreshold::Crosses { at, rising, crossing_share, .. } if *crossing_share >= SURE_CROSSING => {
                let parameter = along.parameter.clone();
                Some((strength(along), Advice::Keep { parameter, above: *rising, threshold: *at }))
            }
            _ => None,
        })
        .collect();
    found.sort_by(|a, b| b.0.total_cmp(&a.0));
    found.into_iter().take(MOST_ADVICE).map(|(_, advice)| advice).collect()
}

/// The parameters that matter most, with their best and worst cells.
fn ranges(analysis: &Analysis) -> Vec<Advice> {
    let advised = |along: &&Along| matters(along) && !analysis.is_jointly_sampled(&along.parameter);
    let mut ranked: Vec<&Along> = analysis.along.iter().filter(advised).collect();
    ranked.sort_by(|a, b| strength(b).total_cmp(&strength(a)));
    ranked
        .into_iter()
        .take(MOST_ADVICE)
        .filter_map(|along| {
            let rated = |pick: fn(f64, f64) -> bool| {
                let mut best: Option<RatedCell> = None;
                for cell in along.cells.iter().filter(|c| c.rate.n >= FEWEST) {
                    if let Some(rate) = cell.rate.rate.filter(|r| best.as_ref().is_none_or(|b| pick(*r, b.rate))) {
                        best = Some(RatedCell { cell: cell.label.clone(), rate });
                    }
                }
                best
            };
            let (best, worst) = (rated(|a, b| a > b)?, rated(|a, b| a < b)?);
            Some(Advice::Narrow { parameter: along.parameter.clone(), best, worst })
        })
        .collect()
}

/// Whether a parameter is correlated with success: a p-value far below what many looks would give by chance.
fn matters(along: &Along) -> bool {
    let ln_p = match along.correlation.estimated() {
        Some(Correlation::Number { ln_p, .. }) => *ln_p,
        Some(Correlation::Category { ln_p, .. }) => Some(*ln_p),
        None => None,
    };
    ln_p.is_some_and(|p| p < 0.001_f64.ln())
}
