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
            let (rates, zones) = rated(base, &trials, |row| Some(parameter.values[row] as usize));
            let cells = levels.iter().zip(rates).zip(zones);
            let cell =
                |((level, rate), zone): ((&String, Rate), Zone)| Cell { label: level.clone(), range: None, rate, zone };
            (cells.map(cell).collect(), 0)
        }
    }
}

fn bins(base: &Sample, parameter: &ParameterColumn, edges: &Edges) -> (Vec<Cell>, u64) {
    let counted = per_bin(&parameter.values, &base.success, edges);
    let (trials, outside) = counted.map_or_else(|_| (Vec::new(), 0), |c| (c.cells, c.outside as u64));
    let ranges = edges.as_slice().windows(2).map(|e| [e[0], e[1]]);
    let (rates, zones) = rated(base, &trials, |row| edges.bin(parameter.values[row]));
    let cells = ranges.zip(rates).zip(zones).map(|((edges, rate), zone)| Cell {
        label: range(edges),
        range: Some(edges),
        rate,
        zone,
    });
    (cells.collect(), outside)
}

/// The rates and the zones of cells. `cell_of` is the cell of a row.
fn rated(base: &Sample, trials: &[Trials], cell_of: impl Fn(usize) -> Option<usize>) -> (Vec<Rate>, Vec<Zone>) {
    if base.is_plain() {
        return (trials.iter().map(|trials| Rate::of(*trials)).collect(), Zone::of(trials));
    }
    let cells: Vec<Option<usize>> = (0..base.len()).map(cell_of).collect();
    let of = |cell: usize| Rate::of_rows(base, |row| cells[row] == Some(cell));
    let effective = base.effective_cells(trials.len(), |row| cells[row]);
    ((0..trials.len()).map(of).collect(), Zone::of(&effective))
}

fn equal_width(low: f64, high: f64) -> Option<Edges> {
    Edges::equal_width(&[low, high], BINS).ok()
}
