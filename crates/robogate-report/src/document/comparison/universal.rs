//! Universal zones: cells in which every dataset fails most of the time.

use robogate_analysis::labels::parameter_label;
use robogate_analysis::{Comparison, UniversalZones};
use robogate_stats::format::{count, counted, percent_or_dash, percent_range};

use super::{Block, Figure, Section, Table, population};
use crate::document::Kind::{Number, Short};
use crate::document::{MAX_ROWS, plain_p, yes_no};
use crate::figures;

/// Maximum number of zones in the figure. The table has more.
const MAX_DRAWN: usize = 14;

pub(super) fn section(of: &Comparison) -> Section {
    let zones = &of.universal_zones;
    let limit = format!("{:.0} %", 100.0 * zones.limit);
    let mut blocks = vec![Block::Text(method(zones, &limit))];
    if zones.tested == 0 {
        blocks.push(Block::Text("No cell has enough episodes of every dataset.".to_owned()));
    } else if zones.zones.is_empty() {
        blocks.push(Block::Text(format!("In no cell was every dataset observed below {limit}.")));
    } else {
        let significant = zones.zones.iter().filter(|zone| zone.significant).count();
        blocks.push(Block::Figure(Figure {
            title: format!("{significant} of {} significant", counted(zones.zones.len() as u64, "observed zone")),
            svg: figures::universal_zones(zones, &of.compared, MAX_DRAWN),
            is_map: false,
            caption: format!(
                "Success rates with 95 % intervals. The line is at {limit}. Zones with grey names are not significant."
            ),
            findings: Vec::new(),
            table: table(of),
        }));
    }
    Section { id: "universal", title: "Universal zones".to_owned(), population: population(of), blocks }
}

fn method(zones: &UniversalZones, limit: &str) -> String {
    let pair = zones.pair.as_ref().map_or_else(String::new, |[up, across]| {
        format!(", and cells of {} \u{d7} {}", parameter_label(up), parameter_label(across))
    });
    let untested = match zones.too_few_episodes {
        0 => String::new(),
        n => format!(
            " {} with fewer than {} episodes of some dataset {} not tested.",
            counted(n, "cell"),
            zones.smallest_n,
            if n == 1 { "was" } else { "were" }
        ),
    };
    format!(
        "A universal zone is a cell in which the success of every dataset is below {limit}: bins and levels of each shared \
         parameter{pair}. A zone is significant if every dataset is shown to be below the limit (intersection-union of exact \
         tests, Holm over the {} cells tested).{untested}",
        count(zones.tested)
    )
}

fn table(of: &Comparison) -> Table {
    let rows = of.universal_zones.zones.iter().map(|zone| {
        let rates = zone.rates.iter().map(|r| format!("{} ({})", percent_or_dash(r.rate), percent_range(r.wilson_95)));
        std::iter::once(zone.describe())
            .chain(rates)
            .chain([plain_p(zone.p), plain_p(zone.holm_p), yes_no(zone.significant)])
            .collect()
    });
    let mut columns = vec![("cell", Short)];
    columns.extend(of.compared.iter().map(|name| (name.as_str(), Number)));
    columns.extend([("p", Number), ("p (Holm)", Number), ("significant", Short)]);
    Table::new("Cells", &columns, rows.collect()).at_most(MAX_ROWS)
}
