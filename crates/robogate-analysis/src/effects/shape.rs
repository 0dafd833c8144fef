//! The shape of an effect: where success is high and where it is low.

use robogate_stats::Trials;
use robogate_stats::segments::{Segments, Shape, Step, segments};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::Rate;
use crate::table::{ParameterColumn, ParameterKind, Sample};

/// Most cells in which a step is located, and the rows of each.
const CELLS: usize = 60;
const ROWS_PER_CELL: usize = 25;

/// Where success is high and where it is low along one parameter.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct EffectShape {
    /// The kind of shape.
    pub kind: ShapeKind,
    /// Where the rate changes: one step for a one-sided effect, two for a band or a gap, none for levels.
    pub steps: Vec<RateStep>,
    /// The levels with a low rate, for a categorical parameter.
    pub low_levels: Vec<String>,
    /// The success rate on the high side. The steps were chosen on the same rows, so the contrast is slightly too large.
    pub high: Rate,
    /// The success rate on the low side.
    pub low: Rate,
}

/// The kind of shape.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum ShapeKind {
    /// One-sided: success is higher above the step.
    Rising,
    /// One-sided: success is higher below the step.
    Falling,
    /// Two-sided: success is higher between the steps, and lower at both ends.
    Band,
    /// Peaked: success is lower between the steps than at both ends.
    Gap,
    /// Some levels have a lower rate than the others.
    Levels,
}

/// A change of the success rate.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct RateStep {
    /// The value that best separates low from high rates. A gradual effect crosses about their mean there.
    pub at: f64,
    /// Its 95 % interval, for a jump as well as for a gradual change (exact tests of windows of cells).
    pub interval_95: [f64; 2],
}

/// The shape of a significant effect. `low` are the cells with the lower rate in the test.
pub(super) fn shape(base: &Sample, parameter: &ParameterColumn, cells: &[Trials], low: &[bool]) -> Option<EffectShape> {
    if let ParameterKind::Categorical { levels } = &parameter.kind {
        let is_low = |row: usize| low.get(parameter.values[row] as usize).copied().unwrap_or(false);
        let rate = |wanted: bool| Rate::of_rows(base, |row| is_low(row) == wanted);
        let low_levels = levels.iter().zip(cells).zip(low).filter(|((_, cell), low)| **low && cell.n() > 0);
        return Some(EffectShape {
            kind: ShapeKind::Levels,
            steps: Vec::new(),
            low_levels: low_levels.map(|((level, _), _)| level.clone()).collect(),
            high: rate(false),
            low: rate(true),
        });
    }
    let edges = super::edges(parameter, (base.len() / ROWS_PER_CELL).clamp(8, CELLS))?;
    let fine = super::independent_cells(base, edges.bins(), |row| edges.bin(parameter.values[row]));
    let Segments { shape, high, low } = segments(&fine, edges.as_slice())?;
    // A window of cells may end beside the range: half a step beyond the last integer.
    let limits = match parameter.kind {
        ParameterKind::Integer { low, high, .. } => [low as f64, high as f64],
        _ => [f64::NEG_INFINITY, f64::INFINITY],
    };
    let step = |step: Step| RateStep {
        at: step.at,
        interval_95: [step.low, step.high].map(|end| end.clamp(limits[0], limits[1])),
    };
    let (kind, steps) = match shape {
        Shape::Rising(at) => (ShapeKind::Rising, vec![step(at)]),
        Shape::Falling(at) => (ShapeKind::Falling, vec![step(at)]),
        Shape::Band(from, to) => (ShapeKind::Band, vec![step(from), step(to)]),
        Shape::Gap(from, to) => (ShapeKind::Gap, vec![step(from), step(to)]),
    };
    if base.is_plain() {
        return Some(EffectShape { kind, steps, low_levels: Vec::new(), high: Rate::of(high), low: Rate::of(low) });
    }
    let inside = |row: usize| {
        let value = parameter.values[row];
        match steps.as_slice() {
            [from, to] => (from.at..to.at).contains(&value) == (kind == ShapeKind::Band),
            [step] => (value >= step.at) == (kind == ShapeKind::Rising),
            _ => true,
        }
    };
    let rate = |high: bool| Rate::of_rows(base, |row| inside(row) == high);
    let (high, low) = (rate(true), rate(false));
    Some(EffectShape { kind, steps, low_levels: Vec::new(), high, low })
}
