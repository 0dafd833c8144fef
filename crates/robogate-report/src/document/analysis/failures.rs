//! Failure modes: their shares, and the changes of the dominant one.

use robogate_analysis::labels::{mode_label, value_with_unit};
use robogate_analysis::{
    Analysis, FailureModes, Finding, MarginalEffect, ModeChange, ModeChanges, ModeShare, ParameterType,
};
use robogate_stats::format::{count, counted, number, percent_or_dash, percent_range, range, sentence};

use super::{Block, Figure, Section, Table, population};
use crate::document::Kind::{Number, Short, Text};
use crate::document::{or_dash, yes_no};
use crate::figures;

/// Maximum number of parameters with a figure.
const MAX_FIGURES: usize = 4;

pub(super) fn section(analysis: &Analysis) -> Section {
    let modes = &analysis.failure_modes;
    let mut blocks = Vec::new();
    if modes.failures == 0 {
        blocks.push(Block::cannot("The distribution of failure modes", "nothing failed"));
    } else {
        blocks.push(Block::Figure(shares(modes)));
        if modes.modes.iter().filter(|m| m.failures > 0).count() == 1 {
            blocks.push(Block::Text("There is only one failure mode, so it cannot change with a parameter.".into()));
        } else {
            changes(&mut blocks, analysis);
        }
    }
    Section { id: "failures", title: "Failure modes".to_owned(), population: population(analysis), blocks }
}

fn shares(modes: &FailureModes) -> Figure {
    let finding = match &modes.dominant {
        Finding::Estimated(dominant) => {
            format!("{} is significantly the most frequent mode.", sentence(&mode_label(dominant)))
        }
        Finding::CannotBeEstimated { because } => format!("No mode is significantly the most frequent: {because}."),
    };
    Figure {
        title: format!("{} by mode", counted(modes.failures, "failure")),
        svg: figures::failure_modes(modes),
        is_map: false,
        caption: "Shares of all failures, with simultaneous 95 % intervals.".to_owned(),
        findings: vec![finding],
        table: modes_table(modes),
    }
}

fn changes(blocks: &mut Vec<Block>, analysis: &Analysis) {
    let modes = &analysis.failure_modes;
    let with_bins = |effect: &&MarginalEffect| effect.transitions.estimated().is_some_and(|t| t.bins.len() > 1);
    let mut effects: Vec<&MarginalEffect> = analysis.marginal_effects.iter().filter(with_bins).collect();
    let weight = |effect: &MarginalEffect| {
        let changes = effect.transitions.estimated().map_or(0, |t| t.changes.len());
        (changes > 0, effect.correlation.estimated().map_or(0.0, |c| c.strength()))
    };
    effects.sort_by(|a, b| weight(b).partial_cmp(&weight(a)).unwrap_or(std::cmp::Ordering::Equal));
    let sentences: Vec<String> = effects.iter().flat_map(|effect| change_sentences(effect)).collect();
    blocks.push(Block::Heading("Changes of the dominant mode".to_owned()));
    if sentences.is_empty() {
        blocks.push(Block::Text("No parameter significantly changes the dominant failure mode.".to_owned()));
    } else {
        blocks.push(Block::List(sentences));
    }
    let figures = effects.into_iter().take(MAX_FIGURES).filter_map(|effect| {
        let changes = effect.transitions.estimated()?;
        Some(Figure {
            title: format!("Failure modes by {}", effect.label),
            svg: figures::mode_changes(&effect.parameter, changes, modes),
            is_map: false,
            caption: "Shares of the failures, in bins of about equal numbers of failures. A dot below a bin: its dominant mode is \
                      significantly the most frequent."
                .to_owned(),
            findings: Vec::new(),
            table: changes_table(effect, changes, modes),
        })
    });
    blocks.push(Block::Grid(figures.collect()));
}

fn change_sentences(effect: &MarginalEffect) -> Vec<String> {
    let Some(changes) = effect.transitions.estimated() else { return Vec::new() };
    let sentence = |c: &ModeChange| {
        let place = if (c.between[1] - c.between[0]).abs() <= 0.0 {
            format!("at {}", value_with_unit(&number(c.between[0]), &effect.parameter))
        } else {
            format!("between {}", value_with_unit(&range(c.between).replace(" to ", " and "), &effect.parameter))
        };
        format!(
            "With rising {}, the dominant mode changes from {} to {} {place}.",
            effect.label,
            mode_label(&c.from),
            mode_label(&c.to)
        )
    };
    changes.changes.iter().map(sentence).collect()
}

fn modes_table(modes: &FailureModes) -> Table {
    let rows = modes
        .modes
        .iter()
        .map(|m| vec![declared_label(m), count(m.failures), percent_or_dash(m.share), percent_range(m.interval_95)]);
    let columns = [("mode", Text), ("failures", Number), ("share", Number), ("simultaneous 95 %", Number)];
    Table::new("Failures by mode", &columns, rows.collect())
}

/// The label of a mode, marked if the task does not declare it.
fn declared_label(share: &ModeShare) -> String {
    let label = mode_label(&share.mode);
    if share.declared || share.is_unknown() { label } else { format!("{label} (undeclared)") }
}

/// The label of a bin: the level of an integer parameter, otherwise its edges.
fn bin_label(effect: &MarginalEffect, [low, high]: [f64; 2]) -> String {
    let is_level = effect.kind == ParameterType::Integer && (high - low - 1.0).abs() < 1e-9;
    if is_level { number(low + 0.5) } else { range([low, high]) }
}

fn changes_table(effect: &MarginalEffect, changes: &ModeChanges, modes: &FailureModes) -> Table {
    let label = effect.label.as_str();
    let rows = changes.bins.iter().map(|bin| {
        let mut row = vec![bin_label(effect, bin.range), count(bin.counts.iter().sum())];
        row.extend(bin.counts.iter().map(|n| count(*n)));
        row.push(or_dash(bin.dominant.as_deref(), mode_label));
        row.push(percent_or_dash(bin.share));
        row.push(yes_no(bin.significant));
        row
    });
    let heads: Vec<String> = modes.modes.iter().map(|m| mode_label(&m.mode)).collect();
    let mut columns = vec![(label, Short), ("failures", Number)];
    columns.extend(heads.iter().map(|h| (h.as_str(), Number)));
    columns.extend([("dominant", Text), ("share", Number), ("significant", Short)]);
    Table::new(format!("Failure modes by {label}"), &columns, rows.collect())
}
