//! Learns the missing parts of a recipe's baseline from its first cycles, and tightens its rates as more cycles follow.
//!
//! A rate is learnt from the first `learn_cycles` cycles, and again from all cycles so far each time their number has
//! doubled. Every checkpoint has its own share of the error of the confidence bound ([`Learning::error_share`]), so all
//! bounds hold together with the configured confidence. A checkpoint is left out if its detector has evidence for a
//! change, because the newest cycles may already be changed ones.

use serde::{Deserialize, Serialize};

use crate::baseline::{Baseline, Count};
use crate::history::Symbols;
use crate::metric::Metric;
use crate::modes::ModeList;
use crate::settings::Settings;

/// Counts for the parts of the baseline that are not complete.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub(crate) struct Learning {
    successes: Tally,
    /// By the index of the event.
    #[serde(default)]
    pub(crate) events: Vec<Tally>,
    /// Failures by the code of their mode.
    modes: Vec<u64>,
    cycle_times_s: Vec<f64>,
}

#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub(crate) struct Tally {
    count: u64,
    of: u64,
    /// Number of checkpoints that were reached.
    #[serde(default)]
    checkpoints: u8,
}

/// Number of checkpoints of a learnt rate. The last one is at 2^8 times `learn_cycles`.
const CHECKPOINTS: u8 = 9;

/// Share of the error that the first checkpoint has. The others have equal parts of the rest.
const FIRST_SHARE: f64 = 0.5;

impl Tally {
    /// Adds one cycle. At a checkpoint, returns all cycles so far.
    fn add(&mut self, happened: bool, enough: u64) -> Option<Count> {
        self.count += u64::from(happened);
        self.of += 1;
        let due = self.checkpoints < CHECKPOINTS && self.of >= enough << self.checkpoints;
        self.checkpoints += u8::from(due);
        due.then_some(Count { count: self.count, of: self.of })
    }

    fn error_share(self) -> f64 {
        match self.checkpoints {
            0 => 1.0,
            1 => FIRST_SHARE,
            _ => (1.0 - FIRST_SHARE) / f64::from(CHECKPOINTS - 1),
        }
    }
}

impl Learning {
    /// The share of the error of a bound that the current value of a metric's rate may use. 1 for a given baseline.
    pub(crate) fn error_share(&self, metric: Metric) -> f64 {
        match metric {
            Metric::Success | Metric::Robot | Metric::Risk => self.successes.error_share(),
            Metric::Event(event) => self.events.get(usize::from(event)).map_or(1.0, |tally| tally.error_share()),
            Metric::CycleTime | Metric::CycleTimeSpread | Metric::FailureModes | Metric::Outside => 1.0,
        }
    }

    /// Whether this rate was learnt at least once.
    pub(crate) fn has_learnt_success(&self) -> bool {
        self.successes.checkpoints > 0
    }

    /// Adds one cycle. Calls `learnt` for each metric whose part of the baseline has become complete or was tightened.
    /// `quiet` tells whether a metric's detector has no evidence for a change.
    pub(crate) fn update(
        &mut self,
        symbols: &Symbols,
        baseline: &mut Baseline,
        modes: &ModeList,
        settings: &Settings,
        quiet: impl Fn(Metric) -> bool,
        mut learnt: impl FnMut(Metric),
    ) {
        let enough = u64::from(settings.learn_cycles);
        // A rate from the settings is never replaced.
        if let Some(failed) = symbols.code(Metric::Success)
            && (baseline.success.is_none() || self.successes.checkpoints > 0)
            && let Some(count) = self.successes.add(failed == 0, enough)
            && (baseline.success.is_none() || quiet(Metric::Success))
        {
            baseline.success = Some(count);
            learnt(Metric::Success);
        }
        for ((i, event), tally) in (0..).zip(settings.events.keys()).zip(&mut self.events) {
            let (metric, known) = (Metric::Event(i), baseline.events.get_mut(event));
            if let Some(happened) = symbols.code(metric)
                && (known.is_none() || tally.checkpoints > 0)
                && let Some(count) = tally.add(happened == 1, enough)
                && (known.is_none() || quiet(metric))
            {
                match known {
                    Some(known) => *known = count,
                    None => drop(baseline.events.insert(event.clone(), count)),
                }
                learnt(metric);
            }
        }
        if baseline.failure_modes.is_none()
            && let Some(mode) = symbols.code(Metric::FailureModes)
        {
            self.modes.resize(modes.len(), 0);
            if let Some(count) = self.modes.get_mut(usize::from(mode)) {
                *count += 1;
            }
            if self.modes.iter().sum::<u64>() >= u64::from(settings.learn_failures) {
                baseline.failure_modes = Some(modes.names().zip(self.modes.drain(..)).collect());
                learnt(Metric::FailureModes);
            }
        }
        if baseline.cycle_times_s.is_none() && symbols.cycle_time_s >= 0.0 {
            self.cycle_times_s.reserve(if self.cycle_times_s.is_empty() { settings.learn_cycles as usize } else { 0 });
            self.cycle_times_s.push(f64::from(symbols.cycle_time_s));
            if self.cycle_times_s.len() as u64 >= enough {
                baseline.cycle_times_s = Some(std::mem::take(&mut self.cycle_times_s));
                learnt(Metric::CycleTime);
                learnt(Metric::CycleTimeSpread);
            }
        }
    }
}
