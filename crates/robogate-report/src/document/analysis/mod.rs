//! The document of an analysis: the result first, then the evidence.

mod active;
mod conditions;
mod danger;
mod envelope;
mod failures;
mod forces;
mod marginal;
mod models;
mod provenance;
mod replay;
mod sampling;
mod twins;

use robogate_analysis::{Analysis, Population};
use robogate_stats::format::{count, counted, percent, percent_range, sentence};

use super::{Block, Document, Figure, Section, Table, watch_section};
use crate::gate::VerdictBlock;
use crate::text::{Headline, limits};
use crate::{Additions, figures};

/// Creates the document of an analysis.
pub(crate) fn analysis_document(analysis: &Analysis, additions: &Additions<'_>) -> Document {
    let subject = &analysis.subject;
    let success = &analysis.success;
    let bounds = match (success.bounds.invalid, success.bounds.worst_case, success.bounds.best_case) {
        (1.., Some(worst), Some(best)) => Some([worst, best]),
        _ => None,
    };
    let engine = if is_unknown(&subject.engine) { "an unknown engine" } else { subject.engine.as_str() };
    let headline = Headline::of(analysis);
    Document {
        kind: "failure report",
        title: title(analysis),
        subtitle: format!(
            "{}{} in {engine} \u{b7} dataset {}",
            if is_unknown(&subject.task) { String::new() } else { format!("Task {} \u{b7} ", subject.task) },
            counted(subject.episodes, "episode"),
            subject.dataset_hash.get(..12).unwrap_or(&subject.dataset_hash)
        ),
        figure: success.rate.rate.map_or_else(|| "\u{2013}".to_owned(), percent),
        figure_label: format!("success, {}", analysis.population.brief()),
        interval: format!(
            "95 % interval {} \u{b7} n = {}{}",
            percent_range(success.rate.wilson_95),
            count(success.rate.n),
            not_counted(analysis)
        ),
        scale: figures::rate_scale(&success.rate, bounds),
        answer: headline.answer,
        columns: vec![
            ("Where it fails", headline.where_it_fails),
            ("What to do", headline.what_to_do),
            ("Uncertainty", headline.uncertainty),
        ]
        .into_iter()
        .filter(|(_, lines)| !lines.is_empty())
        .collect(),
        sections: sections(analysis, additions),
        verdict: additions.evaluation.map(|evaluation| VerdictBlock::of(evaluation, additions.changes)),
    }
}

/// Why the rate counts fewer episodes than the run has. Empty if it counts all stages.
fn not_counted(analysis: &Analysis) -> String {
    let counted_all = analysis.success.weighting.as_ref().is_some_and(|of| of.estimated().is_some());
    if counted_all || analysis.population == Population::FocusedDesign {
        return String::new();
    }
    let chosen = analysis.success.stages.iter().filter(|stage| stage.population == Population::FocusedDesign);
    match chosen.map(|stage| stage.episodes).sum() {
        0 => String::new(),
        n => format!("; {} sampled near failures do not count here", counted(n, "episode")),
    }
}

/// The sections: first what a reader acts on, then the evidence.
fn sections(analysis: &Analysis, additions: &Additions<'_>) -> Vec<Section> {
    let mut sections: Vec<Section> = additions.watch.map(watch_section).into_iter().collect();
    sections.extend(additions.twins.map(twins::section));
    sections.extend(additions.nominal.map(|nominal| Section {
        id: "nominal",
        title: "Nothing varied".to_owned(),
        population: Some(
            "Applies to the environment as its author made it, with the first seeds of this run.".to_owned(),
        ),
        blocks: vec![Block::Text(nominal.line())],
    }));
    sections.extend(additions.warner.map(|warner| Section {
        id: "warner",
        title: "Warnings".to_owned(),
        population: Some("Applies to the episodes that represent the operating space.".to_owned()),
        blocks: warner.lines().into_iter().map(Block::Text).collect(),
    }));
    sections.extend(forces::section(additions.forces));
    sections.extend(conditions::section(analysis));
    sections.extend([
        marginal::section(analysis),
        envelope::section(analysis, additions.pairs),
        failures::section(analysis),
    ]);
    let draws = !analysis.provenance.task.draws.is_empty();
    sections.extend(additions.active.map(|model| active::section(model, draws)));
    sections.extend([
        models::risk(analysis),
        replay::section(analysis),
        paper(analysis),
        sampling::section(analysis),
        provenance::section(analysis),
        Section {
            id: "limits",
            title: "Limits".to_owned(),
            population: None,
            blocks: vec![Block::List(limits(analysis))],
        },
    ]);
    sections
}

/// The figures of the paper that introduced RoboGate, in one section.
fn paper(analysis: &Analysis) -> Section {
    let mut blocks = Vec::new();
    for part in [danger::section(analysis), models::interactions(analysis)] {
        blocks.push(Block::Heading(part.title));
        blocks.extend(part.population.map(Block::Text));
        blocks.extend(part.blocks);
    }
    Section { id: "paper", title: "Figures of the RoboGate paper".to_owned(), population: None, blocks }
}

fn is_unknown(name: &str) -> bool {
    name.is_empty() || name == "unknown"
}

fn title(analysis: &Analysis) -> String {
    let subject = &analysis.subject;
    let robot = match subject.robot.as_str() {
        robot if is_unknown(robot) => "Unknown robot".to_owned(),
        // A short type code, as in ur10.
        robot if robot.len() < 6 && robot.ends_with(|c: char| c.is_ascii_digit()) => robot.to_uppercase(),
        robot => sentence(robot),
    };
    let policy =
        if is_unknown(&subject.policy) { "unknown policy".to_owned() } else { format!("{} policy", subject.policy) };
    format!("{robot}, {policy}")
}

/// The population of the analysis, as a sentence below the title of a section.
fn population(analysis: &Analysis) -> Option<String> {
    Some(format!("Applies to {}.", analysis.population.describe()))
}
