//! Scenarios that one dataset solved and the other did not.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::rows::PairedRows;
use crate::labels::{parameter_label, value_with_unit};
use crate::table::Ending;

/// A scenario that one dataset solved and the other did not.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Flip {
    /// Its index, which is the same in both campaigns.
    pub index: u64,
    /// Outcome in the first dataset.
    pub first: String,
    /// Outcome in the second dataset.
    pub second: String,
    /// Its parameters as names and values.
    pub parameters: Vec<(String, String)>,
    /// The commands that replay it. Empty if neither source is a run's folder.
    pub replay: Vec<String>,
}

impl Flip {
    /// The parameters in one line.
    pub fn describe(&self) -> String {
        let all = self
            .parameters
            .iter()
            .map(|(parameter, value)| format!("{} {}", parameter_label(parameter), value_with_unit(value, parameter)));
        all.collect::<Vec<_>>().join(", ")
    }
}

/// The first flips of each direction, at most `max` of each.
pub(super) fn flips(pairs: &PairedRows<'_>, max: usize) -> Vec<Flip> {
    let mut left = [max; 2];
    let mut found = Vec::new();
    for at in &pairs.rows {
        let (one, two) = pairs.endings(*at);
        let direction = match (one, two) {
            (Ending::Success, Ending::Failure(_)) => 0,
            (Ending::Failure(_), Ending::Success) => 1,
            _ => continue,
        };
        if left[direction] == 0 {
            continue;
        }
        left[direction] -= 1;
        let table = &pairs.first.table;
        let index = table.index[at.0];
        found.push(Flip {
            index,
            first: pairs.first.table.outcome_name(one).to_owned(),
            second: pairs.second.table.outcome_name(two).to_owned(),
            parameters: table.parameters.iter().map(|p| (p.name.clone(), p.show(p.values[at.0]))).collect(),
            replay: [pairs.first, pairs.second].into_iter().filter_map(|dataset| dataset.replay(index)).collect(),
        });
    }
    found
}
