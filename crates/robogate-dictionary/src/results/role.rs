//! Roles of table columns.

/// The role of a column that is neither a parameter nor the flag of a failure mode.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Role {
    /// Whether the episode succeeded: true or false, 1 or 0, or the words success, fail, failure, failed, error, invalid.
    Success,
    /// The failure mode as any word. Empty, `none` or `success` if the episode did not fail.
    FailureMode,
    /// Time until the task ended, in seconds.
    CycleTime,
    /// The infrastructure error. Any value except empty, false or 0 makes the episode invalid.
    Error,
    /// The environment's seed. It is kept as the parameter `source_seed`.
    Seed,
    /// The case of the suite.
    Case,
    /// The category of the case.
    Category,
    /// The group of the case.
    Group,
    /// The policy that acted. A dictionary has the rows of one policy.
    Policy,
}

impl Role {
    /// Every role.
    pub const ALL: [Self; 9] = [
        Self::Success,
        Self::FailureMode,
        Self::CycleTime,
        Self::Error,
        Self::Seed,
        Self::Case,
        Self::Category,
        Self::Group,
        Self::Policy,
    ];

    /// The key in a mapping, and the default column name of the role.
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::Success => "success",
            Self::FailureMode => "failure_mode",
            Self::CycleTime => "cycle_time_s",
            Self::Error => "error",
            Self::Seed => "seed",
            Self::Case => "case",
            Self::Category => "category",
            Self::Group => "group",
            Self::Policy => "policy",
        }
    }

    /// The role with this key.
    pub(super) fn of_key(key: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|role| role.as_str() == key)
    }

    /// Whether the role determines the outcome. Such a column is never a parameter, because it would predict itself.
    pub(super) fn is_result(self) -> bool {
        matches!(self, Self::Success | Self::FailureMode | Self::CycleTime | Self::Error)
    }
}

/// The name of the failure-mode column in RoboGate's exports and in the published files.
pub(super) const FAILURE_TYPE: &str = "failure_type";
