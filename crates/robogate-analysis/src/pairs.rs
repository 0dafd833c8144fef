//! Success by two parameters: the operating envelope.

use robogate_stats::Trials;
use robogate_stats::binning::{Edges, per_pair};
use robogate_stats::format::range;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::AnalysisError;
use crate::marginal::{MarginalEffect, Zone};
use crate::rate::Rate;
use crate::table::{ParameterColumn, ParameterKind, Sample};
use crate::task::TaskAnalysis;

/// Bins of one axis.
const MAX_BINS: usize = 10;
/// Episodes that a cell should hold on average.
const EPISODES_PER_CELL: usize = 25;

/// Success rates per cell of two parameters.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct PairMap {
    /// The horizontal parameter.
    pub x: Axis,
    /// The vertical parameter.
    pub y: Axis,
    /// The cells, row by row from the lowest y; x varies fastest.
    pub cells: Vec<PairCell>,
    /// Rows outside both ranges.
    pub outside: u64,
    /// Cells of each zone, at a confidence shared over the whole map.
    pub zones: ZoneCounts,
}

/// One axis of a map.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Axis {
    /// The parameter.
    pub parameter: String,
    /// Edges of its bins; empty for a categorical parameter.
    pub edges: Vec<f64>,
    /// Its levels, if it is categorical or an integer with few levels.
    pub levels: Vec<String>,
    /// Whether its bins have equal width on a logarithmic scale.
    pub log: bool,
}

impl Axis {
    /// Number of bins or levels.
    pub fn cells(&self) -> usize {
        if self.levels.is_empty() { self.edges.len().saturating_sub(1) } else { self.levels.len() }
    }

    /// The edges or the level of a cell; empty if there is no such cell.
    pub fn cell_label(&self, at: usize) -> String {
        match (self.levels.get(at), self.edges.get(at..at + 2)) {
            (Some(level), _) => level.clone(),
            (None, Some([low, high])) => range([*low, *high]),
            _ => String::new(),
        }
    }
}

/// One cell of a map.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct PairCell {
    /// Its rate.
    pub rate: Rate,
    /// Its zone.
    pub zone: Zone,
}

/// Cells of each zone.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct ZoneCounts {
    /// Cells significantly at or above 70 %.
    pub safe: u64,
    /// Cells significantly between.
    pub boundary: u64,
    /// Cells significantly at or below 30 %.
    pub danger: u64,
    /// Cells with enough episodes whose interval includes a limit.
    #[serde(default)]
    pub undecided: u64,
    /// Cells with too few episodes for any zone.
    pub too_few_episodes: u64,
}

/// The pair that is mapped by default: that of the task, otherwise the two numeric parameters with the strongest
/// correlation with success. The frontier is solved for the first.
pub(crate) fn default_pair(base: &Sample, effects: &[MarginalEffect], task: &TaskAnalysis) -> Option<(String, String)> {
    if let Some([up, across]) = task.envelope.filter(|pair| pair.iter().all(|name| base.parameter(name).is_some())) {
        return Some((up.to_owned(), across.to_owned()));
    }
    let mut ranked: Vec<(f64, &MarginalEffect)> = effects
        .iter()
        .filter(|a| base.parameter(&a.parameter).is_some_and(ParameterColumn::is_numeric))
        .map(|a| (a.correlation.estimated().map_or(0.0, |c| c.strength()), a))
        .collect();
    ranked.sort_by(|a, b| b.0.total_cmp(&a.0));
    match ranked.as_slice() {
        [(_, first), (_, second), ..] => Some((first.parameter.clone(), second.parameter.clone())),
        _ => None,
    }
}

/// Checks that two parameters can be mapped.
pub(crate) fn check(base: &Sample, first: &str, second: &str) -> Result<(), AnalysisError> {
    let known = || base.parameters.iter().map(|p| p.name.as_str()).collect::<Vec<_>>().join(", ");
    for name in [first, second] {
        if base.parameter(name).is_none() {
            let reason = "unknown parameter";
            return Err(AnalysisError::Pair { name: name.to_owned(), reason, known: known() });
        }
    }
    if first == second {
        let reason = "a pair needs two different parameters";
        return Err(AnalysisError::Pair { name: first.to_owned(), reason, known: known() });
    }
    Ok(())
}

/// The map of two parameters: `up` on the vertical axis, `across` on the horizontal one.
pub(crate) fn map(base: &Sample, up: &ParameterColumn, across: &ParameterColumn) -> Option<PairMap> {
    let bins = bins_for(base.len());
    let (y_axis, y_edges) = axis(up, bins)?;
    let (x_axis, x_edges) = axis(across, bins)?;
    let counted = per_pair(&up.values, &y_edges, &across.values, &x_edges, &base.success).ok()?;
    let zones = Zone::of(&counted.cells);
    let mut counts = ZoneCounts::default();
    for zone in &zones {
        match zone {
            Zone::Safe => counts.safe += 1,
            Zone::Boundary => counts.boundary += 1,
            Zone::Danger => counts.danger += 1,
            Zone::Undecided => counts.undecided += 1,
            Zone::TooFewEpisodes => counts.too_few_episodes += 1,
        }
    }
    let cell = |(trials, zone): (&Trials, Zone)| PairCell { rate: Rate::of(*trials), zone };
    Some(PairMap {
        x: x_axis,
        y: y_axis,
        cells: counted.cells.iter().zip(zones).map(cell).collect(),
        outside: counted.outside as u64,
        zones: counts,
    })
}

/// The number of bins of an axis, which leaves enough episodes for each cell.
pub(crate) fn bins_for(episodes: usize) -> usize {
    let side = (episodes as f64 / EPISODES_PER_CELL as f64).sqrt() as usize;
    side.clamp(3, MAX_BINS)
}

/// Bins of equal probability under the operating distribution: of equal width on the parameter's own scale.
pub(crate) fn axis(parameter: &ParameterColumn, bins: usize) -> Option<(Axis, Edges)> {
    let name = parameter.name.clone();
    let levels_of = |levels: Vec<String>, first: f64| {
        let edges = Edges::new((0..=levels.len()).map(|i| first - 0.5 + i as f64).collect()).ok()?;
        Some((Axis { parameter: name.clone(), edges: Vec::new(), levels, log: false }, edges))
    };
    let binned = |low: f64, high: f64, log: bool| {
        let at = |i: usize| {
            let u = i as f64 / bins as f64;
            match i {
                0 => low,
                i if i == bins => high,
                _ if log => (low.ln() + u * (high.ln() - low.ln())).exp(),
                _ => low + u * (high - low),
            }
        };
        let edges = Edges::new((0..=bins).map(at).collect()).ok()?;
        Some((Axis { parameter: name.clone(), edges: edges.as_slice().to_vec(), levels: Vec::new(), log }, edges))
    };
    match &parameter.kind {
        ParameterKind::Continuous { low, high, log } => binned(*low, *high, *log),
        ParameterKind::Integer { low, high } if high - low < 16 => {
            levels_of((*low..=*high).map(|level| level.to_string()).collect(), *low as f64)
        }
        ParameterKind::Integer { low, high } => binned(*low as f64 - 0.5, *high as f64 + 0.5, false),
        ParameterKind::Categorical { levels } if levels.len() <= 40 => levels_of(levels.clone(), 0.0),
        ParameterKind::Categorical { .. } => None,
    }
}
