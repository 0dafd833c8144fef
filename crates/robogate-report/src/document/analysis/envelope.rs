//! The operating envelope: success by two parameters, and the frontier between success and failure.

use robogate_analysis::labels::{parameter_label, value_with_unit};
use robogate_analysis::{Analysis, Envelope, Finding, Frontier, PairCounts, PairMap};
use robogate_stats::format::{counted, number, percent_or_dash, percent_range, range};

use super::models::regression_table;
use super::{Block, Figure, Section, Table, population};
use crate::document::Kind::{Number, Text};
use crate::document::map::{map_table, map_title, map_zones};
use crate::figures::{Boundary, drawable, heatmap};

pub(super) fn section(analysis: &Analysis, pairs: Option<&PairCounts>) -> Section {
    let mut blocks = Vec::new();
    if analysis.envelopes.is_empty() {
        blocks.push(Block::cannot("An envelope", "there are fewer than two numeric parameters"));
    }
    for (i, envelope) in analysis.envelopes.iter().enumerate() {
        // The first map has the strongest parameters. The others are folded.
        match &envelope.map {
            Finding::Estimated(map) if i > 0 => {
                let mut folded = Vec::new();
                one(&mut folded, envelope, i);
                blocks.push(Block::Group(map_title(map), folded));
            }
            _ => one(&mut blocks, envelope, i),
        }
    }
    blocks.extend(pairs.filter(|pairs| pairs.axes.len() > 2).map(|pairs| Block::Pairs(pairs.clone())));
    Section { id: "envelope", title: "Operating envelope".to_owned(), population: population(analysis), blocks }
}

fn one(blocks: &mut Vec<Block>, envelope: &Envelope, at: usize) {
    let frontier = envelope.frontier.estimated();
    match &envelope.map {
        Finding::Estimated(map) => blocks.push(Block::Figure(map_figure(map, frontier, at))),
        Finding::CannotBeEstimated { because } => blocks.push(Block::cannot("The map", because)),
    }
    match &envelope.frontier {
        Finding::Estimated(frontier) => frontier_blocks(blocks, frontier),
        Finding::CannotBeEstimated { because } => blocks.push(Block::cannot("The frontier in closed form", because)),
    }
}

fn map_figure(map: &PairMap, frontier: Option<&Frontier>, at: usize) -> Figure {
    let zones = map.zones;
    let open = |n: u64, why: &str| (n > 0).then(|| format!("{n} of {} cells {why}.", map.cells.len()));
    let mut findings = vec![map_zones(map)];
    findings.extend(open(zones.undecided, "are undecided: their interval includes a limit"));
    findings.extend(open(zones.too_few_episodes, "have too few episodes to classify"));
    findings.push(match map.length_scale {
        Some(_) => {
            "Zones use the pointwise 95 % intervals of a smooth model of all episodes: on average, at most 5 % of the \
                    classified area is wrong."
                .into()
        }
        None => {
            "Zones use simultaneous 95 % intervals for the whole map, which are wider than the interval of each cell."
                .to_owned()
        }
    });
    // The first sentence says where success is likely. The others are with the frontier's numbers.
    findings.extend(frontier.and_then(|frontier| frontier_findings(frontier).into_iter().next()));
    Figure {
        title: map_title(map),
        svg: heatmap(map, frontier.map_or(Boundary::None, Boundary::Frontier), &format!("clip{at}")),
        is_map: true,
        caption: match map.length_scale {
            Some(_) => "Success in percent by a smooth model, with the number of episodes below it. The table has its intervals \
                        and the observed rates."
                .to_owned(),
            None => "Observed success in percent, with the number of episodes below it. Cells have equal width on the scale of \
                     each parameter."
                .to_owned(),
        },
        findings,
        table: map_table(map, "n"),
    }
}

fn frontier_blocks(blocks: &mut Vec<Block>, frontier: &Frontier) {
    if frontier.contradicted {
        blocks.push(Block::Caution(format!(
            "Do not rely on this frontier: where the model predicts 40 to 60 % success, the observed rate is {} ({} in {}). \
             The cells of the map show the observed rates.",
            percent_or_dash(frontier.near.rate),
            percent_range(frontier.near.wilson_95),
            counted(frontier.near.n, "episode")
        )));
    }
    let details: Vec<String> = frontier_findings(frontier).into_iter().skip(1).collect();
    let mut model: Vec<Block> = if details.is_empty() { Vec::new() } else { vec![Block::List(details)] };
    model.extend([
        Block::Code(frontier.closed_form.clone()),
        Block::Table(regression_table("Model of the frontier", &frontier.regression)),
        Block::Table(curve_table(frontier)),
    ]);
    model.extend(frontier.regression.warnings.iter().cloned().map(Block::Caution));
    blocks.push(Block::Group("The frontier in closed form".to_owned(), model));
}

fn frontier_findings(frontier: &Frontier) -> Vec<String> {
    let (x, y) = (parameter_label(&frontier.x), parameter_label(&frontier.y));
    let mut lines = Vec::new();
    match frontier.valid_for {
        _ if drawable(frontier).is_empty() => {
            lines.push(format!(
                "The 50 % frontier is not drawn: its exact interval is unbounded within the \
                 observed ranges, so no {x} significantly separates success from failure."
            ));
            return lines;
        }
        Some(valid) => {
            if let Some(above) = frontier.success_above {
                let side = if above { "above" } else { "below" };
                lines.push(format!("Success is more likely than failure {side} the 50 % frontier of the model."));
            }
            if !frontier.contradicted && frontier.near.n > 0 {
                lines.push(format!(
                    "Where the model predicts 40 to 60 %, the observed rate is {} ({}).",
                    percent_or_dash(frontier.near.rate),
                    percent_range(frontier.near.wilson_95)
                ));
            }
            lines.push(format!(
                "Episodes support the frontier for {y} {}; elsewhere it is an extrapolation.",
                value_with_unit(&range(valid), &frontier.y)
            ));
        }
        None => lines.push(format!(
            "The 50 % frontier lies outside the observed ranges of {y} and {x}: the model \
             predicts the same outcome everywhere."
        )),
    }
    let observed = |y: &f64| {
        let known = frontier.curve.iter().filter(|point| point.observed).map(|point| point.y);
        known.clone().any(|other| other <= *y) && known.clone().any(|other| other >= *y)
    };
    if let Some(pole) = frontier.pole.filter(observed) {
        lines.push(format!(
            "It has no value near {y} {}: no {x} separates success from failure there.",
            value_with_unit(&number(pole), &frontier.y)
        ));
    }
    lines
}

fn curve_table(frontier: &Frontier) -> Table {
    let rows = frontier.curve.iter().step_by(4).map(|point| {
        vec![
            number(point.y),
            number(point.x),
            number(point.se),
            range(point.band_95),
            point.exact_95.map_or_else(|| "unbounded".to_owned(), range),
            if point.observed { "observed" } else { "extrapolated" }.to_owned(),
        ]
    });
    let (y, x) = (parameter_label(&frontier.y), format!("{}*", parameter_label(&frontier.x)));
    let columns = [
        (y.as_str(), Number),
        (x.as_str(), Number),
        ("se", Number),
        ("95 % band", Number),
        ("exact 95 %", Number),
        ("range", Text),
    ];
    Table::new("Points of the frontier", &columns, rows.collect())
}
