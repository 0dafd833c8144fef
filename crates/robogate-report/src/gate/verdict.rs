//! The verdict of the gate as the opening of a report.

use std::fmt::Write;

use maud::Markup;
use robogate_gate::{Controls, Evaluation, Mode, Sampling, Status, Verdict};
use robogate_stats::format::{count, counted, percent_range};

use super::{Change, RequirementRow, feasible_part, how_judged, sign, what_next};
use crate::figures;
use crate::markdown::escape_markdown;

/// Maximum number of scenario groups in the list of the weakest.
const MAX_GROUPS: usize = 3;

/// The verdict with its reason, the requirements and the next step.
#[derive(Debug)]
pub(crate) struct VerdictBlock {
    pub(crate) verdict: Verdict,
    /// The reason, as a sentence.
    pub(crate) because: String,
    pub(crate) requirements: Vec<VerdictRow>,
    /// The scenario groups with the lowest success rates. Empty if every group always succeeds.
    pub(crate) weakest: Vec<String>,
    /// What to change, with commands. Empty for a gate that passed.
    pub(crate) changes: Vec<Change>,
    /// The next step and its cost.
    pub(crate) next: String,
    /// The basis of the verdict.
    pub(crate) basis: String,
    /// Remarks about the episodes, and one line for each control.
    pub(crate) controls: Vec<String>,
    /// How often states were outside of the range of the training data.
    pub(crate) outside_range: Option<String>,
}

/// A requirement with its figure.
#[derive(Debug)]
pub(crate) struct VerdictRow {
    pub(crate) row: RequirementRow,
    /// The interval with the limit. `None` without an observed figure.
    pub(crate) bar: Option<Markup>,
}

impl VerdictBlock {
    pub(crate) fn of(evaluation: &Evaluation, changes: &[Change]) -> Self {
        let mut bars: Vec<Option<Markup>> = evaluation.results.iter().map(figures::requirement_bar).collect();
        let rows = RequirementRow::all(evaluation);
        bars.resize(rows.len(), None);
        let mut requirements: Vec<VerdictRow> =
            rows.into_iter().zip(bars).map(|(row, bar)| VerdictRow { row: readable(row), bar }).collect();
        let urgency = |status| match status {
            Status::Violated => 0,
            Status::NoEvidence => 1,
            Status::Undecided => 2,
            Status::Met => 3,
        };
        requirements.sort_by_key(|one| urgency(one.row.status));
        let counts = evaluation.counts;
        let rounds = counts.rounds.map_or_else(String::new, |rounds| format!(" in {}", counted(rounds, "round")));
        Self {
            verdict: evaluation.verdict,
            because: because(evaluation, &requirements),
            requirements,
            weakest: weakest(evaluation),
            changes: changes.to_vec(),
            next: next_step(evaluation),
            controls: evaluation
                .remarks()
                .into_iter()
                .chain(evaluation.controls.iter().flat_map(Controls::lines))
                .collect(),
            outside_range: evaluation.outside_range.as_ref().map(ToString::to_string),
            basis: format!(
                "{}{rounds}, {} of them invalid. {}{}",
                counted(counts.episodes, "episode"),
                count(counts.invalid),
                how_judged(evaluation),
                feasible_part(evaluation).map_or_else(String::new, |text| format!(" {text}"))
            ),
        }
    }

    /// The verdict in one upper-case word.
    pub(crate) fn word(&self) -> String {
        self.verdict.as_str().to_uppercase()
    }

    /// Writes the verdict as Markdown.
    pub(crate) fn markdown(&self, out: &mut String) {
        // Writing to a string cannot fail.
        let _ = write!(out, "## Verdict: {}\n\n{}\n\n", self.word(), escape_markdown(&self.because));
        out.push_str("| | requirement | observed | one-sided bounds | |\n|---|---|---:|---:|---|\n");
        for VerdictRow { row, .. } in &self.requirements {
            let _ = writeln!(
                out,
                "| {} | {} | {} | {} | {} |",
                sign(row.status),
                escape_markdown(&row.requirement),
                escape_markdown(&row.observed),
                escape_markdown(&row.interval),
                escape_markdown(&row.note)
            );
        }
        let _ = write!(out, "\n**Next step.** {}\n\n", escape_markdown(&self.next));
        for (at, change) in self.changes.iter().enumerate() {
            let command = if change.command.is_empty() { String::new() } else { format!(" `{}`", change.command) };
            let _ = writeln!(out, "{}. {}{command}", at + 1, escape_markdown(&change.text));
        }
        if !self.changes.is_empty() {
            out.push('\n');
        }
        for line in self.weakest.iter().chain(&self.controls).chain(&self.outside_range) {
            let _ = writeln!(out, "- {}", escape_markdown(line));
        }
        let _ = write!(out, "\n{}\n\n", escape_markdown(&self.basis));
    }
}

/// A row with spaces for the underscores of identifiers.
fn readable(row: RequirementRow) -> RequirementRow {
    RequirementRow { requirement: row.requirement.replace('_', " "), ..row }
}

/// The reason for the verdict, as a sentence. A failed gate names what it violates.
fn because(evaluation: &Evaluation, requirements: &[VerdictRow]) -> String {
    let violated = requirements.iter().filter(|one| one.row.status == Status::Violated);
    let violated: Vec<String> =
        violated.map(|one| format!("{} (observed {})", one.row.requirement, one.row.observed)).collect();
    if evaluation.verdict == Verdict::Fail && !violated.is_empty() {
        return format!("Violated: {}.", violated.join("; "));
    }
    robogate_stats::format::sentence(&format!("{}.", evaluation.because.trim_end_matches('.')))
}

/// The scenario groups with the lowest success rates, as sentences. A single group, such as that of sampled scenarios, is not
/// weaker than another one.
fn weakest(evaluation: &Evaluation) -> Vec<String> {
    if evaluation.groups.len() < 2 {
        return Vec::new();
    }
    let rate = |successes: u64, valid: u64| successes as f64 / valid.max(1) as f64;
    let mut groups: Vec<_> = evaluation.groups.iter().filter(|group| group.successes < group.valid).collect();
    groups.sort_by(|a, b| rate(a.successes, a.valid).total_cmp(&rate(b.successes, b.valid)));
    let line = |group: &&robogate_gate::GroupResult| {
        let endings: Vec<String> =
            group.endings.iter().map(|e| format!("{} {}", e.ending.replace('_', " "), e.episodes)).collect();
        format!(
            "{}/{}: {} of {} succeeded ({}); {}.",
            group.category,
            group.group,
            count(group.successes),
            count(group.valid),
            percent_range(group.interval_95),
            endings.join(", ")
        )
    };
    groups.iter().take(MAX_GROUPS).map(line).collect()
}

/// The next step and its cost.
fn next_step(evaluation: &Evaluation) -> String {
    let counts = evaluation.counts;
    let scenarios = counts.rounds.filter(|rounds| *rounds > 0).map(|rounds| counts.episodes / rounds);
    let again = scenarios.map_or_else(String::new, |scenarios| {
        let most = scenarios * u64::from(evaluation.requirements.budget.rounds);
        format!(" A new gate takes at most {}.", counted(most, "episode"))
    });
    match evaluation.verdict {
        _ if evaluation.ruled_out.is_some() => what_next(evaluation),
        Verdict::Pass => {
            "Write the evidence with `robogate evidence`, and the reference for the monitor with `robogate \
                          monitor reference`. Neither runs more episodes."
                .to_owned()
        }
        Verdict::Fail => format!(
            "Watch the failed episodes below and improve the policy where it is weakest. Judge the new policy with another \
             --seed.{again}"
        ),
        Verdict::Inconclusive => {
            let next = what_next(evaluation);
            match (next.is_empty(), evaluation.requirements.mode, evaluation.sampling) {
                (false, _, Sampling::Sequential) => format!("{next} Raise --rounds and run the gate again."),
                (false, ..) => next,
                (true, Mode::Confidence, _) => {
                    "The observed figures are too close to the limits for a practical number of \
                                                episodes. Improve the policy, or change the requirement."
                        .to_owned()
                }
                (true, Mode::Point, _) => "Provide the missing evidence, then judge the run again.".to_owned(),
            }
        }
        Verdict::Invalid => format!(
            "Remove the cause of the invalid episodes (see the failures section), then run the gate again.{again}"
        ),
    }
}
