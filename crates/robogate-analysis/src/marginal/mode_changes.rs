//! Changes of the dominant failure mode along one parameter.

use robogate_stats::Confidence;
use robogate_stats::binning::Edges;
use robogate_stats::format::counted;
use robogate_stats::modes::{Transitions, transitions};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::{BINS, integer_edges};
use crate::labels::parameter_label;
use crate::rate::{Finding, ends};
use crate::table::{EpisodeTable, ParameterColumn, Sample};

/// Changes of the dominant failure mode along a parameter.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ModeChanges {
    /// Bins of about equal numbers of failures.
    pub bins: Vec<ModeBin>,
    /// Changes between bins with a significantly dominant mode.
    pub changes: Vec<ModeChange>,
}

/// Failures in one bin.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ModeBin {
    /// Edges of the bin.
    pub range: [f64; 2],
    /// Failures of each mode, in the order of the analysis' failure modes.
    pub counts: Vec<u64>,
    /// The most frequent mode. `None` without failures.
    pub dominant: Option<String>,
    /// Its share of the bin's failures.
    pub share: Option<f64>,
    /// Whether it is significantly more frequent than the second (exact sign test, Holm over the bins).
    pub significant: bool,
}

/// A change of the significantly dominant mode.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ModeChange {
    /// Mode below the change.
    pub from: String,
    /// Mode above the change.
    pub to: String,
    /// The range of values in which it changes.
    pub between: [f64; 2],
}

pub(super) fn mode_changes(table: &EpisodeTable, base: &Sample, parameter: &ParameterColumn) -> Finding<ModeChanges> {
    if !parameter.is_numeric() {
        return Finding::not("a categorical parameter has no order");
    }
    if base.dependence.is_some() {
        return Finding::not("the tests of modes need independent episodes, and these come in clusters");
    }
    // The tests count failures, so rows whose points were chosen are left out.
    let sampled = |at: usize| base.weights.is_none() || !table.is_focused(base.rows[at] as usize);
    let (failed, modes_of) = base.failures(table);
    let (failed, modes_of): (Vec<usize>, Vec<usize>) =
        failed.into_iter().zip(modes_of).filter(|(at, _)| sampled(*at)).unzip();
    if failed.len() < 2 {
        return Finding::not(format!("{} failed", counted(failed.len() as u64, "episode")));
    }
    let values: Vec<f64> = failed.iter().map(|i| parameter.values[*i]).collect();
    let bins = (failed.len() / 30).clamp(2, BINS);
    let edges = integer_edges(parameter).map_or_else(|| Edges::equal_count(&values, bins), Ok);
    let mode_name = |mode: usize| table.mode(mode).to_owned();
    // The page lists the changes of all parameters, so they share the error.
    let level = Confidence::P95.shared_by(base.parameters.len());
    let found = edges.and_then(|edges| transitions(&values, &modes_of, table.modes.len(), &edges, level));
    match found {
        Ok(Transitions { bins, transitions, .. }) => Finding::Estimated(ModeChanges {
            bins: bins
                .into_iter()
                .map(|bin| ModeBin {
                    range: ends(bin.range),
                    dominant: bin.dominance.map(|d| mode_name(d.mode)),
                    share: bin.dominance.map(|d| d.count as f64 / d.failures as f64),
                    significant: bin.sure,
                    counts: bin.counts,
                })
                .collect(),
            changes: transitions
                .into_iter()
                .map(|t| ModeChange { from: mode_name(t.from), to: mode_name(t.to), between: ends(t.between) })
                .collect(),
        }),
        Err(_) => Finding::not(format!("{} has the same value in every failure", parameter_label(&parameter.name))),
    }
}
