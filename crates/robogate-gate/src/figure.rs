//! A metric over some trials, and what it could have been.

use robogate_core::FailureMode;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::{Ending, Metric, Trial};

/// A figure over the valid episodes, and what it could have been.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Extremes {
    /// The figure; absent without an episode that says something about it.
    pub observed: Option<f64>,
    /// The least it could be, whatever the invalid episodes could have been.
    pub least: f64,
    /// The most it could be; absent where nothing bounds it.
    pub most: Option<f64>,
}

/// What one trial says about an event: it happened, it did not, or it is not known.
pub(crate) fn happened(metric: Metric, trial: &Trial) -> Option<bool> {
    let mode = match metric {
        Metric::SuccessRate => {
            return trial.ending.is_valid().then_some(trial.ending == Ending::Success);
        }
        Metric::CycleTimeS => return None,
        Metric::CollisionRate | Metric::CollisionCount => FailureMode::Collision,
        Metric::DropRate => FailureMode::GripLoss,
        Metric::GraspMissRate => FailureMode::GraspMiss,
        Metric::TimeoutRate => FailureMode::Timeout,
    };
    match &trial.ending {
        Ending::Failure(Some(found)) if *found == mode => Some(true),
        // Who does not look for collisions sees none.
        _ if trial.unseen.contains(&mode) => None,
        Ending::Success | Ending::Failure(Some(_)) => Some(false),
        // In which way it failed is not known: it may have been this one.
        Ending::Failure(None) | Ending::Invalid(_) => None,
    }
}

/// The duration that a trial vouches for.
pub(crate) fn duration(trial: &Trial) -> Option<f64> {
    trial.time_s.filter(|_| trial.ending.is_valid())
}

/// How often an event happened.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(crate) struct Tally {
    pub(crate) yes: u64,
    pub(crate) no: u64,
    pub(crate) unknown: u64,
}

impl Tally {
    pub(crate) fn add(&mut self, happened: Option<bool>) {
        match happened {
            Some(true) => self.yes += 1,
            Some(false) => self.no += 1,
            None => self.unknown += 1,
        }
    }

    pub(crate) fn n(self) -> u64 {
        self.yes + self.no + self.unknown
    }
}

/// A metric over some trials: how many say something about it, how many do not, and the figure.
pub(crate) fn figure<'a>(
    metric: Metric,
    trials: impl Iterator<Item = &'a Trial>,
    ceiling: Option<f64>,
) -> (u64, u64, Extremes) {
    if metric == Metric::CycleTimeS {
        return mean_duration(trials, ceiling);
    }
    let mut tally = Tally::default();
    trials.for_each(|trial| tally.add(happened(metric, trial)));
    let Tally { yes, no, unknown } = tally;
    let known = yes + no;
    let (yes, all) = (yes as f64, tally.n() as f64);
    let figure = if metric == Metric::CollisionCount {
        Extremes { observed: (known > 0).then_some(yes), least: yes, most: Some(yes + unknown as f64) }
    } else if all > 0.0 {
        Extremes {
            observed: (known > 0).then(|| yes / known as f64),
            least: yes / all,
            most: Some((yes + unknown as f64) / all),
        }
    } else {
        Extremes { observed: None, least: 0.0, most: Some(1.0) }
    };
    (known, unknown, figure)
}

fn mean_duration<'a>(trials: impl Iterator<Item = &'a Trial>, ceiling: Option<f64>) -> (u64, u64, Extremes) {
    let (mut known, mut unknown, mut sum) = (0_u64, 0_u64, 0.0);
    for trial in trials {
        match duration(trial) {
            Some(time) => {
                known += 1;
                sum += time;
            }
            None => unknown += 1,
        }
    }
    let all = (known + unknown) as f64;
    let most = if unknown == 0 { Some(0.0) } else { ceiling.map(|c| c * unknown as f64) };
    let figure = if all > 0.0 {
        Extremes {
            observed: (known > 0).then(|| sum / known as f64),
            least: sum / all,
            most: most.map(|more| (sum + more) / all),
        }
    } else {
        Extremes { observed: None, least: 0.0, most: ceiling }
    };
    (known, unknown, figure)
}
