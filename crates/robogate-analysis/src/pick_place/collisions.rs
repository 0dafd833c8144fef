//! Collisions worth replaying: those with the largest contact force.

use robogate_stats::format::number;

use crate::replay::{ReplayGroup, ReplayReason, episode, lowest};
use crate::table::{Ending, EpisodeTable};

/// The episodes of all stages that ended in a collision, sorted by contact force, the largest first. `None` without
/// one.
pub(super) fn hardest(table: &EpisodeTable) -> Option<ReplayGroup> {
    let collision = table.modes.iter().position(|mode| mode.as_str() == "collision")?;
    let forces = table.measure("peak_contact_force_n")?;
    let force = |row: usize| forces[row].filter(|f| f.is_finite());
    let hardest = lowest(table.len(), |row| match table.outcome[row] {
        Ending::Failure(mode) if usize::from(mode) == collision => force(row).map(|f| -f),
        _ => None,
    });
    let figure = |row: usize| force(row).map_or_else(String::new, |f| format!("{} N", number(f)));
    (!hardest.is_empty()).then(|| ReplayGroup {
        reason: ReplayReason::Task,
        title: "Strongest collisions".to_owned(),
        why: "Largest contact force among episodes of every stage that ended in a collision.".to_owned(),
        episodes: hardest.into_iter().map(|row| episode(table, row, figure(row))).collect(),
    })
}
