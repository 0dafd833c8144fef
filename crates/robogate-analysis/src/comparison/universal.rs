//! Universal zones: cells in which every compared dataset fails most of the time.

use robogate_stats::Trials;
use robogate_stats::compare::at_most;
use robogate_stats::multiplicity::{holm, intersection_union};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::comparison::axis::SharedAxis;
use crate::comparison::dataset::Dataset;
use crate::labels::{parameter_label, value_with_unit};
use crate::rate::Rate;

/// The level of significance, after Holm's adjustment.
const LEVEL: f64 = 0.05;

/// Cells in which every compared dataset fails most of the time: bins and levels of each shared parameter, and the
/// cells of one pair.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct UniversalZones {
    /// The success rate that the rate of every dataset is tested against.
    pub limit: f64,
    /// The pair whose cells were tested too. `None` if fewer than two parameters are shared.
    pub pair: Option<[String; 2]>,
    /// Cells that were tested: the family of Holm's adjustment.
    pub tested: u64,
    /// Cells that were not tested, because some dataset has fewer than `smallest_n` episodes there.
    pub too_few_episodes: u64,
    /// Smallest number of episodes at which a cell without success is significant at 5 %.
    pub smallest_n: u64,
    /// Cells in which the observed rate of every dataset is below the limit, the smallest p-value first.
    pub zones: Vec<UniversalZone>,
}

/// A cell in which the observed rate of every dataset is below the limit.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct UniversalZone {
    /// Its bins or levels: of one parameter, or of two.
    pub sides: Vec<ZoneSide>,
    /// The rate of each compared dataset, in their order.
    pub rates: Vec<Rate>,
    /// The p-value of "not all rates are below the limit": the largest of the exact one-sided p-values
    /// (intersection-union).
    pub p: f64,
    /// The p-value, adjusted by Holm over all cells tested.
    pub holm_p: f64,
    /// Whether all rates are significantly below the limit: adjusted p-value at most 0.05.
    pub significant: bool,
}

/// One parameter's bin or level.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ZoneSide {
    /// The parameter.
    pub parameter: String,
    /// The label of the bin or level.
    pub label: String,
    /// Edges of a bin; absent for a level.
    pub range: Option<[f64; 2]>,
}

impl UniversalZone {
    /// The label of the cell.
    pub fn describe(&self) -> String {
        let sides = self.sides.iter().map(|side| {
            format!("{} {}", parameter_label(&side.parameter), value_with_unit(&side.label, &side.parameter))
        });
        sides.collect::<Vec<_>>().join(", ")
    }
}

pub(crate) fn universal(
    datasets: &[&Dataset<'_>],
    axes: &[SharedAxis],
    pair: Option<(&SharedAxis, &SharedAxis)>,
    limit: f64,
) -> UniversalZones {
    let side = |axis: &SharedAxis, at: usize| ZoneSide {
        parameter: axis.axis.parameter.clone(),
        label: axis.axis.cell_label(at),
        range: axis.range(at),
    };
    let mut cells: Vec<(Vec<ZoneSide>, Vec<Trials>)> = Vec::new();
    for axis in axes {
        let trials: Vec<Vec<Trials>> = datasets.iter().map(|dataset| axis.trials(dataset)).collect();
        for i in 0..axis.cells() {
            cells.push((vec![side(axis, i)], trials.iter().map(|of| of[i]).collect()));
        }
    }
    if let Some((up, across)) = pair {
        let trials: Vec<Vec<Trials>> = datasets.iter().map(|dataset| up.trials_with(across, dataset)).collect();
        for i in 0..up.cells() * across.cells() {
            let sides = vec![side(up, i / across.cells()), side(across, i % across.cells())];
            cells.push((sides, trials.iter().map(|of| of[i]).collect()));
        }
    }
    // Which cells are tested depends on episode counts only, never on outcomes.
    let smallest_n = (LEVEL.ln() / (1.0 - limit).ln()).ceil().max(1.0) as u64;
    let all = cells.len();
    cells.retain(|(_, trials)| trials.iter().all(|of| of.n() >= smallest_n));
    let p: Vec<f64> = cells
        .iter()
        .map(|(_, trials)| {
            let each: Vec<f64> = trials.iter().map(|of| at_most(*of, limit).exp().clamp(0.0, 1.0)).collect();
            intersection_union(&each).ok().flatten().unwrap_or(1.0)
        })
        .collect();
    let adjusted = holm(&p).unwrap_or_else(|_| vec![1.0; p.len()]);
    let tested = cells.len();
    let mut zones: Vec<UniversalZone> = cells
        .into_iter()
        .zip(p.into_iter().zip(adjusted))
        .filter(|((_, trials), _)| trials.iter().all(|of| of.rate().is_some_and(|rate| rate < limit)))
        .map(|((sides, trials), (p, holm_p))| UniversalZone {
            sides,
            rates: trials.into_iter().map(Rate::of).collect(),
            p,
            holm_p,
            significant: holm_p <= LEVEL,
        })
        .collect();
    zones.sort_by(|a, b| a.p.total_cmp(&b.p));
    UniversalZones {
        limit,
        pair: pair.map(|(up, across)| [up.axis.parameter.clone(), across.axis.parameter.clone()]),
        tested: tested as u64,
        too_few_episodes: (all - tested) as u64,
        smallest_n,
        zones,
    }
}
