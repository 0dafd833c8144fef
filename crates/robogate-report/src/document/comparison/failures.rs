//! Failure modes of each dataset.

use robogate_analysis::labels::mode_label;
use robogate_analysis::{ComparedDataset, Comparison, Finding};
use robogate_stats::format::{count, percent_or_dash, percent_range};

use super::{Block, Figure, Section, Table, population};
use crate::document::Kind::{Number, Short, Text};
use crate::document::MAX_ROWS;
use crate::figures;

pub(super) fn section(of: &Comparison) -> Section {
    let failed: Vec<&ComparedDataset> = of.datasets.iter().filter(|d| d.failure_modes.failures > 0).collect();
    let block = if failed.is_empty() {
        Block::Text("No episode failed.".to_owned())
    } else {
        Block::Figure(Figure {
            title: "Failure modes".to_owned(),
            svg: figures::compared_failure_modes(&failed),
            is_map: false,
            caption: "Share of each mode of the failures.".to_owned(),
            findings: failed.iter().map(|d| dominant(d)).collect(),
            table: table(&failed),
        })
    };
    Section { id: "failures", title: "Failure modes".to_owned(), population: population(of), blocks: vec![block] }
}

fn dominant(dataset: &ComparedDataset) -> String {
    match &dataset.failure_modes.dominant {
        Finding::Estimated(mode) => {
            format!("{}: {} is significantly the most frequent failure mode.", dataset.name, mode_label(mode))
        }
        Finding::CannotBeEstimated { because } => {
            format!("{}: no failure mode is significantly the most frequent: {because}.", dataset.name)
        }
    }
}

fn table(failed: &[&ComparedDataset]) -> Table {
    let rows = failed.iter().flat_map(|d| {
        d.failure_modes.modes.iter().map(|m| {
            vec![
                d.name.clone(),
                mode_label(&m.mode),
                count(m.failures),
                percent_or_dash(m.share),
                percent_range(m.interval_95),
                if d.excluded_because.is_some() { d.population.brief().to_owned() } else { "-".to_owned() },
            ]
        })
    });
    let columns = [
        ("dataset", Text),
        ("failure mode", Short),
        ("episodes", Number),
        ("share of failures", Number),
        ("simultaneous 95 %", Number),
        ("note", Text),
    ];
    Table::new("Failure modes", &columns, rows.collect()).without_empty().at_most(MAX_ROWS)
}
