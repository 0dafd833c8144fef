//! What a requirement speaks of.

use std::fmt;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// A figure of a set of episodes (the paper's table 1, and what stands beside it).
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Metric {
    /// Successes among episodes (the paper's grasp success rate).
    SuccessRate,
    /// Mean duration of an episode, however it ended, in simulated seconds.
    CycleTimeS,
    /// Episodes that ended in a collision: a count, for point comparisons only.
    CollisionCount,
    /// Share of episodes that ended in a collision.
    CollisionRate,
    /// Share of episodes in which the object was lost after the grasp (grip loss).
    DropRate,
    /// Share of episodes in which the gripper closed without the object.
    GraspMissRate,
    /// Share of episodes that ran out of time.
    TimeoutRate,
}

impl Metric {
    /// Every metric.
    pub const ALL: [Self; 7] = [
        Self::SuccessRate,
        Self::CycleTimeS,
        Self::CollisionCount,
        Self::CollisionRate,
        Self::DropRate,
        Self::GraspMissRate,
        Self::TimeoutRate,
    ];

    /// The metric's word in data.
    pub fn word(self) -> &'static str {
        match self {
            Self::SuccessRate => "success_rate",
            Self::CycleTimeS => "cycle_time_s",
            Self::CollisionCount => "collision_count",
            Self::CollisionRate => "collision_rate",
            Self::DropRate => "drop_rate",
            Self::GraspMissRate => "grasp_miss_rate",
            Self::TimeoutRate => "timeout_rate",
        }
    }

    /// The metric in words, for people.
    pub fn title(self) -> &'static str {
        match self {
            Self::SuccessRate => "success rate",
            Self::CycleTimeS => "mean cycle time",
            Self::CollisionCount => "collisions",
            Self::CollisionRate => "collision rate",
            Self::DropRate => "drop rate",
            Self::GraspMissRate => "grasp miss rate",
            Self::TimeoutRate => "timeout rate",
        }
    }

    /// Whether it is the chance of something in an episode.
    pub fn is_rate(self) -> bool {
        !matches!(self, Self::CycleTimeS | Self::CollisionCount)
    }
}

impl fmt::Display for Metric {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.word())
    }
}
