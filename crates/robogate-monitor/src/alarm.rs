//! What the monitor says when something changed.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// How bad it is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Level {
    /// Look at it soon.
    Warning,
    /// Look at it now.
    Critical,
}

impl Level {
    /// Both, the milder first.
    pub const ALL: [Self; 2] = [Self::Warning, Self::Critical];

    /// Its word in data and messages.
    pub fn word(self) -> &'static str {
        match self {
            Self::Warning => "warning",
            Self::Critical => "critical",
        }
    }
}

/// What is watched.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Metric {
    /// The rate of failures.
    Success,
    /// The rate of drops.
    Drop,
    /// The rate of collisions.
    Collision,
    /// The location of the cycle time of successful cycles.
    CycleTime,
    /// Its spread.
    CycleTimeSpread,
    /// The shares of the failure modes among failures.
    FailureModes,
    /// The rate of cycles outside what was validated.
    Outside,
    /// The failure rate that the risk model expects.
    Risk,
    /// The rate of failures of one robot among several.
    Robot,
}

impl Metric {
    /// Every metric.
    pub const ALL: [Self; 9] = [
        Self::Success,
        Self::Drop,
        Self::Collision,
        Self::CycleTime,
        Self::CycleTimeSpread,
        Self::FailureModes,
        Self::Outside,
        Self::Risk,
        Self::Robot,
    ];

    /// Its word in data.
    pub fn word(self) -> &'static str {
        match self {
            Self::Success => "success",
            Self::Drop => "drop",
            Self::Collision => "collision",
            Self::CycleTime => "cycle_time",
            Self::CycleTimeSpread => "cycle_time_spread",
            Self::FailureModes => "failure_modes",
            Self::Outside => "outside",
            Self::Risk => "risk",
            Self::Robot => "robot",
        }
    }

    /// What it is, for people.
    pub fn label(self) -> &'static str {
        match self {
            Self::Success => "failure rate",
            Self::Drop => "drop rate",
            Self::Collision => "collision rate",
            Self::CycleTime => "cycle time",
            Self::CycleTimeSpread => "spread of the cycle time",
            Self::FailureModes => "mix of failure modes",
            Self::Outside => "cycles outside what was validated",
            Self::Risk => "expected failure rate",
            Self::Robot => "failure rate of one robot",
        }
    }
}

/// Who raised it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Rule {
    /// The moving window of the paper, which promises nothing.
    Paper,
    /// The e-detector, whose mean run length to a false alarm is promised.
    Detector,
}

/// What happened to an alarm.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Happening {
    /// It was raised, and stands.
    Raised,
    /// It stands no more: the window recovered, or the detector was quiet for long enough.
    Cleared,
}

/// An alarm raised or cleared: one JSON object.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Alarm {
    /// Names this happening; the same cycles give the same id.
    pub id: String,
    /// Raised or cleared.
    pub happening: Happening,
    /// How bad it is.
    pub level: Level,
    /// Who says so.
    pub rule: Rule,
    /// The recipe.
    pub recipe: String,
    /// What changed.
    pub metric: Metric,
    /// The number of the cycle within its recipe, from 1, at which this happened.
    pub cycle: u64,
    /// The id of that cycle.
    pub cycle_id: String,
    /// The robot of that cycle.
    pub robot: String,
    /// When, by the sender's clock, in seconds since 1970-01-01 UTC.
    pub time_s: f64,
    /// What changed, in one sentence.
    pub what: String,
    /// How sure it is, in one sentence.
    pub how_sure: String,
    /// Since when; absent when cleared and for the paper's rule.
    pub since: Option<Since>,
    /// What to look at first.
    pub look_at: Vec<String>,
}

/// When a change began: cycles of the recipe that report the metric, and the sender's clock.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Since {
    /// The likeliest first cycle, numbered within the recipe.
    pub cycle: u64,
    /// Its time, in seconds since 1970-01-01 UTC.
    pub time_s: f64,
    /// 95 % interval of the first cycle.
    pub cycles_95: [u64; 2],
    /// Times at the ends of that interval.
    pub times_95_s: [f64; 2],
    /// Whether the interval reaches back to the oldest cycle that is kept, so that it may have begun before.
    pub or_before: bool,
}
