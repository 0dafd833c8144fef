//! Danger zones: bins and levels with a low success rate.

use robogate_analysis::labels::{parameter_label, value_with_unit};
use robogate_analysis::{Analysis, DangerZones};
use robogate_stats::format::{count, p_value, percent_or_dash, percent_range};

use super::{Block, Figure, Section, Table, population};
use crate::document::Kind::{Number, Short, Text};
use crate::document::{MAX_ROWS, plain_p, yes_no};
use crate::figures;

/// Maximum number of zones in the figure. The table has more.
const MAX_DRAWN: usize = 14;

pub(super) fn section(analysis: &Analysis) -> Section {
    let zones = &analysis.danger_zones;
    let significant = zones.zones.iter().filter(|z| z.significant).count();
    let mut findings = vec![format!(
        "{significant} of {} bins and levels are significantly below 40 % success, the limit of the paper's danger zones, and below \
         the other bins of their parameter (one-sided tests with Holm adjustment).",
        count(zones.tested)
    )];
    if zones.zones.len() > significant {
        findings
            .push(format!("{} more were observed below it, but not significantly.", zones.zones.len() - significant));
    }
    let blocks = if zones.zones.is_empty() {
        vec![Block::Text(format!(
            "None of the {} bins and levels was observed below 40 % success.",
            count(zones.tested)
        ))]
    } else {
        vec![Block::Figure(Figure {
            title: "Smallest p-value first".to_owned(),
            svg: figures::danger_zones(zones, MAX_DRAWN),
            is_map: false,
            caption:
                "Observed success with Wilson intervals. The line is at 40 %. Filled dots are significantly below it."
                    .to_owned(),
            findings,
            table: table(zones),
        })]
    };
    Section { id: "danger", title: "Danger zones".to_owned(), population: population(analysis), blocks }
}

fn table(zones: &DangerZones) -> Table {
    let rows = zones.zones.iter().map(|zone| {
        vec![
            parameter_label(&zone.parameter),
            value_with_unit(&zone.cell, &zone.parameter),
            percent_or_dash(zone.rate.rate),
            percent_range(zone.rate.wilson_95),
            count(zone.rate.n),
            p_value(zone.ln_p),
            if zone.holm_p > 0.0 { plain_p(zone.holm_p) } else { "0".to_owned() },
            yes_no(zone.significant),
        ]
    });
    let columns = [
        ("parameter", Text),
        ("bin or level", Short),
        ("success", Number),
        ("95 % interval", Number),
        ("n", Number),
        ("p, below 40 %", Number),
        ("p (Holm)", Number),
        ("significant", Short),
    ];
    Table::new("Bins and levels observed below 40 % success", &columns, rows.collect()).at_most(MAX_ROWS)
}
