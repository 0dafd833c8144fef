//! One demand.

use std::fmt;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::Metric;

/// One demand on one metric.
///
/// It has one of `at_least` and `at_most`; `at_most_times_baseline` may stand in place of `at_most` or beside it, and
/// then the more generous of the two holds.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Requirement {
    /// What it speaks of.
    pub metric: Metric,
    /// The metric must be this much or more.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub at_least: Option<f64>,
    /// The metric must be this much or less.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub at_most: Option<f64>,
    /// The metric must be at most this many times the baseline's.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub at_most_times_baseline: Option<f64>,
    /// Only scenarios of this category count.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub category: Option<String>,
    /// Only scenarios of this group count.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub group: Option<String>,
    /// The demand stands for each category or group by itself.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub each: Option<Each>,
    /// For `cycle_time_s` at a stated confidence: no episode can last longer than this, in seconds (the cell's time limit).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub ceiling_s: Option<f64>,
}

/// For what a demand stands by itself.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Each {
    /// Each category of the suite.
    Category,
    /// Each group of the suite.
    Group,
}

/// On which side of its limit a metric must be.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Sense {
    /// The limit or more.
    AtLeast,
    /// The limit or less.
    AtMost,
}

/// A demand with its limit as a number.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Bound {
    /// On which side.
    pub sense: Sense,
    /// The limit, in the metric's unit.
    pub limit: f64,
}

impl Bound {
    /// Whether `value` is on the demanded side; the limit itself is.
    pub fn holds(self, value: f64) -> bool {
        match self.sense {
            Sense::AtLeast => value >= self.limit,
            Sense::AtMost => value <= self.limit,
        }
    }
}

impl fmt::Display for Sense {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::AtLeast => "at least",
            Self::AtMost => "at most",
        })
    }
}
