//! Map of two parameters with the share of scenarios whose outcomes differ.

use robogate_stats::Trials;
use robogate_stats::compare::{Pairs, mcnemar_exact};
use robogate_stats::multiplicity::holm;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::rows::{PairedRows, count};
use crate::Axis;
use crate::comparison::axis::SharedAxis;
use crate::rate::{Finding, Rate};

/// Map of two parameters with the share of scenarios whose outcomes differ between two datasets.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct DisagreementMap {
    /// The horizontal parameter.
    pub x: Axis,
    /// The vertical parameter.
    pub y: Axis,
    /// The cells, row by row from the lowest y; x varies fastest.
    pub cells: Vec<DisagreementCell>,
}

/// One cell of the map.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct DisagreementCell {
    /// Share of the valid pairs whose outcomes differ.
    pub differ: Rate,
    /// Pairs in which only the first succeeded.
    pub first_only: u64,
    /// Pairs in which only the second succeeded.
    pub second_only: u64,
    /// McNemar's exact p-value, adjusted by Holm over the cells.
    pub holm_p: f64,
}

/// Average number of scenarios per cell.
const SCENARIOS_PER_CELL: usize = 25;

pub(super) fn disagreement(pairs: &PairedRows<'_>, pair: Option<(&str, &str)>) -> Finding<DisagreementMap> {
    let Some((up, across)) = pair else {
        return Finding::not("there are fewer than two numeric parameters");
    };
    let bins = ((pairs.rows.len() / SCENARIOS_PER_CELL) as f64).sqrt() as usize;
    let axis = |parameter: &str| SharedAxis::of(&[pairs.first, pairs.second], parameter, bins.clamp(3, 10));
    let (y, x) = match (axis(up), axis(across)) {
        (Ok(y), Ok(x)) => (y, x),
        (Err(because), _) | (_, Err(because)) => return Finding::CannotBeEstimated { because },
    };
    let column = |name: &str| pairs.first.table.parameters.iter().find(|p| p.name == name);
    let (Some(up), Some(across)) = (column(up), column(across)) else {
        return Finding::not("one of the two parameters is missing");
    };
    let (y_places, x_places) = (y.places(up), x.places(across));
    let mut cells = vec![Pairs::default(); y.cells() * x.cells()];
    for at in &pairs.rows {
        let (Some(row), Some(column)) = (y_places[at.0], x_places[at.0]) else { continue };
        count(&mut cells[row * x.cells() + column], pairs.endings(*at));
    }
    let p: Vec<f64> = cells.iter().map(|cell| mcnemar_exact(*cell).exp()).collect();
    let adjusted = holm(&p).unwrap_or_else(|_| vec![1.0; p.len()]);
    let cells = cells.iter().zip(adjusted).map(|(cell, holm_p)| DisagreementCell {
        differ: Rate::of(Trials::new(cell.first_only + cell.second_only, cell.n()).unwrap_or(Trials::NONE)),
        first_only: cell.first_only,
        second_only: cell.second_only,
        holm_p,
    });
    Finding::Estimated(DisagreementMap { cells: cells.collect(), x: x.axis, y: y.axis })
}
