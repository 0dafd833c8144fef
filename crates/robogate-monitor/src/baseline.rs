//! The normal behaviour of a recipe, as counts. Unlike rates, counts allow confidence intervals.

use std::collections::BTreeMap;
use std::f64::consts::SQRT_2;

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
/// The error at which the margin of a distribution of cycle times, √(ln(2/α) / 2n), is zero.
const NO_MARGIN: f64 = 2.0;
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

    /// The count of as many fewer cycles, at the same rate.
    fn divided(self, by: f64) -> Self {
        if by <= 1.0 {
            return self;
        }
        let of = ((self.of as f64 / by) as u64).max(1);
        Self { count: ((self.count as f64 / by).round() as u64).min(of), of }
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
        self.factors_at(metric, settings, 1.0, 1.0)
    }

    /// The factors, if the bound may use only a share of the error: that of one checkpoint of a learnt rate. If cycles depend on
    /// each other, the baseline counts as many fewer as their `inflation`, and evidence is divided by it.
    pub(crate) fn factors_at(
        &self,
        metric: Metric,
        settings: &Settings,
        error_share: f64,
        inflation: f64,
    ) -> Result<Factors, &'static str> {
        let alpha = settings.alpha() * error_share;
        let event = |count: Option<Count>, failures: bool| {
            let trials = count.and_then(|count| count.divided(inflation).trials()).ok_or(LEARNING)?;
            factors::event(bound(trials, failures, alpha)).ok_or(ROOM)
        };
        match metric {
            Metric::Success | Metric::Robot => event(self.success, true),
            Metric::Event(_) => event(settings.event(metric).and_then(|name| self.events.get(name)).copied(), false),
            Metric::CycleTime | Metric::CycleTimeSpread => {
                self.cycle_times_s.as_ref().ok_or(LEARNING)?;
                let mut binned = self.binned().ok_or("the baseline has too few cycle times, or all are equal")?;
                binned.n = ((binned.n as f64 / inflation) as usize).max(1);
                let found = if metric == Metric::CycleTime { binned.location(alpha) } else { binned.spread(alpha) };
                found.ok_or(ROOM)
            }
            Metric::FailureModes => {
                let mut modes = ModeList::default();
                modes.include(self.failure_modes.as_ref());
                self.mode_factors(&modes, settings, false)
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
    ///
    /// `learnt`: the counted failures determined the list. Otherwise it was chosen before.
    pub(crate) fn mode_factors(
        &self,
        modes: &ModeList,
        settings: &Settings,
        learnt: bool,
    ) -> Result<Factors, &'static str> {
        let alpha = settings.alpha() / modes.len() as f64;
        let bounds = self.mode_bounds(modes, alpha, learnt).ok_or(LEARNING)?;
        factors::shares(&bounds).ok_or(ROOM)
    }

    /// The factors with the estimated rates of the baseline in place of their bounds, to find the start of a change.
    ///
    /// They do not bound false alarms. `None` for a metric whose rate is not estimated from the baseline.
    pub(crate) fn estimated_factors(&self, metric: Metric, modes: &ModeList, settings: &Settings) -> Option<Factors> {
        let failures = || self.success?.trials().map(|trials| estimate(trials.failures(), trials.n()));
        match metric {
            Metric::Success | Metric::Robot => factors::event(failures()?),
            Metric::Event(_) => {
                let Count { count, of } = *self.events.get(settings.event(metric)?)?;
                factors::event(estimate(count, of))
            }
            Metric::CycleTime => self.binned()?.location(NO_MARGIN),
            Metric::CycleTimeSpread => self.binned()?.spread(NO_MARGIN),
            Metric::FailureModes => {
                let counts = self.failure_modes.as_ref()?;
                let share = |mode: &str| estimate(counts.of(mode), counts.total());
                factors::shares(&modes.names().map(share).collect::<Vec<_>>())
            }
            Metric::Risk => factors::risk(failures()?),
            Metric::Outside => None,
        }
    }

    /// The upper bound of each mode's share of the failures, each at level 1 - α.
    fn mode_bounds(&self, modes: &ModeList, alpha: f64, learnt: bool) -> Option<Vec<f64>> {
        let counts = self.failure_modes.as_ref()?;
        let share = |mode: &str| {
            let trials = Trials::new(counts.of(mode), counts.total());
            let exact = trials.map_or(1.0, |trials| bound(trials, false, alpha));
            if learnt && mode == OTHER_MODE { exact.max(unlisted_bound(counts, alpha)) } else { exact }
        };
        Some(modes.names().map(share).collect())
    }
}

/// The upper bound, at level 1 - α, of the share of failures whose mode is not in the list, if the list contains the
/// modes that happened among the counted failures.
///
/// The modes that did not happen are not a fixed event with a count of 0: the counts themselves selected them. The
/// Good-Turing estimate of their share is N1 / n, with N1 the number of modes that happened once. The margin
/// (1 + √2) √(ln(3/α) / n) contains the deviations of this estimate and of the share from their means. Failures that
/// are already counted as `other` are taken as modes that happened once, because they are not in the list either.
/// Sources: Good (1953), Biometrika 40; McAllester and Schapire (2000), "On the convergence rate of Good-Turing
/// estimators", COLT; McAllester and Ortiz (2003), JMLR 4.
fn unlisted_bound(counts: &ModeCounts, alpha: f64) -> f64 {
    let n = counts.total() as f64;
    let once = counts.names().filter(|mode| *mode != OTHER_MODE && counts.of(mode) == 1).count() as f64;
    let estimate = (once + counts.of(OTHER_MODE) as f64) / n;
    (estimate + (1.0 + SQRT_2) * ((3.0 / alpha).ln() / n).sqrt()).min(1.0)
}

/// The estimated rate of k events among n, which lies strictly between 0 and 1.
fn estimate(k: u64, n: u64) -> f64 {
    (k as f64 + 0.5) / (n as f64 + 1.0)
}

/// The exact upper bound, at level 1 - α, of the rate of successes or failures.
fn bound(trials: Trials, failures: bool, alpha: f64) -> f64 {
    let Ok(level) = Confidence::new(1.0 - 2.0 * alpha) else { return 1.0 };
    let interval = clopper_pearson(trials, level);
    if failures { 1.0 - interval.low } else { interval.high }
}

#[cfg(test)]
mod tests {
    use robogate_core::Seed;

    use super::*;

    /// Sixty rare modes have 30 % of the failures. After 100 failures about half of them have not happened yet.
    #[test]
    fn bound_contains_unseen_modes() {
        const RARE: usize = 60;
        for i in 0..50 {
            let mut stream = Seed::campaign(41).episode(i).stream("rare modes");
            let mut list = ModeList::default();
            let mut counts: BTreeMap<String, u64> = BTreeMap::new();
            for _ in 0..100 {
                let rare = stream.uniform() < 0.3;
                let mode = if rare { format!("rare-{}", stream.below(RARE)) } else { "jammed".to_owned() };
                list.add(&mode);
                *counts.entry(list.name(list.code(&mode)).to_owned()).or_insert(0) += 1;
            }
            let other = usize::from(list.code(OTHER_MODE));
            let unlisted = (0..RARE).filter(|k| usize::from(list.code(&format!("rare-{k}"))) == other).count();
            let truth = 0.3 * unlisted as f64 / RARE as f64;
            let baseline = Baseline { failure_modes: Some(counts.into_iter().collect()), ..Baseline::default() };
            let of = |learnt: bool| baseline.mode_bounds(&list, 0.001, learnt).unwrap();
            assert!(of(false)[other] < truth, "a fixed event that did not happen would have a lower share");
            assert!(truth <= of(true)[other], "stream {i}: {truth} {:?}", of(true));
            assert_eq!(of(true)[other + 1..], of(false)[other + 1..], "only the bound of `other` differs");
        }
    }

    #[test]
    fn unlisted_share_has_a_good_turing_bound() {
        let counts = |once: usize, other: u64| -> ModeCounts {
            let singles = (0..once).map(|k| (format!("rare-{k}"), 1));
            let rest = 10_000 - once as u64 - other;
            singles.chain([("jammed".to_owned(), rest), (OTHER_MODE.to_owned(), other)]).collect()
        };
        // ln(3 / 0.003) = 6.907755; (1 + √2) √(6.907755 / 10,000) = 0.063452.
        let margin = 0.063_452;
        for (once, other, estimate) in [(0, 0, 0.0), (20, 0, 0.002), (20, 500, 0.052)] {
            let found = unlisted_bound(&counts(once, other), 0.003);
            assert!((found - estimate - margin).abs() < 1e-6, "{once} {other}: {found}");
        }
        assert_eq!(unlisted_bound(&[(OTHER_MODE, 100)].into_iter().collect(), 0.003), 1.0);
    }
}
