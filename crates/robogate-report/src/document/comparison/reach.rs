//! Workspace distance and reach.

use robogate_analysis::Comparison;
use robogate_stats::format::{number, percent_or_dash, percent_range};

use super::{Block, Figure, Section, Table, population};
use crate::document::Kind::{Number, Short, Text};
use crate::figures;

/// The section. `None` if no dataset has a reach, such as for a task without an arm.
pub(super) fn section(of: &Comparison) -> Option<Section> {
    if of.reach.iter().all(|row| row.reach_m.is_none()) {
        return None;
    }
    let table = table(of);
    let mut blocks = Vec::new();
    if of.reach.iter().filter(|row| row.ratio.is_some()).count() >= 2 {
        blocks.push(Block::Figure(Figure {
            title: "Success by workspace distance over reach".to_owned(),
            svg: figures::reach(&of.reach, &of.compared),
            is_map: false,
            caption: "At a ratio of 1 the centre of the workspace is at the end of the reach.".to_owned(),
            findings: Vec::new(),
            table,
        }));
    } else {
        blocks.push(Block::Text(
            "The reach is known for fewer than two datasets. Give it with --reach NAME=METRES and --workspace METRES."
                .to_owned(),
        ));
        if !table.rows.is_empty() {
            blocks.push(Block::Table(table));
        }
    }
    Some(Section { id: "reach", title: "Workspace and reach".to_owned(), population: population(of), blocks })
}

fn table(of: &Comparison) -> Table {
    let metres = |m: Option<f64>| m.map_or_else(|| "unknown".to_owned(), |m| format!("{} m", number(m)));
    let rows = of.reach.iter().map(|row| {
        let source = match (row.given, row.ratio) {
            (true, _) => "command line",
            (false, Some(_)) => "provenance",
            (false, None) => "-",
        };
        vec![
            row.name.clone(),
            metres(row.reach_m),
            metres(row.workspace_m),
            row.ratio.map_or_else(|| "unknown".to_owned(), number),
            percent_or_dash(row.rate.rate),
            percent_range(row.rate.wilson_95),
            source.to_owned(),
        ]
    });
    let columns = [
        ("dataset", Text),
        ("reach", Number),
        ("workspace at", Number),
        ("ratio", Number),
        ("success", Number),
        ("95 % interval", Number),
        ("source", Short),
    ];
    Table::new("Reach", &columns, rows.collect()).without_empty()
}
