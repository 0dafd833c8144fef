//! Where the policy fails: a table of conditions.

use robogate_analysis::{Analysis, FailureCondition, Finding, SoughtBox};
use robogate_stats::format::{count, fixed, percent_or_dash, percent_range};

use super::{Block, Section, Table, population};
use crate::document::Kind::{Number, Text};
use crate::document::plain_p;
use crate::text::condition;

/// The section. `None` without a condition.
pub(super) fn section(analysis: &Analysis) -> Option<Section> {
    let conditions = &analysis.conditions;
    let sought = conditions.sought.as_ref().and_then(Finding::estimated);
    if conditions.failing.is_empty() && sought.is_none() {
        return None;
    }
    let mut blocks = Vec::new();
    if !conditions.failing.is_empty() {
        let columns = [
            ("condition", Text),
            ("episodes", Number),
            ("success", Number),
            ("95 %", Number),
            ("elsewhere", Number),
            ("failures, times the mean", Number),
            ("p, corrected", Number),
        ];
        let rows = conditions.failing.iter().map(row).collect();
        blocks.push(Block::Table(Table::new("Conditions", &columns, rows)));
        blocks.push(Block::Text(
            "Limits were chosen on the same episodes, so the differences are slightly too large. The p-value is corrected for all \
             parameters and pairs together."
                .to_owned(),
        ));
    }
    blocks.extend(sought.map(replay));
    Some(Section { id: "where", title: "Where it fails".to_owned(), population: population(analysis), blocks })
}

fn row(of: &FailureCondition) -> Vec<String> {
    vec![
        condition(of),
        count(of.inside.n),
        percent_or_dash(of.inside.rate),
        percent_range(of.inside.wilson_95),
        percent_or_dash(of.outside.rate),
        of.lift.map_or_else(|| "-".to_owned(), |lift| fixed(lift, 2)),
        plain_p(of.adjusted_p),
    ]
}

fn replay(found: &SoughtBox) -> Block {
    let episodes = found.replay.iter().map(|of| {
        let parameters: Vec<String> = of.parameters.iter().map(|(name, value)| format!("{name} {value}")).collect();
        format!("Episode {} ({}): {}.", of.index, of.outcome, parameters.join(", "))
    });
    Block::List(episodes.collect())
}
