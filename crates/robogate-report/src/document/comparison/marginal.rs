//! Marginal effects of the shared parameters.

use robogate_analysis::labels::label_with_unit;
use robogate_analysis::{Comparison, SharedCurve};
use robogate_stats::format::{count, counted, percent_or_dash, percent_range, sentence};

use super::{Block, Figure, Section, Table, population};
use crate::document::Kind::{Number, Short, Text};
use crate::document::MAX_ROWS;
use crate::figures;

/// Number of figures that are visible before the reader opens the others.
const FIRST_FIGURES: usize = 3;

pub(super) fn section(of: &Comparison) -> Section {
    let mut blocks = Vec::new();
    if of.marginal_effects.is_empty() {
        blocks.push(Block::Text("No curve can be drawn: the datasets share no parameter.".to_owned()));
    } else {
        let figures = of.marginal_effects.iter().map(|curve| Figure {
            title: sentence(&curve.label),
            svg: figures::shared_curve(curve, &of.compared),
            is_map: false,
            caption: curve.remark.clone().unwrap_or_default(),
            findings: Vec::new(),
            table: curve_table(of, curve),
        });
        let mut figures: Vec<Figure> = figures.collect();
        let others = figures.split_off(FIRST_FIGURES.min(figures.len()));
        blocks.push(Block::Grid(figures));
        if !others.is_empty() {
            let title = counted(others.len() as u64, "more parameter");
            blocks.push(Block::Group(title, vec![Block::Grid(others)]));
        }
    }
    if !of.parameters.not_shared.is_empty() {
        let rows = of.parameters.not_shared.iter().map(|parameter| {
            let datasets = if parameter.datasets.is_empty() { "-".to_owned() } else { parameter.datasets.join(", ") };
            vec![label_with_unit(&parameter.parameter), datasets, parameter.because.clone()]
        });
        let columns = [("parameter", Text), ("datasets", Text), ("reason", Text)];
        blocks.push(Block::Table(
            Table::new("Parameters that are not shared", &columns, rows.collect()).at_most(MAX_ROWS),
        ));
    }
    Section { id: "marginal-effects", title: "Marginal effects".to_owned(), population: population(of), blocks }
}

fn curve_table(of: &Comparison, curve: &SharedCurve) -> Table {
    let rows = curve.cells.iter().map(|cell| {
        let rates = cell
            .rates
            .iter()
            .flat_map(|rate| [percent_or_dash(rate.rate), percent_range(rate.wilson_95), count(rate.n)]);
        std::iter::once(cell.label.clone()).chain(rates).collect()
    });
    let heads: Vec<[String; 3]> =
        of.compared.iter().map(|name| [name.clone(), "95 %".to_owned(), "n".to_owned()]).collect();
    let label = label_with_unit(&curve.parameter);
    let mut columns = vec![(label.as_str(), Short)];
    columns.extend(heads.iter().flatten().map(|head| (head.as_str(), Number)));
    Table::new(format!("Success by {}", curve.label), &columns, rows.collect()).at_most(MAX_ROWS)
}
