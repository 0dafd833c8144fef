//! The rows that all figures count, the population that they describe, and their sampling weights.
//!
//! Every valid row counts, whatever its design. The weights of an active stage refer to the whole operating space, as those of the
//! uniform one do, and are used as stored. The rows of a two-stage run have the weights of the balance heuristic
//! ([`pooled`]), for which the run's folder describes the regions. Without it, the region R of the focused rows is known only if
//! they were sampled uniformly in one box, so that their stored weights are equal; then the rows are post-stratified on R:
//! the rows outside R (all of them from the uniform design) share the mass 1 - P(R) equally, and inside R, the mass P(R) is divided
//! between the two designs in proportion to their effective sample sizes. R is the bounding box of the focused rows, and P(R) its
//! share of the operating distribution, whose parameters are independent. Otherwise the chosen rows are left out.

mod pooled;

use robogate_stats::weighted::effective_sample_size;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::source::BoundaryFile;
use crate::table::{EpisodeTable, ParameterKind, Sample};
use crate::{Finding, Population};

/// How rows of several designs count together.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Weighting {
    /// Valid rows of all designs.
    pub rows: u64,
    /// Those whose points a model or a boundary estimate chose.
    pub chosen: u64,
    /// Share of the operating distribution in which points were chosen.
    pub region_share: f64,
    /// How the weights were computed.
    pub method: String,
}

/// The rows that figures count.
pub(crate) struct Counted {
    pub(crate) base: Sample,
    pub(crate) population: Population,
    pub(crate) weighting: Option<Finding<Weighting>>,
}

impl Counted {
    pub(crate) fn of(table: &EpisodeTable, boundary: Option<&BoundaryFile>) -> Self {
        let operating = table.sample(false);
        let focused = table.sample(true);
        if operating.len() == 0 && focused.len() > 0 {
            return Self { base: focused, population: Population::FocusedDesign, weighting: None };
        }
        let any = |name: &str| table.stages.iter().any(|stage| !stage.focused && stage.name == name);
        let population = if any("imported") {
            Population::AsImported
        } else if any("suite") && !table.is_fresh {
            Population::Suite
        } else {
            Population::OperatingSpace
        };
        if focused.len() == 0 {
            return Self { base: operating, population, weighting: None };
        }
        match weights(table, &operating, &focused, boundary) {
            Ok((weights, region_share, method)) => {
                let base = table.weighted(&weights);
                let (rows, chosen) = (base.len() as u64, focused.len() as u64);
                let weighting = Weighting { rows, chosen, region_share, method: method.to_owned() };
                Self { base, population, weighting: Some(Finding::Estimated(weighting)) }
            }
            Err(because) => Self { base: operating, population, weighting: Some(Finding::not(because)) },
        }
    }
}

/// The weight of each row of the table, the share of the region, and the method.
fn weights(
    table: &EpisodeTable,
    operating: &Sample,
    focused: &Sample,
    boundary: Option<&BoundaryFile>,
) -> Result<(Vec<f64>, f64, &'static str), &'static str> {
    if focused.rows.iter().all(|row| table.is_active(*row as usize)) {
        return Ok((
            table.weight.clone(),
            1.0,
            "each row by its stored weight, which refers to the whole operating space",
        ));
    }
    let ((found, share), method) = match boundary.filter(|b| b.volume.episodes > 0) {
        Some(boundary) => (
            pooled::weights(table, operating, focused, boundary)?,
            "each row by the pooled density of both designs (balance heuristic)",
        ),
        None if !equal_weights(table, focused) => {
            return Err(
                "the focused rows come from several regions, which are described in the run's folder only: analyse the folder",
            );
        }
        None => (
            combined_weights(table, operating, focused)?,
            "post-stratified on the bounding box of the focused rows: outside it the uniform rows only, inside it both \
             designs in proportion to their effective sample sizes, focused rows by their stored weights",
        ),
    };
    let mut weights = vec![0.0; table.len()];
    let rows = operating.rows.iter().chain(&focused.rows);
    rows.zip(found).for_each(|(row, weight)| weights[*row as usize] = weight);
    Ok((weights, share, method))
}

/// Whether all stored weights of these rows are equal, up to rounding.
fn equal_weights(table: &EpisodeTable, rows: &Sample) -> bool {
    let weights = || rows.rows.iter().map(|row| table.weight[*row as usize]);
    let low = weights().fold(f64::INFINITY, f64::min);
    weights().all(|w| (w - low).abs() <= 1e-9 * low.abs())
}

/// Weights of the base rows followed by the focused ones, and P(R).
fn combined_weights(table: &EpisodeTable, base: &Sample, focused: &Sample) -> Result<(Vec<f64>, f64), &'static str> {
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
    Ok((weights, share))
}
