//! Success rates of the stages and of the operating space.

mod control;
mod pooled;

use robogate_core::FEASIBLE;
use robogate_stats::weighted::{effective_sample_size, hajek};
use robogate_stats::{Confidence, Trials};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::rate::ends;
use crate::rate::{Finding, Population, Rate};
use crate::source::BoundaryFile;
use crate::table::{ACTIVE, Ending, EpisodeTable, ParameterKind, Sample};

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
    /// The rate over the operating space from all rows, if there are focused and other rows.
    pub reweighted: Option<Finding<Reweighted>>,
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
    /// an active stage, which has no region: its rows count in the rate from all rows.
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

/// The rate over the operating space from all rows.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Reweighted {
    /// Hajek's estimate over all valid rows.
    pub estimate: WeightedRate,
    /// Number of valid rows.
    pub rows: u64,
    /// Share of the operating distribution inside the focused region.
    pub region_share: f64,
    /// How the weights were combined.
    pub method: String,
}

impl Success {
    pub(crate) fn of(
        table: &EpisodeTable,
        base: &Sample,
        focused: Option<&Sample>,
        population: Population,
        boundary: Option<&BoundaryFile>,
    ) -> Self {
        let mut stages: Vec<StageSuccess> = (0..table.stages.len()).map(|i| stage(table, i)).collect();
        stages.retain(|stage| stage.episodes > 0);
        let base_is_focused = population == Population::FocusedDesign;
        let of_base = |s: &&StageSuccess| (s.population == Population::FocusedDesign) == base_is_focused;
        let invalid: u64 = stages.iter().filter(of_base).map(|stage| stage.invalid).sum();
        let rate = Rate::of_rows(base, |_| true);
        // The rows of the headline are one stage, whose rate is the same.
        stages.iter_mut().filter(|stage| stage.rate.n == rate.n).for_each(|stage| stage.rate = rate);
        let all = rate.n + invalid;
        let of_all = |successes: u64| (all > 0).then(|| successes as f64 / all as f64);
        Self {
            population,
            rate,
            feasible: feasible(table, base),
            bounds: InvalidBounds {
                invalid,
                worst_case: of_all(rate.successes),
                best_case: of_all(rate.successes + invalid),
                faults: table
                    .faults
                    .iter()
                    .map(|(fault, episodes)| FaultCount { fault: fault.clone(), episodes: *episodes })
                    .collect(),
            },
            stages,
            reweighted: focused.map(|focused| reweighted(table, base, focused, boundary)),
            adjusted: (population == Population::OperatingSpace && rate.n > 0).then(|| control::adjusted_rate(base)),
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
        } else if of.name == "suite" {
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

/// Combines both designs. The weights of an active stage refer to the whole operating space, as those of the uniform one
/// do, and are used as stored. With the boundary report of the run, rows have the weights of the balance heuristic
/// ([`pooled`]). Without it, the region R of the focused rows is known only if they were sampled uniformly in one box, so
/// that their stored weights are equal. Then the rows are post-stratified on R.
///
/// The stored weights p/q of the focused rows describe the operating density inside R and nothing outside it, so
/// concatenating the two sets would count R twice. Here the rows outside R (all of them from the uniform design) share
/// the mass 1 - P(R) equally. Inside R, the mass P(R) is divided between the two designs in proportion to their
/// effective sample sizes: equally among the uniform rows, by stored weight among the focused ones. R is the bounding
/// box of the focused rows, and P(R) its share of the operating distribution, whose parameters are independent.
fn reweighted(
    table: &EpisodeTable,
    base: &Sample,
    focused: &Sample,
    boundary: Option<&BoundaryFile>,
) -> Finding<Reweighted> {
    let active = focused.len() > 0 && focused.rows.iter().all(|row| table.is_active(*row as usize));
    let (found, method) = match boundary.filter(|b| b.volume.episodes > 0) {
        _ if active => {
            let stored =
                [base, focused].into_iter().flat_map(|sample| &sample.rows).map(|row| table.weight[*row as usize]);
            let success = base.success.iter().chain(&focused.success).copied().collect();
            (
                Ok((success, stored.collect(), 1.0)),
                "each row by its stored weight, which refers to the whole operating space",
            )
        }
        Some(boundary) => (
            pooled::weights(table, base, focused, boundary),
            "each row by the pooled density of both designs (balance heuristic)",
        ),
        None if !equal_weights(table, focused) => {
            return Finding::not(
                "the focused rows come from several regions, which are described in the run's folder only: analyse the folder",
            );
        }
        None => (
            combined_weights(table, base, focused),
            "post-stratified on the bounding box of the focused rows: outside it the uniform rows only, inside it both \
             designs in proportion to their effective sample sizes, focused rows by their stored weights",
        ),
    };
    match found {
        Ok((success, weights, region_share)) => match weighted(&success, &weights) {
            Ok(estimate) => Finding::Estimated(Reweighted {
                estimate,
                rows: success.len() as u64,
                region_share,
                method: method.to_owned(),
            }),
            Err(because) => Finding::not(because),
        },
        Err(because) => Finding::not(because),
    }
}

/// Whether all stored weights of these rows are equal, up to rounding.
fn equal_weights(table: &EpisodeTable, rows: &Sample) -> bool {
    let weights = || rows.rows.iter().map(|row| table.weight[*row as usize]);
    let low = weights().fold(f64::INFINITY, f64::min);
    weights().all(|w| (w - low).abs() <= 1e-9 * low.abs())
}

/// Outcomes and weights of the base rows followed by the focused ones, and P(R).
fn combined_weights(
    table: &EpisodeTable,
    base: &Sample,
    focused: &Sample,
) -> Result<(Vec<bool>, Vec<f64>, f64), &'static str> {
    if focused.len() == 0 || base.len() == 0 {
        return Err("one of the two designs has no valid episode");
    }
    let mut share = 1.0;
    let mut inside = vec![true; base.len()];
    for (of_focused, of_base) in focused.parameters.iter().zip(&base.parameters) {
        let low = of_focused.values.iter().copied().fold(f64::INFINITY, f64::min);
        let high = of_focused.values.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        let in_box: Box<dyn Fn(f64) -> bool> = match &of_focused.kind {
            ParameterKind::Continuous { low: l, high: h, log: true } => {
                share *= (high / low).ln() / (h / l).ln();
                Box::new(move |v| low <= v && v <= high)
            }
            ParameterKind::Continuous { low: l, high: h, log: false } => {
                share *= (high - low) / (h - l);
                Box::new(move |v| low <= v && v <= high)
            }
            ParameterKind::Integer { low: l, high: h } => {
                share *= (high - low + 1.0) / (h - l + 1) as f64;
                Box::new(move |v| low <= v && v <= high)
            }
            ParameterKind::Categorical { levels } => {
                let mut present = vec![false; levels.len()];
                of_focused.codes().iter().for_each(|code| present[*code] = true);
                share *= present.iter().filter(|p| **p).count() as f64 / levels.len() as f64;
                Box::new(move |v| present[v as usize])
            }
        };
        inside.iter_mut().zip(&of_base.values).for_each(|(inside, v)| *inside &= in_box(*v));
    }
    let share = share.clamp(0.0, 1.0);
    let inner = inside.iter().filter(|i| **i).count() as f64;
    let outer = base.len() as f64 - inner;
    if share < 1.0 && outer <= 0.0 {
        return Err("no row of the uniform design lies outside the focused region");
    }
    let stored: Vec<f64> = focused.rows.iter().map(|row| table.weight[*row as usize]).collect();
    let total: f64 = stored.iter().sum();
    if total <= 0.0 || !total.is_finite() {
        return Err("the sum of the stored weights of the focused rows is not positive");
    }
    let effective = effective_sample_size(&stored);
    let to_focused = effective / (effective + inner);
    let of_inner = if inner > 0.0 { share * (1.0 - to_focused) / inner } else { 0.0 };
    let of_outer = if outer > 0.0 { (1.0 - share) / outer } else { 0.0 };
    let n = (base.len() + focused.len()) as f64;
    let weights = inside
        .iter()
        .map(|inside| n * if *inside { of_inner } else { of_outer })
        .chain(stored.iter().map(|w| n * share * to_focused * w / total))
        .collect();
    let success = base.success.iter().chain(&focused.success).copied().collect();
    Ok((success, weights, share))
}
