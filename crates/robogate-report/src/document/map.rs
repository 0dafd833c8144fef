//! Title, zones and table of a map of two parameters.

use robogate_analysis::PairMap;
use robogate_analysis::labels::parameter_label;
use robogate_stats::format::{count, percent, percent_or_dash, percent_range, sentence};

use super::Kind::{Number, Short, Zone};
use super::{MAX_MAP_ROWS, Table, or_dash};

/// The parameters of a map.
pub(super) fn map_title(map: &PairMap) -> String {
    format!("{} \u{d7} {}", sentence(&parameter_label(&map.y.parameter)), parameter_label(&map.x.parameter))
}

/// The number of cells in each zone, in one sentence.
pub(super) fn map_zones(map: &PairMap) -> String {
    let zones = map.zones;
    format!(
        "{} of {} cells are significantly at 70 % or more, {} at 30 % or less and {} between.",
        zones.safe,
        map.cells.len(),
        zones.danger,
        zones.boundary
    )
}

/// The cells of a map. `counted` is the head of the column with the number of observed outcomes.
pub(super) fn map_table(map: &PairMap, counted: &str) -> Table {
    let (y, x) = (parameter_label(&map.y.parameter), parameter_label(&map.x.parameter));
    let nx = map.x.cells().max(1);
    let rows = map.cells.iter().enumerate().map(|(i, cell)| {
        vec![
            map.y.cell_label(i / nx),
            map.x.cell_label(i % nx),
            count(cell.rate.n),
            percent_or_dash(cell.rate.rate),
            percent_range(cell.rate.wilson_95),
            or_dash(cell.model, |m| percent(m.rate)),
            or_dash(cell.model, |m| percent_range(m.interval_95)),
            cell.zone.as_str().to_owned(),
        ]
    });
    let columns = [
        (&*y, Short),
        (&*x, Short),
        (counted, Number),
        ("success", Number),
        ("95 % interval", Number),
        ("model", Number),
        ("model 95 %", Number),
        ("zone", Zone),
    ];
    let table = Table::new(format!("Cells of {y} \u{d7} {x}"), &columns, rows.collect()).without_empty();
    table.at_most(MAX_MAP_ROWS)
}
