//! Columns that hold one failure mode each: whether it happened.

use robogate_core::FailureMode;

use super::Mapping;
use super::role::Role;
use crate::published;

/// A column that holds one failure mode: whether it happened.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Flag {
    /// The failure mode.
    pub(super) mode: FailureMode,
    /// The column; `None` where the one of that name is something else.
    pub(super) column: Option<String>,
    /// Whether an episode can have it and succeed all the same.
    pub(super) tolerated: bool,
    /// Whether the source should have it: where it is missing, its failure mode is not recorded.
    pub(super) expected: bool,
}

/// The flags of a table: those of the published files, by the names of their columns, and those of the mapping.
///
/// A mapping with a flag of its own describes another task. Of such a source the published flags are not expected.
pub(super) fn of(mapping: &Mapping) -> Vec<Flag> {
    let is_published = |mode: FailureMode| published::FLAGS.iter().any(|flag| flag.mode == mode);
    let another_task = mapping.flags.keys().any(|mode| !is_published(*mode));
    let published = published::FLAGS.iter().map(|flag| {
        let named = mapping.flags.get(&flag.mode);
        let usual = Some(flag.column).filter(|column| !is_taken(mapping, column));
        Flag {
            mode: flag.mode,
            column: named.cloned().or(usual.map(str::to_owned)),
            tolerated: flag.tolerated,
            expected: named.is_some() || !another_task,
        }
    });
    let own = mapping.flags.iter().filter(|(mode, _)| !is_published(**mode)).map(|(mode, column)| Flag {
        mode: *mode,
        column: Some(column.clone()),
        tolerated: false,
        expected: true,
    });
    published.chain(own).collect()
}

/// Whether the mapping names this column for something else.
fn is_taken(mapping: &Mapping, column: &str) -> bool {
    mapping.names_parameter(column)
        || mapping.flags.values().any(|named| named == column)
        || Role::ALL.into_iter().any(|role| mapping.column(role) == column)
}
