//! The last cycles of a recipe as symbols, from which the start of a change is estimated.

use serde::{Deserialize, Deserializer, Serialize};

use crate::cycle::Cycle;
use crate::domain::Judged;
use crate::events::MOST_EVENTS;
use crate::factors;
use crate::metric::Metric;

/// The code of a missing value.
pub(crate) const ABSENT: u8 = u8::MAX;

/// Number of codes besides events.
const FIXED: usize = 5;

/// Reads codes. A store of an earlier version has fewer.
fn codes<'de, D: Deserializer<'de>>(deserializer: D) -> Result<[u8; FIXED + MOST_EVENTS], D::Error> {
    let stored = Vec::<u8>::deserialize(deserializer)?;
    let mut codes = [ABSENT; FIXED + MOST_EVENTS];
    codes.iter_mut().zip(stored).for_each(|(code, stored)| *code = stored);
    Ok(codes)
}

/// One cycle as symbols.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub(crate) struct Symbols {
    /// Time on the sender's clock, in seconds.
    pub(crate) time_s: f64,
    /// Cycle time of a successful cycle, in seconds. Negative if there is none.
    pub(crate) cycle_time_s: f32,
    /// Codes of: failure, bin of the cycle time, failure mode, outside, step of the risk, events.
    #[serde(deserialize_with = "codes")]
    pub(crate) codes: [u8; FIXED + MOST_EVENTS],
    /// The robot's index in its recipe.
    pub(crate) robot: u16,
}

impl Symbols {
    /// The symbols of a cycle with the monitored events: `mode` is the code of its failure mode, and `bin` returns the bin
    /// of a cycle time.
    pub(crate) fn of<'a>(
        cycle: &Cycle,
        events: impl Iterator<Item = &'a String>,
        robot: u16,
        judged: Judged,
        mode: Option<u8>,
        bin: impl Fn(f64) -> u8,
    ) -> Self {
        let flag = |flag: Option<bool>| flag.map_or(ABSENT, u8::from);
        let cycle_time = cycle.cycle_time_s.filter(|_| cycle.success);
        let fixed: [u8; FIXED] = [
            u8::from(!cycle.success),
            cycle_time.map_or(ABSENT, bin),
            mode.unwrap_or(ABSENT),
            flag(judged.outside),
            judged.risk.map_or(ABSENT, factors::risk_step),
        ];
        let events = events.map(|event| flag(cycle.events.get(event).copied()));
        let mut codes = [ABSENT; FIXED + MOST_EVENTS];
        codes.iter_mut().zip(fixed.into_iter().chain(events)).for_each(|(slot, code)| *slot = code);
        Self { time_s: cycle.time_s, cycle_time_s: cycle_time.map_or(-1.0, |t| t as f32), codes, robot }
    }

    /// The symbol of a metric's detector. `None` if the metric was not reported.
    pub(crate) fn code(&self, metric: Metric) -> Option<u8> {
        let [failed, bin, mode, outside, risk, events @ ..] = self.codes;
        let code = match metric {
            Metric::Success | Metric::Robot => failed,
            Metric::Event(event) => events.get(usize::from(event)).copied().unwrap_or(ABSENT),
            Metric::CycleTime | Metric::CycleTimeSpread => bin,
            Metric::FailureModes => mode,
            Metric::Outside => outside,
            Metric::Risk => risk,
        };
        (code != ABSENT).then_some(code)
    }
}

/// The last cycles, in a ring buffer of fixed capacity.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) struct History {
    capacity: usize,
    next: usize,
    ring: Vec<Symbols>,
}

impl History {
    /// Creates an empty buffer. All memory is allocated here.
    pub(crate) fn new(capacity: usize) -> Self {
        Self { capacity: capacity.max(1), next: 0, ring: Vec::with_capacity(capacity.max(1)) }
    }

    /// Whether the stored buffer is consistent and has this capacity.
    pub(crate) fn fits(&self, capacity: usize) -> bool {
        let whole = self.ring.len() == self.capacity || self.next == self.ring.len();
        self.capacity == capacity.max(1) && self.ring.len() <= self.capacity && self.next < self.capacity && whole
    }

    /// Adds a cycle, replacing the oldest one if the buffer is full.
    pub(crate) fn push(&mut self, symbols: Symbols) {
        if self.ring.len() < self.capacity {
            self.ring.push(symbols);
        } else if let Some(oldest) = self.ring.get_mut(self.next) {
            *oldest = symbols;
        }
        self.next = (self.next + 1) % self.capacity;
    }

    /// The cycles, newest first.
    pub(crate) fn newest_first(&self) -> impl Iterator<Item = &Symbols> {
        let (newer, older) = self.ring.split_at(self.next.min(self.ring.len()));
        newer.iter().rev().chain(older.iter().rev())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn newest_cycles_are_kept_in_order() {
        let mut history = History::new(3);
        let at = |time_s| Symbols { time_s, cycle_time_s: -1.0, codes: [0; FIXED + MOST_EVENTS], robot: 0 };
        for i in 0..8 {
            history.push(at(f64::from(i)));
            let times: Vec<f64> = history.newest_first().map(|s| s.time_s).collect();
            let expected: Vec<f64> = (0..=i).rev().take(3).map(f64::from).collect();
            assert_eq!(times, expected);
        }
    }
}
