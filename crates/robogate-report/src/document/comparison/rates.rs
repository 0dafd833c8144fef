//! Success rates and their differences.

use robogate_analysis::Comparison;
use robogate_stats::difference::EXACT_TRIALS;
use robogate_stats::format::{count, p_value, percent_or_dash, percent_range, points, points_range};

use super::{Block, Figure, Section, Table, population};
use crate::document::Kind::{Number, Short, Text};
use crate::document::{MAX_ROWS, plain_p};
use crate::figures::{ForestRow, forest};

pub(super) fn section(of: &Comparison) -> Section {
    let mut blocks = vec![Block::Table(table(of))];
    if !of.differences.is_empty() {
        blocks.push(Block::Figure(differences(of)));
    }
    Section { id: "rates", title: "Success rates".to_owned(), population: population(of), blocks }
}

fn table(of: &Comparison) -> Table {
    let rows = of.datasets.iter().map(|d| {
        vec![
            d.name.clone(),
            count(d.success.rate.n),
            count(d.success.rate.successes),
            percent_or_dash(d.success.rate.rate),
            percent_range(d.success.rate.wilson_95),
            // The interval of dependent rows counts their groups, and has no exact form.
            match (d.success.rate.wilson_95, d.success.rate.clopper_pearson_95) {
                (one, other) if one == other => "-".to_owned(),
                (_, exact) => percent_range(exact),
            },
            count(d.success.bounds.invalid),
            match &d.excluded_because {
                Some(because) => format!("not compared: {because}"),
                None => d.population.brief().to_owned(),
            },
        ]
    });
    let columns = [
        ("dataset", Text),
        ("n", Number),
        ("succeeded", Number),
        ("success", Number),
        ("95 % interval", Number),
        ("exact 95 %", Number),
        ("invalid", Number),
        ("applies to", Text),
    ];
    Table::new("", &columns, rows.collect()).without_empty()
}

fn differences(of: &Comparison) -> Figure {
    let plotted: Vec<ForestRow> = of
        .differences
        .iter()
        .map(|d| ForestRow {
            label: format!("{} \u{2212} {}", d.first, d.second),
            estimate: 100.0 * d.difference,
            interval: d.interval_95.map(|end| 100.0 * end),
            significant: d.is_significant(),
            series: None,
        })
        .collect();
    let rows = of.differences.iter().map(|d| {
        vec![
            d.first.clone(),
            d.second.clone(),
            points(d.difference),
            points_range(d.interval_95),
            d.test().to_owned(),
            p_value(d.ln_p),
            plain_p(d.adjusted_p),
        ]
    });
    let columns = [
        ("first", Text),
        ("second", Text),
        ("points", Number),
        ("95 %, all pairs", Number),
        ("test", Short),
        ("p", Number),
        ("p, all pairs", Number),
    ];
    Figure {
        title: "Differences of success rates".to_owned(),
        svg: forest(
            &plotted,
            "",
            ["\u{2190} second ahead", "first ahead \u{2192}"],
            "Differences of success rates in percentage points",
        ),
        is_map: false,
        caption: format!(
            "Percentage points. Interval and p-value come from one score test and hold for all pairs together (Bonferroni): the \
             interval excludes 0 exactly if p is at most 0.05, shown by a filled dot. Datasets with the same scenarios are paired \
             (Tango); the others are independent runs (Miettinen and Nurminen; exact by Chan and Zhang up to {EXACT_TRIALS} \
             episodes of the smaller run)."
        ),
        findings: Vec::new(),
        table: Table::new("Differences", &columns, rows.collect()).at_most(MAX_ROWS),
    }
}
