//! Alarms: the change, its severity and its start.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// The severity of an alarm.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Level {
    /// Investigate soon.
    Warning,
    /// Investigate now.
    Critical,
}

impl Level {
    /// Both levels, the less severe first.
    pub const ALL: [Self; 2] = [Self::Warning, Self::Critical];

    /// The level in data and messages.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Warning => "warning",
            Self::Critical => "critical",
        }
    }
}

/// Whether an alarm was raised or cleared.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Happening {
    /// The alarm was raised and is active.
    Raised,
    /// The alarm is no longer active: there was no further evidence for a sufficient number of cycles.
    Cleared,
}

/// A raised or cleared alarm: one JSON object.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Alarm {
    /// The identifier of this change of an alarm. The same cycles give the same id.
    pub id: String,
    /// Whether the alarm was raised or cleared.
    pub happening: Happening,
    /// The severity.
    pub level: Level,
    /// The recipe.
    pub recipe: String,
    /// The metric that changed: `success`, `event:NAME`, `cycle_time`, `cycle_time_spread`, `failure_modes`, `outside`,
    /// `risk` or `robot`.
    pub metric: String,
    /// The cycle at which this happened, numbered within its recipe from 1.
    pub cycle: u64,
    /// The id of that cycle.
    pub cycle_id: String,
    /// The robot of that cycle.
    pub robot: String,
    /// The time of that cycle on the sender's clock, in seconds since 1970-01-01 UTC.
    pub time_s: f64,
    /// The change, in one sentence.
    pub what: String,
    /// The statistical guarantee, in one sentence.
    pub how_sure: String,
    /// The start of the change. `None` for a cleared alarm.
    pub since: Option<Since>,
    /// Likely causes, the most likely first.
    pub look_at: Vec<String>,
}

/// The start of a change, in cycles of the recipe that report the metric.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Since {
    /// The most likely first cycle of the change, numbered within the recipe.
    pub cycle: u64,
    /// Its time, in seconds since 1970-01-01 UTC.
    pub time_s: f64,
    /// 95 % interval of the first cycle. It contains the intervals that take the bound and the estimate of the baseline
    /// as the rate before.
    pub cycles_95: [u64; 2],
    /// Times at the ends of that interval.
    pub times_95_s: [f64; 2],
    /// Whether the interval reaches the oldest stored cycle. The change may then have started earlier.
    pub or_before: bool,
}
