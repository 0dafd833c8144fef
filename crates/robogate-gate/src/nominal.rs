//! The success rate with nothing varied, beside the one that is judged.

use robogate_stats::format::{percent, percent_range};
use robogate_stats::{Confidence, Trials, wilson};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::{Ending, Record};

/// How often the policy succeeds in the environment as its author made it.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct NominalRate {
    /// The number of valid episodes.
    pub valid: u64,
    /// The number of invalid episodes.
    pub invalid: u64,
    /// The number of successes.
    pub successes: u64,
    /// The Wilson 95 % interval of the success rate. The verdict does not use it.
    pub interval_95: [f64; 2],
}

impl NominalRate {
    /// The rate in these episodes.
    pub fn of(record: &Record) -> Self {
        let valid = record.trials.iter().filter(|trial| trial.ending.is_valid()).count() as u64;
        let successes = record.trials.iter().filter(|trial| trial.ending == Ending::Success).count() as u64;
        let interval = wilson(Trials::new(successes, valid).unwrap_or(Trials::NONE), Confidence::P95);
        let invalid = record.trials.len() as u64 - valid;
        Self { valid, invalid, successes, interval_95: [interval.low, interval.high] }
    }

    /// The rate in a sentence.
    pub fn line(&self) -> String {
        let invalid = if self.invalid > 0 { format!("; {} invalid", self.invalid) } else { String::new() };
        if self.valid == 0 {
            return format!("With nothing varied: no valid episode{invalid}.");
        }
        format!(
            "With nothing varied, success is {} ({} of {} episodes, 95 % interval {}{invalid}).",
            percent(self.successes as f64 / self.valid as f64),
            self.successes,
            self.valid,
            percent_range(self.interval_95)
        )
    }
}
