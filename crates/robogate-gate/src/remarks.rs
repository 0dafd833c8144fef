//! What the rows themselves say about the evidence: copies of episodes, and actions outside of their range.

use std::collections::{BTreeMap, BTreeSet};

use robogate_stats::format::percent;

use crate::{Evaluation, Trial, WarnerEffect};

/// The measure of an environment with policies: the share of the control periods with an action outside of its range.
pub const CLIPPED_ACTIONS: &str = "clipped_actions";
/// The share of control periods from which on a verdict names such actions.
const MANY_CLIPPED: f64 = 0.05;

impl Evaluation {
    /// What a reader of the verdict must know about the episodes: changed settings, a warner, other conditions of a compared policy, the rate with
    /// nothing varied, and actions outside of their range.
    pub fn remarks(&self) -> Vec<String> {
        let many = self.clipped_actions.filter(|share| *share >= MANY_CLIPPED);
        let clipped = many.map(|share| {
            format!(
                "Actions: in {} of the control periods, an action of the policy was outside of its range and was clipped. Check the units \
                 and the normalisation of its actions",
                percent(share)
            )
        });
        let settings = match self.changed_settings.as_slice() {
            [] => None,
            changed => Some(format!("Settings of the task that were changed: {}", changed.join(", "))),
        };
        let differs = self.comparison.iter().flat_map(|comparison| &comparison.differs);
        let differs = differs.map(|what| format!("The compared policies also differ in this: {what}"));
        let warner = self.warner.iter().flat_map(WarnerEffect::lines);
        let nominal = self.nominal.map(|nominal| nominal.line());
        settings.into_iter().chain(warner).chain(differs).chain(nominal).chain(clipped).collect()
    }
}

/// The mean of the measure [`CLIPPED_ACTIONS`] over the valid episodes.
pub(crate) fn clipped_actions<'a>(trials: impl Iterator<Item = &'a Trial>) -> Option<f64> {
    let valid = trials.filter(|trial| trial.ending.is_valid());
    let shares: Vec<f64> = valid.filter_map(|trial| trial.measures.get(CLIPPED_ACTIONS)).collect();
    (!shares.is_empty()).then(|| shares.iter().sum::<f64>() / shares.len() as f64)
}

/// The number of distinct trajectories among the valid episodes. `None` if a trajectory was not recorded.
///
/// Episodes with equal observations and different results, such as those of a part whose friction cannot be seen, are not copies.
pub(crate) fn distinct_trajectories<'a>(trials: impl Iterator<Item = &'a Trial>) -> Option<u64> {
    let bits = |trial: &'a Trial| trial.measures.iter().map(|(name, value)| (name, value.to_bits()));
    // The first trial of each trajectory, the number of its trials, and whether their results differ.
    let mut trajectories: BTreeMap<u64, (&Trial, u64, bool)> = BTreeMap::new();
    for trial in trials.filter(|trial| trial.ending.is_valid()) {
        let (first, count, differ) = trajectories.entry(trial.trajectory?).or_insert((trial, 0, false));
        *count += 1;
        *differ |= trial.ending != first.ending || !bits(trial).eq(bits(first));
    }
    let distinct = trajectories.values().map(|(_, count, differ)| if *differ { *count } else { 1 }).sum();
    Some(distinct).filter(|distinct| *distinct > 0)
}

/// Why most trajectories are copies of others, so that the episodes are not evidence. `None` if enough are distinct.
///
/// Rounds of a suite may repeat the trajectory of a scenario. Different scenarios with one trajectory, and different seeds
/// of the only scenario, show that neither parameters nor seeds act. A few can be equal by chance.
pub(crate) fn copies<'a>(trials: impl Iterator<Item = &'a Trial>, distinct: Option<u64>) -> Option<String> {
    const FEW: usize = 10;
    let distinct = distinct?;
    let valid: Vec<&Trial> = trials.filter(|trial| trial.ending.is_valid()).collect();
    // There are at most as many starts as episodes.
    if 2 * distinct > valid.len() as u64 {
        return None;
    }
    let scenarios: BTreeSet<String> =
        valid.iter().map(|trial| format!("{:?} {:?}", trial.label, trial.requested)).collect();
    let (starts, what) = match scenarios.len() {
        1 => (valid.len(), "episodes with different seeds"),
        n => (n, "scenarios"),
    };
    (starts >= FEW && 2 * distinct <= starts as u64).then(|| {
        format!(
            "{starts} {what} have only {distinct} distinct trajectories: seeds and parameters have no effect in the others, \
             and copies are not new evidence. Let the reset of the environment depend on its seed, or vary more"
        )
    })
}
