//! The fixed columns of every dictionary.

/// The data type of a column.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    /// A real number, never NaN or infinite.
    Number,
    /// A signed integer.
    Integer,
    /// An integer of at least 0.
    Count,
    /// A word or text.
    Text,
}

/// A column of every dictionary.
#[derive(Debug, Clone, Copy)]
pub struct FixedColumn {
    /// The name.
    pub name: &'static str,
    /// The data type.
    pub kind: Kind,
    /// Whether every row has a value. Otherwise a missing value is null, never 0 or NaN.
    pub required: bool,
    /// Whether the column has few distinct values.
    pub(super) repeats: bool,
    /// The meaning of the column.
    pub meaning: &'static str,
}

/// The fixed columns in order. The hidden draws of the task have columns after them.
///
/// Each parameter of the space has a column of its name with the requested value, between `seed` and `applied_other`.
/// After these, each parameter has a column with the prefix `applied_`: the value read back from the environment, null
/// if the reset failed. The measures of the task have columns before `ticks`.
pub fn fixed_columns() -> impl Iterator<Item = &'static FixedColumn> {
    LEADING.iter().chain(&TRAILING).chain(&CLOSING).chain(&LABEL)
}

/// The columns before the parameters.
pub(super) static LEADING: [FixedColumn; 5] = [
    FixedColumn {
        name: "index",
        kind: Kind::Count,
        required: true,
        repeats: false,
        meaning: "the episode's index in its campaign; rows are sorted by it",
    },
    FixedColumn {
        name: "stage",
        kind: Kind::Text,
        required: true,
        repeats: true,
        meaning: "the stage of the campaign that ran it",
    },
    FixedColumn {
        name: "design",
        kind: Kind::Text,
        required: true,
        repeats: true,
        meaning: "the sampler of the point",
    },
    FixedColumn {
        name: "weight",
        kind: Kind::Number,
        required: true,
        repeats: false,
        meaning: "importance weight p(x)/q(x): operating density over the density that the point was sampled from",
    },
    FixedColumn {
        name: "seed",
        kind: Kind::Count,
        required: true,
        repeats: true,
        meaning: "the campaign's seed; with the index it determines all randomness of the episode",
    },
];

/// The columns between the parameters and the measures.
pub(super) static TRAILING: [FixedColumn; 10] = [
    FixedColumn {
        name: "applied_other",
        kind: Kind::Text,
        required: false,
        repeats: false,
        meaning: "applied values that do not fit a column: JSON [[name, number|integer|category, value], ...]",
    },
    FixedColumn {
        name: "outcome",
        kind: Kind::Text,
        required: true,
        repeats: true,
        meaning: "success, a failure mode, or invalid",
    },
    FixedColumn {
        name: "failure_type",
        kind: Kind::Text,
        required: false,
        repeats: true,
        meaning: "the failure mode, or none; null where invalid",
    },
    FixedColumn {
        name: "fault_kind",
        kind: Kind::Text,
        required: false,
        repeats: true,
        meaning: "the class of fault of an invalid episode",
    },
    FixedColumn {
        name: "fault_detail",
        kind: Kind::Text,
        required: false,
        repeats: false,
        meaning: "the fault of an invalid episode as text",
    },
    FixedColumn {
        name: "cycle_time_s",
        kind: Kind::Number,
        required: false,
        repeats: false,
        meaning: "time of the decisive event, in simulated seconds from the start",
    },
    FixedColumn {
        name: "phase",
        kind: Kind::Text,
        required: false,
        repeats: true,
        meaning: "the phase that the policy reported at that time",
    },
    FixedColumn {
        name: "contact_robot_body",
        kind: Kind::Text,
        required: false,
        repeats: true,
        meaning: "the robot's body in the deciding contact",
    },
    FixedColumn {
        name: "contact_other_body",
        kind: Kind::Text,
        required: false,
        repeats: true,
        meaning: "the other body in the deciding contact",
    },
    FixedColumn {
        name: "contact_force_n",
        kind: Kind::Number,
        required: false,
        repeats: false,
        meaning: "largest normal force in the control period of first touch, in newtons",
    },
];

/// The columns after the measures.
pub(super) static CLOSING: [FixedColumn; 2] = [
    FixedColumn {
        name: "ticks",
        kind: Kind::Count,
        required: true,
        repeats: false,
        meaning: "number of control periods that ran",
    },
    FixedColumn {
        name: "trajectory_hash",
        kind: Kind::Text,
        required: true,
        repeats: false,
        meaning: "hash over the state at every control period, 16 hexadecimal digits; equal hashes mean equal runs",
    },
];

/// The columns of a suite's scenarios.
pub(super) static LABEL: [FixedColumn; 3] = [
    FixedColumn {
        name: "case",
        kind: Kind::Text,
        required: false,
        repeats: true,
        meaning: "the id of the scenario in its suite; null where the point was sampled from a space",
    },
    FixedColumn {
        name: "category",
        kind: Kind::Text,
        required: false,
        repeats: true,
        meaning: "the scenario's category in its suite",
    },
    FixedColumn {
        name: "group",
        kind: Kind::Text,
        required: false,
        repeats: true,
        meaning: "the scenario's group within its category",
    },
];
