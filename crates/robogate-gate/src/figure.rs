//! The value of a metric over a set of trials, with bounds for its invalid episodes.

use robogate_core::Word;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::production;
use crate::{Bound, Ending, Metric, Sense, Trial};

/// A figure over the valid episodes, with the bounds that the invalid episodes allow.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Extremes {
    /// The figure. `None` if no episode has a value for it.
    pub observed: Option<f64>,
    /// The smallest value that the figure could have for any outcome of the invalid episodes. `None` if unbounded.
    pub least: Option<f64>,
    /// The largest value that the figure could have. `None` if unbounded.
    pub most: Option<f64>,
}

/// The share of the way to success as a measure of a trial ([`crate::Record::with_stages`]).
pub(crate) const STAGE_SHARE: Word = Word::constant("stage_share");

/// Whether the event of a metric happened in one trial. `None` if the trial does not record it.
pub(crate) fn happened(metric: Metric, bound: Bound, trial: &Trial) -> Option<bool> {
    let mode = match metric {
        Metric::Success => return trial.ending.is_valid().then_some(trial.ending == Ending::Success),
        Metric::Failure(mode) | Metric::FailureCount(mode) => mode,
        Metric::RealSuccess | Metric::Production(_) | Metric::Stage => return None,
        Metric::ForceLimit(name) => return trial.exceeds(name).filter(|_| trial.ending.is_valid()),
        Metric::TimeToSuccess(_) => {
            let late = |time: f64| trial.ending != Ending::Success || !bound.holds(time);
            return trial.time_s.filter(|_| trial.ending.is_valid()).map(late);
        }
        // The event of a quantile: the value lies beyond the limit.
        Metric::CycleTime(_) | Metric::Measure(..) => return value(metric, trial).map(|x| !bound.holds(x)),
    };
    match &trial.ending {
        Ending::Failure(Some(found)) if *found == mode => Some(true),
        // A source that does not detect collisions records none.
        _ if trial.unseen.contains(&mode) => None,
        Ending::Success | Ending::Failure(Some(_)) => Some(false),
        // The failure mode is unknown, so it may have been this one.
        Ending::Failure(None) | Ending::Invalid(_) => None,
    }
}

/// Whether a metric applies to a trial. A failure has no cycle time: a timeout lasts as long as its limit allows, and a drop ends
/// early. Invalid episodes could have been successes.
pub(crate) fn applies(metric: Metric, trial: &Trial) -> bool {
    !matches!((metric, &trial.ending), (Metric::CycleTime(_), Ending::Failure(_)))
}

/// The duration or measure of a valid trial. `None` if it has none.
pub(crate) fn value(metric: Metric, trial: &Trial) -> Option<f64> {
    let value = match metric {
        Metric::CycleTime(_) => trial.time_s,
        Metric::Measure(name, _) => trial.measures.get(name.as_str()).filter(|x| x.is_finite()),
        Metric::Stage => trial.measures.get(STAGE_SHARE.as_str()),
        Metric::Success
        | Metric::RealSuccess
        | Metric::Failure(_)
        | Metric::FailureCount(_)
        | Metric::ForceLimit(_)
        | Metric::TimeToSuccess(_)
        | Metric::Production(_) => None,
    };
    value.filter(|_| trial.ending.is_valid())
}

/// Counts how often an event happened.
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

/// The value of a metric over some trials: the number of trials with and without a value, and the figure. Its values
/// lie in `range`, as far as that is known.
pub(crate) fn figure<'a>(
    metric: Metric,
    trials: impl Iterator<Item = &'a Trial>,
    range: [Option<f64>; 2],
) -> (u64, u64, Extremes) {
    match metric {
        Metric::Production(figure) => return production::figure(figure, &trials.collect::<Vec<_>>(), range[1]),
        Metric::TimeToSuccess(q) => {
            return production::time_to_success(f64::from(q) / 1000.0, &trials.collect::<Vec<_>>());
        }
        _ => {}
    }
    if let Some(q) = metric.quantile() {
        return quantile(metric, q, trials);
    }
    if metric.is_mean() {
        return mean(metric, trials, range);
    }
    let mut tally = Tally::default();
    // The limit does not affect this event.
    let bound = Bound { sense: Sense::AtMost, limit: 0.0 };
    trials.for_each(|trial| tally.add(happened(metric, bound, trial)));
    let Tally { yes, no, unknown } = tally;
    let known = yes + no;
    let (yes, all) = (yes as f64, tally.n() as f64);
    let figure = if let Metric::FailureCount(_) = metric {
        Extremes { observed: (known > 0).then_some(yes), least: Some(yes), most: Some(yes + unknown as f64) }
    } else if all > 0.0 {
        Extremes {
            observed: (known > 0).then(|| yes / known as f64),
            least: Some(yes / all),
            most: Some((yes + unknown as f64) / all),
        }
    } else {
        Extremes { observed: None, least: Some(0.0), most: Some(1.0) }
    };
    (known, unknown, figure)
}

fn mean<'a>(
    metric: Metric,
    trials: impl Iterator<Item = &'a Trial>,
    [floor, ceiling]: [Option<f64>; 2],
) -> (u64, u64, Extremes) {
    let (mut known, mut unknown, mut sum) = (0_u64, 0_u64, 0.0);
    for trial in trials {
        match value(metric, trial) {
            Some(value) => {
                known += 1;
                sum += value;
            }
            None => unknown += 1,
        }
    }
    let all = (known + unknown) as f64;
    let end = |end: Option<f64>| if unknown == 0 { Some(0.0) } else { end.map(|end| end * unknown as f64) };
    let figure = if all > 0.0 {
        Extremes {
            observed: (known > 0).then(|| sum / known as f64),
            least: end(floor).map(|more| (sum + more) / all),
            most: end(ceiling).map(|more| (sum + more) / all),
        }
    } else {
        Extremes { observed: None, least: floor, most: ceiling }
    };
    (known, unknown, figure)
}

/// The smallest value that at least a share `q` of all values does not exceed.
fn quantile<'a>(metric: Metric, q: f64, trials: impl Iterator<Item = &'a Trial>) -> (u64, u64, Extremes) {
    let (mut values, mut unknown) = (Vec::new(), 0_usize);
    for trial in trials {
        match value(metric, trial) {
            Some(value) => values.push(value),
            None => unknown += 1,
        }
    }
    values.sort_by(f64::total_cmp);
    let all = values.len() + unknown;
    let place = |n: usize| ((q * n as f64 - 1e-9).ceil() as usize).clamp(1, n.max(1)) - 1;
    let extremes = Extremes {
        observed: values.get(place(values.len())).copied(),
        // The unknown values are placed below all others, or above them.
        least: place(all).checked_sub(unknown).and_then(|at| values.get(at)).copied(),
        most: values.get(place(all)).copied(),
    };
    (values.len() as u64, unknown as u64, extremes)
}
