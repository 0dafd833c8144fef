//! Learns the missing parts of a recipe's baseline from its first cycles.

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
}

impl Tally {
    fn add(&mut self, happened: bool, enough: u64) -> Option<Count> {
        self.count += u64::from(happened);
        self.of += 1;
        (self.of >= enough).then_some(Count { count: self.count, of: self.of })
    }
}

impl Learning {
    /// Adds one cycle. Calls `learnt` for each metric whose part of the baseline has become complete.
    pub(crate) fn update(
        &mut self,
        symbols: &Symbols,
        baseline: &mut Baseline,
        modes: &ModeList,
        settings: &Settings,
        mut learnt: impl FnMut(Metric),
    ) {
        let enough = u64::from(settings.learn_cycles);
        if baseline.success.is_none()
            && let Some(failed) = symbols.code(Metric::Success)
        {
            baseline.success = self.successes.add(failed == 0, enough);
            if baseline.success.is_some() {
                learnt(Metric::Success);
            }
        }
        for ((i, event), tally) in (0..).zip(settings.events.keys()).zip(&mut self.events) {
            if !baseline.events.contains_key(event)
                && let Some(happened) = symbols.code(Metric::Event(i))
                && let Some(count) = tally.add(happened == 1, enough)
            {
                baseline.events.insert(event.clone(), count);
                learnt(Metric::Event(i));
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
