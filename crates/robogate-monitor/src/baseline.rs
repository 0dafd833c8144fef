//! What is normal: counts, never bare rates, so that the evidence behind them can be asked how sure it is.

use robogate_stats::{Confidence, Trials, clopper_pearson};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::alarm::Metric;
use crate::cycle::MODES;
use crate::detector::Factors;
use crate::factors::{self, Binned};
use crate::settings::Settings;

/// Bins of the cycle time.
const BINS: usize = 20;

/// What is normal for a recipe, as counts from the gate's evidence or from cycles before.
///
/// What is absent is learnt from the recipe's first cycles.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Baseline {
    /// Successes among cycles.
    pub success: Option<Count>,
    /// Drops among cycles.
    pub drop: Option<Count>,
    /// Collisions among cycles.
    pub collision: Option<Count>,
    /// Failures by mode: grasp_miss, grip_loss, collision, timeout, other.
    pub failure_modes: Option<[u64; MODES.len()]>,
    /// Cycle times of successful cycles, in seconds, in any order.
    pub cycle_times_s: Option<Vec<f64>>,
}

/// How often something happened, out of how many cycles.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Count {
    /// How often.
    pub count: u64,
    /// Out of how many.
    pub of: u64,
}

impl Count {
    /// As trials; `None` where the count exceeds the cycles.
    pub fn trials(self) -> Option<Trials> {
        Trials::new(self.count, self.of).ok()
    }
}

/// Why a baseline cannot be one.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum BaselineError {
    /// A count that exceeds its cycles, or no cycles.
    #[error("baseline of `{metric}`: {count} of {of} is no rate; hint: `of` counts all cycles and is above 0")]
    Count {
        /// The metric.
        metric: &'static str,
        /// As given.
        count: u64,
        /// As given.
        of: u64,
    },
    /// A cycle time that is none.
    #[error("baseline: cycle time {0} s is not a finite number from 0")]
    CycleTime(f64),
}

impl Baseline {
    /// Refuses what cannot be a baseline.
    ///
    /// # Errors
    /// The first figure that is wrong.
    pub fn check(&self) -> Result<(), BaselineError> {
        for (metric, count) in [("success", self.success), ("drop", self.drop), ("collision", self.collision)] {
            if let Some(Count { count, of }) = count
                && (count > of || of == 0)
            {
                return Err(BaselineError::Count { metric, count, of });
            }
        }
        match self.cycle_times_s.iter().flatten().find(|t| !t.is_finite() || **t < 0.0) {
            Some(time) => Err(BaselineError::CycleTime(*time)),
            None => Ok(()),
        }
    }

    /// The observed success rate; `None` while it is not known.
    pub fn success_rate(&self) -> Option<f64> {
        self.success?.trials()?.rate()
    }

    /// The cycle times in bins; `None` while they are not known, are too few or never vary.
    pub fn binned(&self) -> Option<Binned> {
        Binned::of(self.cycle_times_s.as_deref()?, BINS)
    }

    /// The factors of a metric's detector, or why there are none.
    pub fn factors(&self, metric: Metric, settings: &Settings) -> Result<Factors, &'static str> {
        let alpha = settings.alpha();
        const ROOM: &str = "the baseline is too small, or too poor, for a change to be told from it";
        let event = |count: Option<Count>, failures: bool| {
            let trials = count.and_then(Count::trials).ok_or("it is still being learnt")?;
            factors::event(bound(trials, failures, alpha)).ok_or(ROOM)
        };
        match metric {
            Metric::Success | Metric::Robot => event(self.success, true),
            Metric::Drop => event(self.drop, false),
            Metric::Collision => event(self.collision, false),
            Metric::CycleTime | Metric::CycleTimeSpread => {
                self.cycle_times_s.as_ref().ok_or("it is still being learnt")?;
                let binned = self.binned().ok_or("the cycle times of the baseline are too few, or never vary")?;
                let found = if metric == Metric::CycleTime { binned.location(alpha) } else { binned.spread(alpha) };
                found.ok_or(ROOM)
            }
            Metric::FailureModes => {
                let counts = self.failure_modes.ok_or("it is still being learnt")?;
                let n: u64 = counts.iter().sum();
                let share =
                    |count: &u64| Trials::new(*count, n).map_or(1.0, |t| bound(t, false, alpha / MODES.len() as f64));
                factors::shares(&counts.each_ref().map(share)).ok_or(ROOM)
            }
            Metric::Outside => {
                factors::event(settings.outside_share).ok_or("`outside_share` leaves no room for a change")
            }
            Metric::Risk => {
                let success = self.success.and_then(Count::trials).ok_or("it is still being learnt")?;
                factors::risk(bound(success, true, alpha)).ok_or(ROOM)
            }
        }
    }
}

/// The exact upper bound, at level 1 - α, of the rate of successes or of failures.
fn bound(trials: Trials, failures: bool, alpha: f64) -> f64 {
    let Ok(level) = Confidence::new(1.0 - 2.0 * alpha) else { return 1.0 };
    let interval = clopper_pearson(trials, level);
    if failures { 1.0 - interval.low } else { interval.high }
}
