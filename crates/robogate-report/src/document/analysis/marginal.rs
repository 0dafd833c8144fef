//! Marginal effects: success rate by each parameter.

use robogate_analysis::labels::{parameter_label, value_with_unit};
use robogate_analysis::{Analysis, Correlation, CriticalThreshold, Finding, MarginalEffect, ParameterType};
use robogate_stats::format::{
    count, counted, fixed, number, p_value, percent, percent_or_dash, percent_range, range, sentence,
};

use super::{Block, Figure, Section, Table, population};
use crate::document::Kind::{Number, Short, Text, Zone};
use crate::document::{MAX_ROWS, or_dash, plain_p};
use crate::figures;
use crate::text::low_side;

/// Maximum number of figures on the page. The other parameters are in the tables.
const MAX_FIGURES: usize = 16;
/// Number of figures that are visible before the reader opens the others.
const FIRST_FIGURES: usize = 3;
/// The smallest and the largest number of parameters in the table of effects. The others are folded.
const ROWS: [usize; 2] = [3, 5];
/// Share of crossing replicates above which the observed side of 50 % is not significant.
const CROSSING: f64 = 0.05;

pub(super) fn section(analysis: &Analysis) -> Section {
    let effects = &analysis.marginal_effects;
    let mut blocks = effects_tables(analysis);
    blocks.push(Block::Legend(
        "Strongest influence on success first. Dots are observed rates with Wilson intervals. The curve is a logistic model of the \
         parameter and its square with its 95 % band. The vertical line is where success crosses 50 %, with its interval from \
         1,000 bootstrap replicates. Dotted lines mark 30 % and 70 %."
            .to_owned(),
    ));
    let mut ranked: Vec<&MarginalEffect> = effects.iter().collect();
    let order = |effect: &MarginalEffect| {
        analysis.effects.ranked.iter().position(|of| of.parameter == effect.parameter).unwrap_or(usize::MAX)
    };
    ranked.sort_by_key(|effect| order(effect));
    let left_out = ranked.len().saturating_sub(MAX_FIGURES);
    let figures = ranked.into_iter().take(MAX_FIGURES).map(|effect| Figure {
        title: sentence(&effect.label),
        svg: figures::marginal_effect(effect),
        is_map: false,
        caption: caption(effect),
        findings: Vec::new(),
        table: cells_table(effect),
    });
    let figures: Vec<Figure> = figures.collect();
    let mut first = figures;
    let others = first.split_off(first.len().min(FIRST_FIGURES));
    blocks.push(Block::Grid(first));
    if !others.is_empty() {
        blocks.push(Block::Group(
            format!("{} with a weaker effect", counted(others.len() as u64, "parameter")),
            vec![Block::Grid(others)],
        ));
    }
    let mut tables = vec![Block::Table(numeric_table(effects))];
    tables.extend(categorical_table(effects).map(Block::Table));
    blocks.push(Block::Group("Thresholds and correlations as a table".to_owned(), tables));
    if left_out > 0 {
        blocks.push(Block::Text(format!(
            "{} with less influence are in the JSON document only.",
            counted(left_out as u64, "parameter")
        )));
    }
    Section { id: "marginal-effects", title: "Drivers of success".to_owned(), population: population(analysis), blocks }
}

/// The parameters in order of influence, with the test and the shape of each. Those after the last significant one are folded.
fn effects_tables(analysis: &Analysis) -> Vec<Block> {
    let effects = &analysis.effects;
    let rows = effects.ranked.iter().map(|effect| {
        let shape = effect.shape.estimated();
        vec![
            parameter_label(&effect.parameter),
            percent(effect.influence),
            plain_p(effect.p),
            plain_p(effect.adjusted_p),
            or_dash(shape, |shape| low_side(&effect.parameter, shape)),
            or_dash(shape, |shape| percent_or_dash(shape.low.rate)),
            or_dash(shape, |shape| percent_or_dash(shape.high.rate)),
        ]
    });
    let columns = [
        ("parameter", Text),
        ("variance explained", Number),
        ("p", Number),
        ("p (adjusted)", Number),
        ("success is low", Text),
        ("rate there", Number),
        ("rate elsewhere", Number),
    ];
    let mut rows: Vec<Vec<String>> = rows.collect();
    if rows.is_empty() {
        return Vec::new();
    }
    let significant = effects.ranked.iter().rposition(|effect| effect.significant).map_or(0, |last| last + 1);
    let others = rows.split_off(significant.clamp(ROWS[0], ROWS[1]).min(rows.len()));
    let mut table = Table::new("Influence on success, strongest first", &columns, rows);
    table.remark = Some(format!(
        "Permutation tests of an effect of any shape, adjusted (Holm) for {} and {}. Steps and rates are shown for significant \
         effects; a step has its 95 % interval.",
        counted(effects.tested, "parameter"),
        counted(effects.pairs_tested, "pair")
    ));
    let mut blocks = vec![Block::Table(table)];
    if !others.is_empty() {
        let more = counted(others.len() as u64, "more parameter");
        let weaker = if significant > ROWS[1] { "with a weaker effect" } else { "without a significant effect" };
        let title = format!("{more} {weaker}");
        blocks.push(Block::Folded(Table::new(title, &columns, others)));
    }
    blocks
}

fn caption(effect: &MarginalEffect) -> String {
    let outside = if effect.outside > 0 {
        format!(" {} lie outside the range.", counted(effect.outside, "episode"))
    } else {
        String::new()
    };
    let text = match &effect.threshold {
        Finding::Estimated(CriticalThreshold::Crosses { at, rising, .. }) => format!(
            "Success {} through 50 % at {}.",
            if *rising { "rises" } else { "falls" },
            value_with_unit(&number(*at), &effect.parameter)
        ),
        Finding::Estimated(CriticalThreshold::CrossesMoreThanOnce { .. }) => {
            "Success crosses 50 % more than once: no single threshold exists.".to_owned()
        }
        Finding::Estimated(CriticalThreshold::DoesNotCross { stays_above, crossing_share }) => format!(
            "Success stays {} 50 %{}.",
            side(*stays_above),
            if *crossing_share > CROSSING { ", but not significantly" } else { "" }
        ),
        Finding::CannotBeEstimated { because } => match effect.kind {
            ParameterType::Categorical => match effect.correlation.estimated() {
                Some(found) => format!("Cramer's V {}.", fixed(found.strength(), 3)),
                None => String::new(),
            },
            _ => format!("No threshold: {because}."),
        },
    };
    format!("{text}{outside}")
}

fn side(above: bool) -> &'static str {
    if above { "above" } else { "below" }
}

fn cells_table(effect: &MarginalEffect) -> Table {
    let rows = effect.cells.iter().map(|cell| {
        vec![
            cell.label.clone(),
            count(cell.rate.n),
            count(cell.rate.successes),
            percent_or_dash(cell.rate.rate),
            percent_range(cell.rate.wilson_95),
            percent_range(cell.rate.clopper_pearson_95),
            cell.zone.as_str().to_owned(),
        ]
    });
    let head = match effect.unit.as_str() {
        "" => effect.label.clone(),
        unit => format!("{} ({unit})", effect.label),
    };
    let columns = [
        (head.as_str(), Short),
        ("n", Number),
        ("succeeded", Number),
        ("success", Number),
        ("95 % interval", Number),
        ("exact 95 %", Number),
        ("zone", Zone),
    ];
    Table::new(format!("Success by {}", effect.label), &columns, rows.collect()).at_most(MAX_ROWS)
}

/// The threshold of one parameter: result, value, interval and standard error.
fn threshold(effect: &MarginalEffect) -> [String; 4] {
    let only = |text: String| [text, "-".to_owned(), "-".to_owned(), "-".to_owned()];
    match &effect.threshold {
        Finding::Estimated(CriticalThreshold::Crosses { at, rising, low, high, se, crossing_share }) => {
            let end = |x: &Option<f64>| x.map_or_else(|| "beyond".to_owned(), number);
            [
                format!(
                    "success {}; {} of the replicates cross",
                    if *rising { "rises" } else { "falls" },
                    percent(*crossing_share)
                ),
                value_with_unit(&number(*at), &effect.parameter),
                format!("{} to {}", end(low), end(high)),
                or_dash(*se, number),
            ]
        }
        Finding::Estimated(CriticalThreshold::CrossesMoreThanOnce { between }) => {
            let between: Vec<String> = between.iter().map(|b| range(*b)).collect();
            only(format!("crosses more than once: {}", between.join("; ")))
        }
        Finding::Estimated(CriticalThreshold::DoesNotCross { stays_above, crossing_share }) => {
            let side = side(*stays_above);
            only(if *crossing_share > CROSSING {
                format!("observed {side} 50 %, but {} of the replicates cross", percent(*crossing_share))
            } else {
                format!("stays {side} 50 %")
            })
        }
        Finding::CannotBeEstimated { because } => only(format!("cannot be estimated because {because}")),
    }
}

fn numeric_table(effects: &[MarginalEffect]) -> Table {
    let rows = effects.iter().filter(|effect| effect.kind != ParameterType::Categorical).map(|effect| {
        let [found, at, interval, se] = threshold(effect);
        let (r, rank, p) = match effect.correlation.estimated() {
            Some(Correlation::Number { point_biserial, ln_p, spearman, .. }) => {
                (fixed(*point_biserial, 3), or_dash(*spearman, |s| fixed(s, 3)), or_dash(*ln_p, p_value))
            }
            _ => ("-".to_owned(), "-".to_owned(), "-".to_owned()),
        };
        vec![effect.label.clone(), found, at, interval, se, r, rank, p]
    });
    let columns = [
        ("parameter", Short),
        ("threshold", Text),
        ("50 % at", Number),
        ("95 %", Number),
        ("se", Number),
        ("correlation", Number),
        ("rank correlation", Number),
        ("p", Number),
    ];
    Table::new("Critical thresholds and correlation with success", &columns, rows.collect())
        .at_most(MAX_ROWS)
        .without_empty()
}

fn categorical_table(effects: &[MarginalEffect]) -> Option<Table> {
    let rows: Vec<Vec<String>> = effects
        .iter()
        .filter(|effect| effect.kind == ParameterType::Categorical)
        .map(|effect| match &effect.correlation {
            Finding::Estimated(Correlation::Category { cramers_v, ln_p, smallest_expected }) => {
                let note = if *smallest_expected < 5.0 { " (approximate: a level is rare)" } else { "" };
                vec![effect.label.clone(), fixed(*cramers_v, 3), format!("{}{note}", p_value(*ln_p))]
            }
            Finding::Estimated(_) => vec![effect.label.clone(), "-".to_owned(), "-".to_owned()],
            Finding::CannotBeEstimated { because } => {
                vec![effect.label.clone(), "-".to_owned(), format!("cannot be estimated because {because}")]
            }
        })
        .collect();
    let columns = [("parameter", Text), ("Cramer's V", Number), ("p of independence", Number)];
    (!rows.is_empty()).then(|| Table::new("Categorical parameters and success", &columns, rows))
}
