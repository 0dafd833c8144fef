//! Outcomes of one dataset by outcomes of another.

use robogate_core::FailureMode;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::rows::PairedRows;
use crate::failures::mode_name;
use crate::table::Ending;

/// Outcomes of the first (rows) by outcomes of the second (columns).
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct CrossTable {
    /// The outcomes of rows and columns.
    pub outcomes: Vec<String>,
    /// Scenarios, one row for each outcome of the first.
    pub counts: Vec<Vec<u64>>,
}

/// Success, every failure mode, invalid.
const OUTCOMES: usize = FailureMode::ALL.len() + 2;

impl CrossTable {
    /// The table of paired rows, without outcomes that neither dataset has.
    pub(super) fn of(pairs: &PairedRows<'_>) -> Self {
        let mut counts = vec![vec![0; OUTCOMES]; OUTCOMES];
        for at in &pairs.rows {
            let (one, two) = pairs.endings(*at);
            counts[position(one)][position(two)] += 1;
        }
        let occurs = |i: &usize| counts[*i].iter().any(|n| *n > 0) || counts.iter().any(|row| row[*i] > 0);
        let kept: Vec<usize> = (0..OUTCOMES).filter(occurs).collect();
        Self {
            outcomes: kept.iter().map(|i| name(*i)).collect(),
            counts: kept.iter().map(|i| kept.iter().map(|j| counts[*i][*j]).collect()).collect(),
        }
    }
}

/// The name of an outcome, as in the dictionary.
pub(super) fn outcome_name(ending: Ending) -> String {
    name(position(ending))
}

fn position(ending: Ending) -> usize {
    match ending {
        Ending::Success => 0,
        Ending::Failure(mode) => 1 + usize::from(mode),
        Ending::Invalid => OUTCOMES - 1,
    }
}

fn name(position: usize) -> String {
    match position {
        0 => "success".to_owned(),
        i if i == OUTCOMES - 1 => "invalid".to_owned(),
        i => mode_name(i - 1),
    }
}
