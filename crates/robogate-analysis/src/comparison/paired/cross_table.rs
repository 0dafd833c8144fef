//! Cross table of the outcomes of two datasets.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::rows::PairedRows;
use crate::table::EpisodeTable;

/// Cross table of the outcomes of the first dataset (rows) and the second (columns).
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct CrossTable {
    /// The outcomes of rows and columns.
    pub outcomes: Vec<String>,
    /// Number of scenarios: one row for each outcome of the first.
    pub counts: Vec<Vec<u64>>,
}

impl CrossTable {
    /// Counts paired rows. Outcomes that neither dataset has are left out.
    pub(super) fn of(pairs: &PairedRows<'_>) -> Self {
        let (first, second) = (&pairs.first.table, &pairs.second.table);
        let outcomes = outcomes(first, second);
        // Datasets may number undeclared modes differently, so outcomes are matched by name.
        let position = |name: &str| outcomes.iter().position(|known| *known == name).unwrap_or_default();
        let mut counts = vec![vec![0; outcomes.len()]; outcomes.len()];
        for at in &pairs.rows {
            let (one, two) = pairs.endings(*at);
            counts[position(first.outcome_name(one))][position(second.outcome_name(two))] += 1;
        }
        let occurs = |i: &usize| counts[*i].iter().any(|n| *n > 0) || counts.iter().any(|row| row[*i] > 0);
        let kept: Vec<usize> = (0..outcomes.len()).filter(occurs).collect();
        Self {
            outcomes: kept.iter().map(|i| outcomes[*i].to_owned()).collect(),
            counts: kept.iter().map(|i| kept.iter().map(|j| counts[*i][*j]).collect()).collect(),
        }
    }
}

/// The outcomes of the table: success, the failure modes of both datasets, invalid.
fn outcomes(first: &EpisodeTable, second: &EpisodeTable) -> Vec<&'static str> {
    let mut names = vec!["success"];
    for mode in first.modes.iter().chain(&second.modes) {
        if !names.contains(&mode.as_str()) {
            names.push(mode.as_str());
        }
    }
    names.push("invalid");
    names
}
