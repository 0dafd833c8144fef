//! Success over two parameters at once: the operating envelope.

use robogate_stats::Trials;
use robogate_stats::binning::{Edges, per_pair};
use robogate_stats::format::range;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::AnalysisError;
use crate::along::{Along, Zone};
use crate::rate::Rate;
use crate::rows::{ParameterColumn, ParameterKind, Sample};
use crate::task::TaskAnalysis;

/// Most bins along a side.
const MOST: usize = 10;
/// Episodes that a cell should hold on average.
const WANTED: usize = 25;

/// Rates per cell of two parameters.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct PairMap {
    /// The parameter across.
    pub x: Axis,
    /// The parameter upwards.
    pub y: Axis,
    /// The cells, row by row from the lowest y, x running fastest.
    pub cells: Vec<PairCell>,
    /// Rows outside both ranges.
    pub outside: u64,
    /// How many cells each zone has, the level shared over the whole map.
    pub zones: ZoneCounts,
}

/// One side of a map.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Axis {
    /// The parameter.
    pub parameter: String,
    /// Edges of its bins; of a category none.
    pub edges: Vec<f64>,
    /// Its levels, where it is a category or a whole number.
    pub levels: Vec<String>,
    /// Whether it was drawn, and is cut, evenly in its logarithm.
    pub log: bool,
}

impl Axis {
    /// How many bins or levels there are.
    pub fn cells(&self) -> usize {
        if self.levels.is_empty() { self.edges.len().saturating_sub(1) } else { self.levels.len() }
    }

    /// The edges or the level of a cell; empty where there is no such cell.
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
    /// What may be said of it.
    pub zone: Zone,
}

/// How many cells each zone has.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct ZoneCounts {
    /// Cells surely from 70 %.
    pub safe: u64,
    /// Cells surely between.
    pub boundary: u64,
    /// Cells surely to 30 %.
    pub danger: u64,
    /// Cells with episodes enough whose interval reaches over a limit.
    #[serde(default)]
    pub undecided: u64,
    /// Cells with too few episodes to say anything sure.
    pub too_thin: u64,
}

/// The pair that is mapped by default: the one that the task names, else the two numeric parameters that are most strongly
/// correlated with success. The frontier is solved for the first.
pub(crate) fn default_pair(base: &Sample, along: &[Along], task: &TaskAnalysis) -> Option<(String, String)> {
    if let Some([up, across]) = task.envelope.filter(|pair| pair.iter().all(|name| base.parameter(name).is_some())) {
        return Some((up.to_owned(), across.to_owned()));
    }
    let mut ranked: Vec<(f64, &Along)> = along
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

/// Checks that two names can be mapped.
pub(crate) fn check(base: &Sample, first: &str, second: &str) -> Result<(), AnalysisError> {
    let known = || base.parameters.iter().map(|p| p.name.as_str()).collect::<Vec<_>>().join(", ");
    for name in [first, second] {
        if base.parameter(name).is_none() {
            let reason = "there is no such parameter";
            return Err(AnalysisError::Pair { name: name.to_owned(), reason, known: known() });
        }
    }
    if first == second {
        let reason = "it is there twice";
        return Err(AnalysisError::Pair { name: first.to_owned(), reason, known: known() });
    }
    Ok(())
}

/// The map of two parameters: `up` is drawn upwards, `across` across.
pub(crate) fn map(base: &Sample, up: &ParameterColumn, across: &ParameterColumn) -> Option<PairMap> {
    // As many cells as let each hold enough episodes to say something.
    let side = (base.len() as f64 / WANTED as f64).sqrt() as usize;
    let bins = side.clamp(3, MOST);
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
            Zone::TooThin => counts.too_thin += 1,
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

/// Bins that hold equal shares of what is drawn: even in the parameter's own scale.
fn axis(parameter: &ParameterColumn, bins: usize) -> Option<(Axis, Edges)> {
    let name = parameter.name.clone();
    let levels_of = |levels: Vec<String>, first: f64| {
        let edges = Edges::new((0..=levels.len()).map(|i| first - 0.5 + i as f64).collect()).ok()?;
        Some((Axis { parameter: name.clone(), edges: Vec::new(), levels, log: false }, edges))
    };
    let cut = |low: f64, high: f64, log: bool| {
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
        ParameterKind::Continuous { low, high, log } => cut(*low, *high, *log),
        ParameterKind::Integer { low, high } if high - low < 16 => {
            levels_of((*low..=*high).map(|level| level.to_string()).collect(), *low as f64)
        }
        ParameterKind::Integer { low, high } => cut(*low as f64 - 0.5, *high as f64 + 0.5, false),
        ParameterKind::Categorical { words } if words.len() <= 40 => levels_of(words.clone(), 0.0),
        ParameterKind::Categorical { .. } => None,
    }
}
