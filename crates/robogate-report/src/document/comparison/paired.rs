//! One paired comparison.

use robogate_analysis::labels::{mode_label, parameter_label};
use robogate_analysis::{DisagreementMap, Finding, PairedComparison};
use robogate_stats::format::{count, p_equation, percent_or_dash, percent_range, points, points_range};

use super::{Block, Figure, Section, Table};
use crate::document::Kind::{Code, Number, Short, Text};
use crate::document::{MAX_MAP_ROWS, or_dash, plain_p};
use crate::figures;

/// Anchors of the sections. Further pairs share the last one.
const IDS: [&str; 7] = ["paired", "paired-2", "paired-3", "paired-4", "paired-5", "paired-6", "paired-more"];

pub(super) fn section(pair: &PairedComparison, at: usize) -> Section {
    let mut blocks = vec![
        Block::Text(format!(
            "{} succeeds in {} ({}), {} in {} ({}). Both solve {}, only {} solves {}, only {} solves {}, and neither solves {}.",
            pair.first,
            percent_or_dash(pair.first_rate.rate),
            percent_range(pair.first_rate.wilson_95),
            pair.second,
            percent_or_dash(pair.second_rate.rate),
            percent_range(pair.second_rate.wilson_95),
            count(pair.both),
            pair.first,
            count(pair.first_only),
            pair.second,
            count(pair.second_only),
            count(pair.neither)
        )),
        Block::Facts(facts(pair)),
    ];
    blocks.push(match &pair.disagreement {
        Finding::Estimated(map) => Block::Figure(map_figure(pair, map)),
        Finding::CannotBeEstimated { because } => Block::Text(format!("No map: {because}.")),
    });
    blocks.push(Block::Table(cross_table(pair)));
    if !pair.flips.is_empty() {
        blocks.push(Block::Folded(flips_table(pair)));
    }
    Section {
        id: IDS[at.min(IDS.len() - 1)],
        title: format!("{} and {}, scenario by scenario", pair.first, pair.second),
        population: Some("Applies to the scenarios that both ran, without invalid ones.".to_owned()),
        blocks,
    }
}

fn facts(pair: &PairedComparison) -> Vec<(String, String)> {
    let difference = or_dash(pair.difference, |difference| {
        format!("{} points ({})", points(difference), points_range(pair.difference_95))
    });
    let mut facts = vec![
        ("Difference".to_owned(), difference),
        (
            "Score test".to_owned(),
            format!("{}; {} for all pairs of datasets together", p_equation(pair.ln_p), plain_p(pair.adjusted_p)),
        ),
        ("Scenarios".to_owned(), format!("{}, {} valid in both", count(pair.scenarios), count(pair.valid_pairs))),
    ];
    facts.extend(pair.how_paired().map(|text| ("Pairs".to_owned(), text)));
    if pair.invalid.either > 0 {
        facts.push((
            "Invalid".to_owned(),
            format!(
                "{} in {}, {} in {}: excluded from every rate. Their outcomes could put the difference over all scenarios anywhere \
                 within {} points.",
                count(pair.invalid.first),
                pair.first,
                count(pair.invalid.second),
                pair.second,
                or_dash(pair.invalid.difference_bounds, points_range)
            ),
        ));
    }
    facts
}

fn map_figure(pair: &PairedComparison, map: &DisagreementMap) -> Figure {
    let nx = map.x.cells().max(1);
    let rows = map.cells.iter().enumerate().map(|(i, cell)| {
        vec![
            map.y.cell_label(i / nx),
            map.x.cell_label(i % nx),
            count(cell.differ.n),
            percent_or_dash(cell.differ.rate),
            percent_range(cell.differ.wilson_95),
            count(cell.first_only),
            count(cell.second_only),
            plain_p(cell.holm_p),
        ]
    });
    let (y, x) = (parameter_label(&map.y.parameter), parameter_label(&map.x.parameter));
    let heads = [format!("only {}", pair.first), format!("only {}", pair.second)];
    let columns = [
        (y.as_str(), Short),
        (x.as_str(), Short),
        ("n", Number),
        ("differ", Number),
        ("95 % interval", Number),
        (heads[0].as_str(), Number),
        (heads[1].as_str(), Number),
        ("p (Holm)", Number),
    ];
    Figure {
        title: format!("Different outcomes by {y} \u{d7} {x}"),
        svg: figures::disagreement(map, [&pair.first, &pair.second]),
        is_map: true,
        caption: "Scenarios with different outcomes in percent, with the number of scenarios below it. The colour shows which \
                  dataset is ahead."
            .to_owned(),
        findings: Vec::new(),
        table: Table::new("Cells", &columns, rows.collect()).at_most(MAX_MAP_ROWS),
    }
}

fn cross_table(pair: &PairedComparison) -> Table {
    let outcomes: Vec<String> = pair.outcomes.outcomes.iter().map(|outcome| mode_label(outcome)).collect();
    let mut columns = vec![("", Short)];
    columns.extend(outcomes.iter().map(|outcome| (outcome.as_str(), Number)));
    let rows = outcomes
        .iter()
        .zip(&pair.outcomes.counts)
        .map(|(outcome, counts)| std::iter::once(outcome.clone()).chain(counts.iter().map(|n| count(*n))).collect());
    Table::new(format!("Outcomes: {} in rows, {} in columns", pair.first, pair.second), &columns, rows.collect())
}

fn flips_table(pair: &PairedComparison) -> Table {
    let rows = pair.flips.iter().map(|flip| {
        vec![
            count(flip.index),
            mode_label(&flip.first),
            mode_label(&flip.second),
            if flip.replay.is_empty() { "-".to_owned() } else { flip.replay.join(" ; ") },
            flip.describe(),
        ]
    });
    let columns = [
        ("index", Number),
        (pair.first.as_str(), Short),
        (pair.second.as_str(), Short),
        ("replay", Code),
        ("parameters", Text),
    ];
    let mut table =
        Table::new("Scenarios that one solved and the other did not", &columns, rows.collect()).without_empty();
    let all = pair.first_only + pair.second_only;
    if all > pair.flips.len() as u64 {
        table.remark = Some(format!("{} of {}; use --flips to list more.", pair.flips.len(), count(all)));
    }
    table
}
