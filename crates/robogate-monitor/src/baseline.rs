//! The normal behaviour of a recipe, as counts. Unlike rates, counts allow confidence intervals.

use std::collections::BTreeMap;

use robogate_stats::{Confidence, Trials, clopper_pearson};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::cycle::{LONGEST_NAME, is_name};
use crate::detector::Factors;
use crate::events;
use crate::factors::{self, Binned};
use crate::metric::Metric;
use crate::modes::{MOST_MODES, ModeCounts, ModeList, OTHER_MODE};
use crate::settings::Settings;

/// Number of bins of the cycle time.
const BINS: usize = 20;
const LEARNING: &str = "its baseline is still being learnt";
const ROOM: &str = "the baseline has too few cycles, or too many failures, to detect a change";

/// The normal behaviour of a recipe, as counts from a gate's run or from earlier cycles.
///
/// Missing parts are learnt from the recipe's first cycles.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(try_from = "Written", default)]
#[schemars(!try_from, deny_unknown_fields)]
pub struct Baseline {
    /// Successes among cycles.
    pub success: Option<Count>,
    /// Cycles with each event, among all cycles that report it.
    pub events: BTreeMap<String, Count>,
    /// Failures by mode.
    #[schemars(with = "Option<std::collections::BTreeMap<String, u64>>")]
    pub failure_modes: Option<ModeCounts>,
    /// Cycle times of successful cycles, in seconds, in any order.
    pub cycle_times_s: Option<Vec<f64>>,
}

/// A baseline as it is read: with events, or with the fields that the first baselines had for two of them.
#[derive(Default, Deserialize)]
#[serde(deny_unknown_fields, default)]
struct Written {
    success: Option<Count>,
    events: BTreeMap<String, Count>,
    drop: Option<Count>,
    collision: Option<Count>,
    failure_modes: Option<ModeCounts>,
    cycle_times_s: Option<Vec<f64>>,
}

impl TryFrom<Written> for Baseline {
    type Error = String;

    fn try_from(written: Written) -> Result<Self, String> {
        let Written { success, mut events, drop, collision, failure_modes, cycle_times_s } = written;
        events::merge(&mut events, [drop, collision])
            .map_err(|name| format!("baseline of `{name}`: given twice, as a field and in `events`"))?;
        Ok(Self { success, events, failure_modes, cycle_times_s })
    }
}

/// A number of events among a number of cycles.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Count {
    /// Number of events.
    pub count: u64,
    /// Number of cycles.
    pub of: u64,
}

impl Count {
    /// The count as trials. `None` if it exceeds the number of cycles.
    pub fn trials(self) -> Option<Trials> {
        Trials::new(self.count, self.of).ok()
    }
}

/// An error in a baseline.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum BaselineError {
    /// A count that exceeds its cycles, or zero cycles.
    #[error(
        "baseline of `{metric}`: {count} of {of} is not a valid count. Expected `count` from 0 to `of`, and `of` above 0"
    )]
    Count {
        /// The metric.
        metric: String,
        /// The given number of events.
        count: u64,
        /// The given number of cycles.
        of: u64,
    },
    /// A failure mode that is not a name.
    #[error("baseline: the failure mode `{0}` must have 1 to {LONGEST_NAME} bytes and no control characters")]
    Mode(String),
    /// Too many failure modes.
    #[error("baseline: {0} failure modes. Expected at most {MOST_MODES}")]
    Modes(usize),
    /// A negative or non-finite cycle time.
    #[error("baseline: the cycle time {0} s is not valid. Expected a finite number of at least 0")]
    CycleTime(f64),
}

impl Baseline {
    /// Checks the counts, names and times.
    ///
    /// # Errors
    /// The first problem.
    pub fn check(&self) -> Result<(), BaselineError> {
        let events = self.events.iter().map(|(name, count)| (name.as_str(), *count));
        for (metric, Count { count, of }) in self.success.map(|count| ("success", count)).into_iter().chain(events) {
            if count > of || of == 0 {
                return Err(BaselineError::Count { metric: metric.to_owned(), count, of });
            }
        }
        if let Some(counts) = &self.failure_modes {
            if let Some(mode) = counts.names().find(|mode| !is_name(mode)) {
                return Err(BaselineError::Mode(mode.to_owned()));
            }
            // One code is reserved for modes that are not in the baseline.
            let modes = counts.names().filter(|mode| *mode != OTHER_MODE).count();
            if modes >= MOST_MODES {
                return Err(BaselineError::Modes(modes));
            }
        }
        match self.cycle_times_s.iter().flatten().find(|t| !t.is_finite() || **t < 0.0) {
            Some(time) => Err(BaselineError::CycleTime(*time)),
            None => Ok(()),
        }
    }

    /// The observed success rate. `None` if it is not known yet.
    pub fn success_rate(&self) -> Option<f64> {
        self.success?.trials()?.rate()
    }

    /// The cycle times in bins. `None` if they are not known yet, too few, or all equal.
    pub fn binned(&self) -> Option<Binned> {
        Binned::of(self.cycle_times_s.as_deref()?, BINS)
    }

    /// The factors of a metric's detector, or the reason why it cannot run.
    pub fn factors(&self, metric: Metric, settings: &Settings) -> Result<Factors, &'static str> {
        self.factors_at(metric, settings, 1.0)
    }

    /// The factors, if the bound may use only a share of the error: that of one checkpoint of a learnt rate.
    pub(crate) fn factors_at(
        &self,
        metric: Metric,
        settings: &Settings,
        error_share: f64,
    ) -> Result<Factors, &'static str> {
        let alpha = settings.alpha() * error_share;
        let event = |count: Option<Count>, failures: bool| {
            let trials = count.and_then(Count::trials).ok_or(LEARNING)?;
            factors::event(bound(trials, failures, alpha)).ok_or(ROOM)
        };
        match metric {
            Metric::Success | Metric::Robot => event(self.success, true),
            Metric::Event(_) => event(settings.event(metric).and_then(|name| self.events.get(name)).copied(), false),
            Metric::CycleTime | Metric::CycleTimeSpread => {
                self.cycle_times_s.as_ref().ok_or(LEARNING)?;
                let binned = self.binned().ok_or("the baseline has too few cycle times, or all are equal")?;
                let found = if metric == Metric::CycleTime { binned.location(alpha) } else { binned.spread(alpha) };
                found.ok_or(ROOM)
            }
            Metric::FailureModes => {
                let mut modes = ModeList::default();
                modes.include(self.failure_modes.as_ref());
                self.mode_factors(&modes, settings)
            }
            Metric::Outside => {
                factors::event(settings.outside_share).ok_or("`outside_share` must be above 0 and below 1")
            }
            Metric::Risk => {
                let success = self.success.and_then(Count::trials).ok_or(LEARNING)?;
                factors::risk(bound(success, true, alpha)).ok_or(ROOM)
            }
        }
    }

    /// The factors for the mix of failure modes. The symbols are the codes of `modes`.
    pub(crate) fn mode_factors(&self, modes: &ModeList, settings: &Settings) -> Result<Factors, &'static str> {
        let counts = self.failure_modes.as_ref().ok_or(LEARNING)?;
        let (n, alpha) = (counts.total(), settings.alpha() / modes.len() as f64);
        let share = |mode: &str| Trials::new(counts.of(mode), n).map_or(1.0, |trials| bound(trials, false, alpha));
        factors::shares(&modes.names().map(share).collect::<Vec<_>>()).ok_or(ROOM)
    }
}

/// The exact upper bound, at level 1 - α, of the rate of successes or failures.
fn bound(trials: Trials, failures: bool, alpha: f64) -> f64 {
    let Ok(level) = Confidence::new(1.0 - 2.0 * alpha) else { return 1.0 };
    let interval = clopper_pearson(trials, level);
    if failures { 1.0 - interval.low } else { interval.high }
}
