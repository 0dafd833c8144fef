//! Complete rounds of a suite. A sequential test is evaluated at the end of each.

use std::collections::BTreeMap;

use crate::{GateError, Population, Trial};

/// The trials that are judged, in rounds.
#[derive(Debug)]
pub(crate) struct Rounds<'a> {
    pub(crate) rounds: Vec<Vec<&'a Trial>>,
    /// Trials after the last complete round.
    pub(crate) left_over: u64,
    /// Whether the rounds are those of a suite. Without a suite, all trials are one round.
    pub(crate) suite: bool,
}

impl<'a> Rounds<'a> {
    /// Splits `trials` into rounds: the first run of each scenario, the second of each, and so on.
    pub(crate) fn of(trials: &'a [Trial], population: &Population) -> Result<Self, GateError> {
        let Population::Suite { cases, .. } = population else {
            // The rows may be sorted by outcome. The result must not depend on where the test is evaluated, so it is
            // evaluated once, at the end.
            let rounds = if trials.is_empty() { Vec::new() } else { vec![trials.iter().collect()] };
            return Ok(Self { rounds, left_over: 0, suite: false });
        };
        let mut seen: BTreeMap<&str, usize> = BTreeMap::new();
        let mut rounds: Vec<Vec<&Trial>> = Vec::new();
        for trial in trials {
            let Some(case) = &trial.label.case else { return Err(GateError::MixedLabels { index: trial.index }) };
            let times = seen.entry(case).or_insert(0);
            if rounds.len() == *times {
                rounds.push(Vec::new());
            }
            if let Some(round) = rounds.get_mut(*times) {
                round.push(trial);
            }
            *times += 1;
        }
        let whole = rounds.iter().take_while(|round| round.len() as u64 == *cases).count();
        let left_over = rounds.drain(whole..).map(|round| round.len() as u64).sum();
        Ok(Self { rounds, left_over, suite: true })
    }

    pub(crate) fn trials(&self) -> impl Iterator<Item = &'a Trial> {
        self.rounds.iter().flatten().copied()
    }
}
