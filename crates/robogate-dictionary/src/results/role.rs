//! What a column of a table can be.

/// What a column can be, beside a parameter and the flag of a failure mode.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Role {
    /// Whether the episode succeeded: true or false, 1 or 0, or the words success, fail, failure, failed, error, invalid.
    Success,
    /// How it failed: any word. Empty, `none` or `success` where it did not.
    FailureMode,
    /// Time until the task was done or given up, in seconds.
    CycleTime,
    /// What broke under the policy: anything but empty, false or 0 makes the episode invalid.
    Error,
    /// The environment's seed; kept as the parameter `source_seed`.
    Seed,
    /// The case of the suite.
    Case,
    /// The category of the case.
    Category,
    /// The group of the case.
    Group,
}

impl Role {
    /// Every role.
    pub const ALL: [Self; 8] = [
        Self::Success,
        Self::FailureMode,
        Self::CycleTime,
        Self::Error,
        Self::Seed,
        Self::Case,
        Self::Category,
        Self::Group,
    ];

    /// Its key in a mapping, and the column in which it is expected where the mapping names none.
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
        }
    }

    /// The role of this key.
    pub(super) fn of_key(key: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|role| role.as_str() == key)
    }

    /// Whether it says how the episode ended. Such a column is never a parameter: it would predict itself.
    pub(super) fn is_result(self) -> bool {
        matches!(self, Self::Success | Self::FailureMode | Self::CycleTime | Self::Error)
    }
}

/// The name that our own exports and the published files use for the failure mode.
pub(super) const FAILURE_TYPE: &str = "failure_type";
