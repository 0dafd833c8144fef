//! Success rates of the stages and of the operating space.

mod control;

use robogate_core::FEASIBLE;
use robogate_stats::weighted::{effective_sample_size, hajek};
use robogate_stats::{Confidence, Trials};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::rate::ends;
use crate::rate::{Finding, Population, Rate};
use crate::table::{ACTIVE, Ending, EpisodeTable, Sample};
use crate::weighting::Weighting;

/// How often the policy succeeds.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Success {
    /// The population of the headline rate.
    pub population: Population,
    /// The success rate that all other figures refer to.
    pub rate: Rate,
    /// The rate over the episodes whose scenario some policy may complete. Absent if the task does not check feasibility.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub feasible: Option<Rate>,
    /// Bounds of the rate for all possible outcomes of the invalid episodes.
    pub bounds: InvalidBounds,
    /// Each stage separately.
    pub stages: Vec<StageSuccess>,
    /// How rows of several designs count together, if the points of some were chosen. Otherwise every row counts once. Without
    /// known weights, the chosen rows are left out.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub weighting: Option<Finding<Weighting>>,
    /// The rate with the known distribution of the parameters as a control variate, for rows from the operating space.
    #[serde(default)]
    pub adjusted: Option<Finding<Adjusted>>,
}

/// A rate with less variance than that of independent episodes.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Adjusted {
    /// The estimate.
    pub rate: f64,
    /// Its standard error.
    pub se: f64,
    /// Its 95 % interval.
    pub interval_95: [f64; 2],
    /// The number of independent episodes that would give the same standard error.
    pub effective_episodes: f64,
    /// Parameters whose known distribution is used.
    pub parameters: u64,
}

/// Invalid episodes, and their possible effect on the rate.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct InvalidBounds {
    /// Invalid episodes in the population of the headline.
    pub invalid: u64,
    /// The rate if all of them had failed. `None` without episodes.
    pub worst_case: Option<f64>,
    /// The rate if all of them had succeeded. `None` without episodes.
    pub best_case: Option<f64>,
    /// Faults of all stages, with their counts.
    pub faults: Vec<FaultCount>,
}

/// The count of one class of fault.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct FaultCount {
    /// The class of fault.
    pub fault: String,
    /// Episodes with this fault.
    pub episodes: u64,
}

/// One stage.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct StageSuccess {
    /// The stage's name.
    pub stage: String,
    /// The samplers of its points.
    pub designs: Vec<String>,
    /// The population of its rate.
    pub population: Population,
    /// Its episodes, including invalid ones.
    pub episodes: u64,
    /// Invalid episodes among them.
    pub invalid: u64,
    /// Its rate over valid episodes, unweighted.
    pub rate: Rate,
    /// Smallest and largest stored weight. `None` without valid episodes.
    pub weights: Option<[f64; 2]>,
    /// Kish's effective sample size of its weights.
    pub effective_sample_size: f64,
    /// The weighted rate of a boundary stage (Hajek): it applies to the operating space inside the region of the stage. Absent for
    /// an active stage, which has no region.
    pub weighted: Option<WeightedRate>,
}

/// A weighted rate.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct WeightedRate {
    /// The rate.
    pub rate: f64,
    /// Its standard error. `None` if all outcomes are equal.
    pub se: Option<f64>,
    /// 95 % interval: Wilson's interval with the effective sample size.
    pub interval_95: [f64; 2],
    /// Kish's effective sample size.
    pub effective_sample_size: f64,
}

impl Success {
    pub(crate) fn of(
        table: &EpisodeTable,
        base: &Sample,
        population: Population,
        weighting: Option<&Finding<Weighting>>,
    ) -> Self {
        let mut stages: Vec<StageSuccess> = (0..table.stages.len()).map(|i| stage(table, i)).collect();
        stages.retain(|stage| stage.episodes > 0);
        let base_is_focused = population == Population::FocusedDesign;
        let weighted = base.weights.is_some();
        let of_base = |s: &&StageSuccess| weighted || (s.population == Population::FocusedDesign) == base_is_focused;
        let invalid: u64 = stages.iter().filter(of_base).map(|stage| stage.invalid).sum();
        let rate = Rate::of_rows(base, |_| true);
        // The rows of the headline are one stage, whose rate is the same.
        stages.iter_mut().filter(|stage| stage.rate.n == rate.n).for_each(|stage| stage.rate = rate);
        let all = rate.n + invalid;
        // An invalid episode counts as much as a valid one on average.
        let successes = rate.n as f64 * rate.rate.unwrap_or(0.0);
        let of_all = |successes: f64| (all > 0).then(|| successes / all as f64);
        Self {
            population,
            rate,
            feasible: feasible(table, base),
            bounds: InvalidBounds {
                invalid,
                worst_case: of_all(successes),
                best_case: of_all(successes + invalid as f64),
                faults: table
                    .faults
                    .iter()
                    .map(|(fault, episodes)| FaultCount { fault: fault.clone(), episodes: *episodes })
                    .collect(),
            },
            stages,
            weighting: weighting.cloned(),
            adjusted: (population == Population::OperatingSpace && !weighted && rate.n > 0)
                .then(|| control::adjusted_rate(base)),
        }
    }
}

fn feasible(table: &EpisodeTable, base: &Sample) -> Option<Rate> {
    let marked = table.measure(FEASIBLE.as_str())?;
    let known: Vec<bool> = base.rows.iter().map(|row| Some(marked[*row as usize]? > 0.5)).collect::<Option<_>>()?;
    Some(Rate::of_rows(base, |row| known[row]))
}

fn stage(table: &EpisodeTable, at: usize) -> StageSuccess {
    let of = &table.stages[at];
    let mine: Vec<usize> = (0..table.len()).filter(|row| usize::from(table.stage[*row]) == at).collect();
    let valid: Vec<usize> = mine.iter().copied().filter(|row| table.outcome[*row] != Ending::Invalid).collect();
    let success: Vec<bool> = valid.iter().map(|row| table.outcome[*row] == Ending::Success).collect();
    let weights: Vec<f64> = valid.iter().map(|row| table.weight[*row]).collect();
    let low = weights.iter().copied().fold(f64::INFINITY, f64::min);
    let high = weights.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    StageSuccess {
        stage: of.name.clone(),
        designs: of.designs.clone(),
        population: if of.focused {
            Population::FocusedDesign
        } else if of.name == "imported" {
            Population::AsImported
        } else if of.name == "suite" && !table.is_fresh {
            Population::Suite
        } else {
            Population::OperatingSpace
        },
        episodes: mine.len() as u64,
        invalid: (mine.len() - valid.len()) as u64,
        rate: Rate::of(Trials::count(success.iter().copied())),
        weights: (low <= high).then_some([low, high]),
        effective_sample_size: effective_sample_size(&weights),
        // The weights of an active stage refer to all of its rows together, and these are only those that its model chose.
        weighted: (of.focused && of.name != ACTIVE).then(|| weighted(&success, &weights).ok()).flatten(),
    }
}

fn weighted(success: &[bool], weights: &[f64]) -> Result<WeightedRate, String> {
    let found = hajek(success, weights, Confidence::P95).map_err(|e| e.to_string())?;
    let rate = found.rate.ok_or("no row has weight")?;
    Ok(WeightedRate { rate, se: found.se, interval_95: ends(found.interval), effective_sample_size: found.effective })
}
