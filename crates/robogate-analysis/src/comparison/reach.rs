//! How far the workspace lies within each robot's reach.

use robogate_stats::Trials;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::comparison::entrant::Entrant;
use crate::rate::Rate;

/// How far the workspace lies within one robot's reach.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ReachRow {
    /// The dictionary's name.
    pub name: String,
    /// The robot's reach; absent where it is not known.
    pub reach_m: Option<f64>,
    /// Distance from the robot's base to the centre of the workspace; absent where it is not known.
    pub workspace_m: Option<f64>,
    /// Workspace over reach.
    pub ratio: Option<f64>,
    /// Whether the user gave one of the two on the command line.
    pub given: bool,
    /// The success rate it goes with.
    pub rate: Rate,
}

pub(crate) fn reach(entrants: &[&Entrant<'_>], given: &[(String, f64)], workspace: Option<f64>) -> Vec<ReachRow> {
    let row = |entrant: &&Entrant<'_>| {
        let known = entrant.provenance().robot.dimensions;
        let named = given.iter().find(|(name, _)| *name == entrant.name).map(|(_, reach)| *reach);
        let reach_m = named.or(known.map(|d| d.reach_m));
        let recorded = known.map(|d| d.workspace_m);
        let workspace_m = recorded.or(workspace);
        ReachRow {
            name: entrant.name.clone(),
            reach_m,
            workspace_m,
            ratio: reach_m.zip(workspace_m).map(|(reach, workspace)| workspace / reach),
            given: named.is_some() || (recorded.is_none() && workspace.is_some()),
            rate: Rate::of(Trials::count(entrant.base.success.iter().copied())),
        }
    };
    entrants.iter().map(row).collect()
}
