//! Workspace distance and reach of each robot.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::comparison::dataset::Dataset;
use crate::rate::Rate;

/// The reach of one robot and its distance to the workspace.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ReachRow {
    /// The name of the dataset.
    pub name: String,
    /// The robot's reach. `None` if it is unknown.
    pub reach_m: Option<f64>,
    /// Distance from the robot's base to the centre of the workspace. `None` if it is unknown.
    pub workspace_m: Option<f64>,
    /// Workspace distance divided by reach.
    pub ratio: Option<f64>,
    /// Whether one of the two was given on the command line.
    pub given: bool,
    /// The success rate of the dataset.
    pub rate: Rate,
}

pub(crate) fn reach(datasets: &[&Dataset<'_>], given: &[(String, f64)], workspace: Option<f64>) -> Vec<ReachRow> {
    let row = |dataset: &&Dataset<'_>| {
        let known = dataset.provenance().robot.dimensions;
        let named = given.iter().find(|(name, _)| *name == dataset.name).map(|(_, reach)| *reach);
        let reach_m = named.or(known.map(|d| d.reach_m));
        let recorded = known.map(|d| d.workspace_m);
        let workspace_m = recorded.or(workspace);
        ReachRow {
            name: dataset.name.clone(),
            reach_m,
            workspace_m,
            ratio: reach_m.zip(workspace_m).map(|(reach, workspace)| workspace / reach),
            given: named.is_some() || (recorded.is_none() && workspace.is_some()),
            rate: Rate::of_rows(&dataset.base, |_| true),
        }
    };
    datasets.iter().map(row).collect()
}
