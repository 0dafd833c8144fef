//! Flag columns: each indicates one failure mode.

use robogate_core::FailureMode;

use super::Mapping;
use super::role::Role;
use crate::published;

/// A column that indicates one failure mode.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Flag {
    /// The failure mode.
    pub(super) mode: FailureMode,
    /// The column. `None` if the mapping uses the column of that name for another role.
    pub(super) column: Option<String>,
    /// Whether an episode can have the flag and still succeed.
    pub(super) tolerated: bool,
    /// Whether the source should have the column. If it is missing, its failure mode is not recorded.
    pub(super) expected: bool,
}

/// The flags of a table: the flags of the published files, by column name, and those of the mapping.
///
/// A mapping with its own flags describes another task. The published flags are then not expected.
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

/// Whether the mapping uses this column for another role.
fn is_taken(mapping: &Mapping, column: &str) -> bool {
    mapping.names_parameter(column)
        || mapping.flags.values().any(|named| named == column)
        || Role::ALL.into_iter().any(|role| mapping.column(role) == column)
}
