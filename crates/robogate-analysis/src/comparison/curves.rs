//! Success along what the dictionaries share, in the same bins, and where all of them fail.

use robogate_stats::Trials;
use robogate_stats::compare::at_most;
use robogate_stats::multiplicity::{holm, intersection_union};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::comparison::axis::SharedAxis;
use crate::comparison::entrant::Entrant;
use crate::rate::Rate;

/// The level at which a zone is sure.
const LEVEL: f64 = 0.05;

/// Success along a parameter that all dictionaries have.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct SharedCurve {
    /// The parameter.
    pub parameter: String,
    /// Its name as people write it.
    pub label: String,
    /// Its unit; empty where it has none.
    pub unit: String,
    /// Whether the bins are even in its logarithm.
    pub log: bool,
    /// What is not shared of it.
    pub remark: Option<String>,
    /// The bins or levels, the same for all.
    pub cells: Vec<SharedCell>,
}

/// One bin or level.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct SharedCell {
    /// The bin or level as people read it.
    pub label: String,
    /// Edges of a bin; absent for a level.
    pub range: Option<[f64; 2]>,
    /// The rate of each compared dictionary, in their order.
    pub rates: Vec<Rate>,
}

pub(crate) fn curve(entrants: &[&Entrant<'_>], shared: &SharedAxis) -> SharedCurve {
    let trials: Vec<Vec<Trials>> = entrants.iter().map(|entrant| shared.trials(entrant)).collect();
    let (label, unit) = crate::labels::label_and_unit(&shared.axis.parameter);
    SharedCurve {
        parameter: shared.axis.parameter.clone(),
        label,
        unit: unit.to_owned(),
        log: shared.axis.log,
        remark: shared.remark.clone(),
        cells: (0..shared.cells())
            .map(|i| SharedCell {
                label: shared.axis.cell_label(i),
                range: shared.range(i),
                rates: trials.iter().map(|of| Rate::of(of[i])).collect(),
            })
            .collect(),
    }
}

/// Where every compared dictionary fails most of the time: bins and levels of each shared parameter, and the cells of
/// one pair of them.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct UniversalZones {
    /// The success rate that all must be below.
    pub limit: f64,
    /// The pair whose cells were looked at beside the bins; absent where no two parameters are shared.
    pub pair: Option<[String; 2]>,
    /// Cells that were tested: the family of Holm's correction.
    pub looked_at: u64,
    /// Cells of which nothing was said: some dictionary has fewer than `smallest_n` episodes there.
    pub too_thin: u64,
    /// Episodes below which even a cell without any success shows nothing at 5 %.
    pub smallest_n: u64,
    /// Cells in which the observed rate of every dictionary is below the limit, the surest first.
    pub zones: Vec<UniversalZone>,
}

/// A cell in which every dictionary was observed below the limit.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct UniversalZone {
    /// Its sides: one parameter, or two.
    pub sides: Vec<ZoneSide>,
    /// The rate of each compared dictionary, in their order.
    pub rates: Vec<Rate>,
    /// The p-value that not all are below the limit: the largest of the exact one-sided ones (intersection-union).
    pub p: f64,
    /// The same adjusted by Holm over everything looked at.
    pub holm_p: f64,
    /// Whether it is sure that all are below: adjusted p at most 0.05.
    pub sure: bool,
}

/// One parameter's part of a cell.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ZoneSide {
    /// The parameter.
    pub parameter: String,
    /// The bin or level as people read it.
    pub label: String,
    /// Edges of a bin; absent for a level.
    pub range: Option<[f64; 2]>,
}

impl UniversalZone {
    /// The cell as people read it.
    pub fn describe(&self) -> String {
        let sides = self.sides.iter().map(|side| {
            format!(
                "{} {}",
                crate::labels::parameter_label(&side.parameter),
                crate::labels::value_with_unit(&side.label, &side.parameter)
            )
        });
        sides.collect::<Vec<_>>().join(", ")
    }
}

pub(crate) fn universal(
    entrants: &[&Entrant<'_>],
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
        let trials: Vec<Vec<Trials>> = entrants.iter().map(|entrant| axis.trials(entrant)).collect();
        for i in 0..axis.cells() {
            cells.push((vec![side(axis, i)], trials.iter().map(|of| of[i]).collect()));
        }
    }
    if let Some((up, across)) = pair {
        let trials: Vec<Vec<Trials>> = entrants.iter().map(|entrant| up.trials_with(across, entrant)).collect();
        for i in 0..up.cells() * across.cells() {
            let sides = vec![side(up, i / across.cells()), side(across, i % across.cells())];
            cells.push((sides, trials.iter().map(|of| of[i]).collect()));
        }
    }
    // Whether a cell is looked at hangs on counts of episodes alone, never on how they ended.
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
    let looked_at = cells.len();
    let mut zones: Vec<UniversalZone> = cells
        .into_iter()
        .zip(p.into_iter().zip(adjusted))
        .filter(|((_, trials), _)| trials.iter().all(|of| of.rate().is_some_and(|rate| rate < limit)))
        .map(|((sides, trials), (p, holm_p))| UniversalZone {
            sides,
            rates: trials.into_iter().map(Rate::of).collect(),
            p,
            holm_p,
            sure: holm_p <= LEVEL,
        })
        .collect();
    zones.sort_by(|a, b| a.p.total_cmp(&b.p));
    UniversalZones {
        limit,
        pair: pair.map(|(up, across)| [up.axis.parameter.clone(), across.axis.parameter.clone()]),
        looked_at: looked_at as u64,
        too_thin: (all - looked_at) as u64,
        smallest_n,
        zones,
    }
}
