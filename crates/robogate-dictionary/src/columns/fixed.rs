//! The columns that every dictionary has.

/// What a column holds.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    /// A real number, never NaN or infinite.
    Number,
    /// A signed integer.
    Integer,
    /// An integer from 0.
    Count,
    /// A word or text.
    Text,
}

/// A column that every dictionary has.
#[derive(Debug, Clone, Copy)]
pub struct FixedColumn {
    /// Its name.
    pub name: &'static str,
    /// What it holds.
    pub kind: Kind,
    /// Whether every row has a value; else a missing one is null, never 0 or NaN.
    pub required: bool,
    /// Whether few distinct values are expected.
    pub(super) repeats: bool,
    /// What it means.
    pub meaning: &'static str,
}

/// The fixed columns in order; the last three exist since version 1.1.
///
/// Between `seed` and `applied_other` each parameter of the space has a column of its name (the requested value). After
/// these each has one with the prefix `applied_` (the value read back from the environment, null where the reset failed).
/// Before `ticks` each measure of the task has a column.
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
        meaning: "the episode's index in its campaign; rows are in rising order of it",
    },
    FixedColumn {
        name: "stage",
        kind: Kind::Text,
        required: true,
        repeats: true,
        meaning: "the stage of the campaign that ran it",
    },
    FixedColumn { name: "design", kind: Kind::Text, required: true, repeats: true, meaning: "what sampled its point" },
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
        meaning: "the campaign's seed; with the index it determines everything random in the episode",
    },
];

/// The columns between the parameters and the measures.
pub(super) static TRAILING: [FixedColumn; 10] = [
    FixedColumn {
        name: "applied_other",
        kind: Kind::Text,
        required: false,
        repeats: false,
        meaning: "applied values that fit no column: JSON [[name, number|integer|category, value], ...]",
    },
    FixedColumn {
        name: "outcome",
        kind: Kind::Text,
        required: true,
        repeats: true,
        meaning: "success, a failure mode, or invalid (no evidence)",
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
        meaning: "what happened in an invalid episode",
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
        meaning: "the phase that the policy reported then",
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
        meaning: "what it touched",
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
    FixedColumn { name: "ticks", kind: Kind::Count, required: true, repeats: false, meaning: "control ticks run" },
    FixedColumn {
        name: "trajectory_hash",
        kind: Kind::Text,
        required: true,
        repeats: false,
        meaning: "hash over the state at every tick, 16 hexadecimal digits: equal hashes, equal runs",
    },
];

/// The columns of a suite's scenarios, last of all.
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
