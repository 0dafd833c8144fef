//! Repeats of a scenario: rows that are not independent of each other.

use std::cmp::Ordering;

use robogate_stats::Trials;

use crate::Population;
use crate::table::{ParameterColumn, ParameterKind, Sample};

/// Fewest combinations of parameters in imported results that are taken for repeated scenarios.
const FEWEST_SCENARIOS: usize = 20;

/// The scenarios of a sample: rows with the same parameter values.
pub(crate) struct Scenarios {
    /// The scenario of each row, from 0.
    pub(crate) of_row: Vec<usize>,
    /// The outcomes of each scenario.
    pub(crate) trials: Vec<Trials>,
    /// One row of each scenario.
    pub(crate) first: Vec<usize>,
}

impl Scenarios {
    /// The scenarios of a sample. `None` if none has several rows, and if rows with the same parameters are independent.
    pub(crate) fn repeated(base: &Sample, population: Population) -> Option<Self> {
        let found = may_repeat(base, population).then(|| Self::of(base))?;
        // Fewer combinations are taken for a grid of settings.
        let are_scenarios = population == Population::Suite || found.trials.len() >= FEWEST_SCENARIOS;
        (are_scenarios && found.trials.iter().any(|scenario| scenario.n() > 1)).then_some(found)
    }

    fn of(base: &Sample) -> Self {
        let mut rows: Vec<usize> = (0..base.len()).collect();
        let compare = |a: &usize, b: &usize| {
            let by = base.parameters.iter().map(|p| p.values[*a].total_cmp(&p.values[*b]));
            by.into_iter().find(|order| order.is_ne()).unwrap_or(Ordering::Equal)
        };
        rows.sort_by(compare);
        let (mut of_row, mut trials, mut first) = (vec![0; rows.len()], Vec::new(), Vec::new());
        for scenario in rows.chunk_by(|a, b| compare(a, b).is_eq()) {
            for row in scenario {
                of_row[*row] = trials.len();
            }
            trials.push(Trials::count(scenario.iter().map(|row| base.success[*row])));
            first.push(scenario[0]);
        }
        Self { of_row, trials, first }
    }
}

/// Whether rows with the same parameters may be repeats of one scenario: in suites, and in imported results with a continuous
/// parameter, whose values are not equal by chance. A sample from a space has no repeats.
fn may_repeat(base: &Sample, population: Population) -> bool {
    let continuous = |p: &ParameterColumn| matches!(p.kind, ParameterKind::Continuous { .. });
    match population {
        Population::Suite => true,
        Population::AsImported => base.parameters.iter().any(continuous),
        _ => false,
    }
}
