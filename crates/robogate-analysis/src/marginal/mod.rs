//! Marginal effects: the success rate as a function of one parameter, averaged over all others.

mod cells;
mod correlation;
mod curve;
mod mode_changes;
mod threshold;
mod zone;

use robogate_stats::binning::Edges;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

pub use correlation::Correlation;
pub use curve::CurvePoint;
pub use mode_changes::{ModeBin, ModeChange, ModeChanges};
pub use threshold::CriticalThreshold;
pub use zone::Zone;

use crate::labels::{label_and_unit, parameter_label};
use crate::rate::{Finding, Rate};
use crate::table::{EpisodeTable, ParameterColumn, ParameterKind, Sample};

/// Number of bins over the range of a continuous parameter, as in the paper.
pub(crate) const BINS: usize = 10;
/// An integer parameter with at least this many levels is divided into bins.
const MAX_LEVELS: i64 = 30;

/// The marginal effect of one parameter. Its rates apply to the population of the analysis.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct MarginalEffect {
    /// The parameter.
    pub parameter: String,
    /// Its label.
    pub label: String,
    /// Its unit; empty without one.
    pub unit: String,
    /// The type of its values.
    pub kind: ParameterType,
    /// Bins of equal width over its range (continuous), or its levels.
    pub cells: Vec<Cell>,
    /// Number of rows outside the range.
    pub outside: u64,
    /// Correlation with success.
    pub correlation: Finding<Correlation>,
    /// Where the success rate crosses 50 %, for numeric parameters.
    pub threshold: Finding<CriticalThreshold>,
    /// Changes of the dominant failure mode along the parameter, for numeric parameters.
    pub transitions: Finding<ModeChanges>,
}

/// The type of a parameter's values.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum ParameterType {
    /// Real numbers, sampled on a linear scale.
    Continuous,
    /// Real numbers, sampled on a logarithmic scale.
    ContinuousLog,
    /// Integers.
    Integer,
    /// Named levels.
    Categorical,
}

/// One bin or level of a parameter.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Cell {
    /// The label of the bin or level.
    pub label: String,
    /// Edges of a bin; absent for a level.
    pub range: Option<[f64; 2]>,
    /// Its success rate.
    pub rate: Rate,
    /// Its zone, at a simultaneous confidence for all cells of the parameter.
    pub zone: Zone,
}

/// The marginal effect of `parameter` in the rows of `base`.
pub(crate) fn marginal_effect(table: &EpisodeTable, base: &Sample, parameter: &ParameterColumn) -> MarginalEffect {
    let (label, unit) = label_and_unit(&parameter.name);
    let (cells, outside) = cells::cells(base, parameter);
    let kind = match &parameter.kind {
        ParameterKind::Continuous { log: false, .. } => ParameterType::Continuous,
        ParameterKind::Continuous { log: true, .. } => ParameterType::ContinuousLog,
        ParameterKind::Integer { .. } => ParameterType::Integer,
        ParameterKind::Categorical { .. } => ParameterType::Categorical,
    };
    MarginalEffect {
        parameter: parameter.name.clone(),
        label,
        unit: unit.to_owned(),
        kind,
        cells,
        outside,
        correlation: correlation::correlation(base, parameter),
        threshold: threshold::critical_threshold(base, parameter),
        transitions: mode_changes::mode_changes(table, base, parameter),
    }
}

/// One bin for each integer. `None` if there are too many, or if they are not exact as `f64`.
fn level_edges(low: i64, high: i64) -> Option<Edges> {
    let exact = low.unsigned_abs().max(high.unsigned_abs()) < 1 << 50;
    if !exact || high - low >= MAX_LEVELS {
        return None;
    }
    Edges::new((low..=high + 1).map(|level| level as f64 - 0.5).collect()).ok()
}

/// The level edges of an integer parameter. `None` for any other.
pub(crate) fn integer_edges(parameter: &ParameterColumn) -> Option<Edges> {
    match parameter.kind {
        ParameterKind::Integer { low, high } => level_edges(low, high),
        ParameterKind::Continuous { .. } | ParameterKind::Categorical { .. } => None,
    }
}

/// The reason why success cannot be compared between values of a parameter.
fn no_contrast(base: &Sample, parameter: &ParameterColumn) -> String {
    let first = parameter.values.first().copied();
    if base.len() < 2 {
        format!("there {} only", if base.len() == 1 { "is 1 valid episode" } else { "are 0 valid episodes" })
    } else if base.success.iter().all(|s| *s) {
        "every episode succeeded".to_owned()
    } else if base.success.iter().all(|s| !*s) {
        "every episode failed".to_owned()
    } else if first.is_some_and(|first| parameter.values.iter().all(|v| (v - first).abs() <= 0.0)) {
        format!("{} has the same value in every episode", parameter_label(&parameter.name))
    } else {
        format!("{} episodes are too few to estimate it", base.len())
    }
}
