//! What computes the episodes of a run.

use std::collections::BTreeMap;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// What computes the episodes of a run.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(tag = "kind", rename_all = "snake_case", deny_unknown_fields)]
pub enum Place {
    /// A built-in task for an arm.
    Cell(CellPlace),
    /// A built-in task that brings its own world.
    SelfContained,
    /// An environment that RoboGate starts in Python.
    Python(PythonPlace),
    /// Servers that declare their own task.
    Servers {
        /// The robot of the scripted controller, if the task is that of a built-in cell: a name or a folder.
        robot: String,
    },
}

/// The robot and the engine of a built-in task for an arm.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct CellPlace {
    /// The name of a built-in robot, or the folder of a user's robot.
    pub robot: String,
    /// The physics engine.
    pub engine: String,
    /// The engine's time step, in seconds.
    pub time_step_s: f64,
    /// The renderer of the cameras. Absent for the embedded one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub renderer: Option<RendererRecord>,
    /// Whether the engine runs in servers that only compute physics.
    #[serde(default, skip_serializing_if = "is_false")]
    pub physics_servers: bool,
}

#[expect(clippy::trivially_copy_pass_by_ref, reason = "serde passes references")]
fn is_false(value: &bool) -> bool {
    !value
}

/// The record of a renderer other than the embedded one.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(tag = "name", rename_all = "snake_case", deny_unknown_fields)]
pub enum RendererRecord {
    /// MuJoCo's renderer, through EGL.
    Egl {
        /// OpenGL's renderer and version. Another device may render different pixels.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        device: Option<String>,
    },
}

/// An environment that RoboGate starts in Python.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct PythonPlace {
    /// Its name: that of a bundled environment, or a file or module with the name of a class or function in it.
    pub environment: String,
    /// SHA-256 (hex) of the file in that name, if there is one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sha256: Option<String>,
    /// The files of modules outside of installed packages that it imported until the end of its first episode, and the files in its
    /// folder that it opened: SHA-256 (hex) by the name of the module as a path (`helpers.py`) or by the path (`model/arm.xml`).
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub files: BTreeMap<String, String>,
    /// The versions of the installed packages that it imported.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub packages: BTreeMap<String, String>,
}
