//! What to change after a gate that did not pass: for the terminal and for the page of its run.

use std::collections::BTreeMap;

use robogate_analysis::{Analysis, Source};
use robogate_core::Outcome;
use robogate_gate::Evaluation;
use robogate_report::{Again, Change, Watch, what_to_change};

use crate::terminal::{bold, foreign, line, wrapped};

/// The statements for this evaluation and analysis of a source. `run` is a word of a shell command, and `again` has the options of a new run.
pub(crate) fn of(
    source: &Source,
    analysis: &Analysis,
    evaluation: &Evaluation,
    watch: Option<&Watch>,
    run: &str,
    again: &Again,
) -> Vec<Change> {
    let phases = analysis.failure_modes.dominant.estimated().map(|mode| phases(source, mode)).unwrap_or_default();
    what_to_change(evaluation, analysis, &phases, watch, run, again)
}

/// The phases in which a failure mode ended episodes, with their counts. Empty for rows that cannot be read or have no phases.
fn phases(source: &Source, mode: &str) -> Vec<(String, u64)> {
    let mut counts: BTreeMap<String, u64> = BTreeMap::new();
    for entry in source.dictionary().entries().flatten() {
        if let (Outcome::Failure(of), Some(phase)) = (&entry.episode.outcome, entry.episode.phase)
            && of.as_str() == mode
        {
            *counts.entry(phase.as_str().to_owned()).or_default() += 1;
        }
    }
    counts.into_iter().collect()
}

/// Prints the statements, each with its command.
pub(crate) fn print(changes: &[Change]) {
    if changes.is_empty() {
        return;
    }
    line("");
    line(bold("What to change"));
    for Change { text, command } in changes {
        wrapped(&foreign(text));
        if !command.is_empty() {
            line(format_args!("    {}", bold(foreign(command))));
        }
    }
}
