//! Success rates per bin or level of one parameter.

use robogate_stats::Trials;
use robogate_stats::binning::{Edges, per_bin, per_category};
use robogate_stats::format::range;

use super::{BINS, Cell, Zone, level_edges};
use crate::rate::Rate;
use crate::table::{ParameterColumn, ParameterKind, Sample};

/// The cells of a parameter, and the number of rows outside all of them.
pub(super) fn cells(base: &Sample, parameter: &ParameterColumn) -> (Vec<Cell>, u64) {
    let binned = |edges: Option<Edges>| edges.map_or((Vec::new(), 0), |edges| bins(base, parameter, &edges));
    match &parameter.kind {
        ParameterKind::Continuous { low, high, .. } => binned(equal_width(*low, *high)),
        ParameterKind::Integer { low, high } => {
            let Some(edges) = level_edges(*low, *high) else {
                return binned(equal_width(*low as f64 - 0.5, *high as f64 + 0.5));
            };
            let (mut cells, outside) = bins(base, parameter, &edges);
            for (cell, level) in cells.iter_mut().zip(*low..) {
                cell.label = level.to_string();
                cell.range = None;
            }
            (cells, outside)
        }
        ParameterKind::Categorical { levels } => {
            let trials = per_category(&parameter.codes(), &base.success, levels.len()).unwrap_or_default();
            let cells = levels.iter().zip(&trials).zip(Zone::of(&trials));
            let cell = |((level, trials), zone): ((&String, &Trials), Zone)| Cell {
                label: level.clone(),
                range: None,
                rate: Rate::of(*trials),
                zone,
            };
            (cells.map(cell).collect(), 0)
        }
    }
}

fn bins(base: &Sample, parameter: &ParameterColumn, edges: &Edges) -> (Vec<Cell>, u64) {
    let counted = per_bin(&parameter.values, &base.success, edges);
    let (trials, outside) = counted.map_or_else(|_| (Vec::new(), 0), |c| (c.cells, c.outside as u64));
    let ranges = edges.as_slice().windows(2).map(|e| [e[0], e[1]]);
    let cells = ranges.zip(&trials).zip(Zone::of(&trials)).map(|((edges, trials), zone)| Cell {
        label: range(edges),
        range: Some(edges),
        rate: Rate::of(*trials),
        zone,
    });
    (cells.collect(), outside)
}

fn equal_width(low: f64, high: f64) -> Option<Edges> {
    Edges::equal_width(&[low, high], BINS).ok()
}
