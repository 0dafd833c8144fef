//! The engines, tasks, robots, policies, spaces and suites of this build, by name.
//!
//! A new engine or task adds one line here. Robots, spaces and suites are files that their crates embed.

use std::path::Path;
use std::sync::{Arc, LazyLock};

use anyhow::anyhow;
use robogate_core::Assignment;
#[cfg(feature = "mujoco")]
use robogate_physics::MujocoEngine;
#[cfg(feature = "rapier")]
use robogate_physics::RapierEngine;
use robogate_physics::{Chain, Engine, Robot, RobotError};
use robogate_tasks::file::shipped;
use robogate_tasks::insertion::Insertion;
use robogate_tasks::pick_place::{self, PickPlace};
use robogate_tasks::{ArmTask, SelfContained, built_in_spaces};

use crate::task_folder;
use crate::text::foreign;

/// The engines of the built-in cell; the first is the default.
pub const ENGINES: &[EngineEntry] = &[
    #[cfg(feature = "mujoco")]
    MUJOCO,
    #[cfg(feature = "rapier")]
    EngineEntry {
        name: "rapier",
        time_step_s: RapierEngine::TIME_STEP_S,
        engine: |robot, time_step_s| Ok(Box::new(RapierEngine::new(robot, time_step_s)?)),
        worlds: None,
    },
    #[cfg(feature = "mujoco")]
    EngineEntry { name: "warp", worlds: Some(ManyWorlds { deterministic: false }), ..MUJOCO },
    #[cfg(feature = "mujoco")]
    EngineEntry { name: "warp-deterministic", worlds: Some(ManyWorlds { deterministic: true }), ..MUJOCO },
];

#[cfg(feature = "mujoco")]
const MUJOCO: EngineEntry = EngineEntry {
    name: "mujoco",
    time_step_s: MujocoEngine::TIME_STEP_S,
    engine: |robot, time_step_s| Ok(Box::new(MujocoEngine::new(robot, time_step_s)?)),
    worlds: None,
};

const _: () = assert!(!ENGINES.is_empty(), "a build needs an engine: --features mujoco, rapier or both");

/// The engines that a build may lack, named like their features.
const OPTIONAL: [&str; 2] = ["mujoco", "rapier"];

/// The tasks for an arm in the cell; the first is the default.
pub static ARM_TASKS: LazyLock<Vec<&'static dyn ArmTask>> = LazyLock::new(|| {
    let from_files = shipped().map(|task| -> &dyn ArmTask { task });
    let first: [&dyn ArmTask; 1] = [&PickPlace::DEFAULT];
    first.into_iter().chain(from_files).chain([&Insertion::DEFAULT as &dyn ArmTask]).collect()
});

/// The tasks that bring their own world.
pub const TASKS: &[&dyn SelfContained] = &[
    #[cfg(feature = "mujoco")]
    &robogate_tasks::pendulum::Pendulum::DEFAULT,
];

/// The default task.
pub const CELL_TASK: &str = pick_place::NAME;

/// The built-in policies. Profiles of external policies are listed beside them.
pub const POLICIES: [&str; 2] = ["scripted", "random"];

/// An engine of the built-in cell.
pub struct EngineEntry {
    /// Its name on the command line.
    pub name: &'static str,
    /// Default time step, in seconds.
    pub time_step_s: f64,
    /// Creates the engine.
    pub engine: fn(Robot, f64) -> Result<Box<dyn Engine>, RobotError>,
    /// Campaigns run in many worlds of MuJoCo Warp. A single episode, such as a replay, runs in `engine`.
    pub worlds: Option<ManyWorlds>,
}

/// How many worlds are simulated.
#[derive(Debug, Clone, Copy)]
pub struct ManyWorlds {
    /// Whether a rerun on the same card gives the same bytes.
    pub deterministic: bool,
}

impl EngineEntry {
    /// Reads a robot's kinematics as this engine models them.
    pub fn chain(&self, robot: Robot) -> anyhow::Result<Chain> {
        Ok((self.engine)(robot, self.time_step_s)?.chain().clone())
    }

    /// Finds an engine by its name.
    pub fn find(name: &str) -> anyhow::Result<&'static Self> {
        ENGINES.iter().find(|engine| engine.name == name).ok_or_else(|| {
            let known: Vec<&str> = ENGINES.iter().map(|engine| engine.name).collect();
            let hint =
                if OPTIONAL.contains(&name) { format!("\nHint: build with --features {name}") } else { String::new() };
            anyhow!("--engine {name}: no such engine in this build. Expected one of: {}{hint}", known.join(", "))
        })
    }
}

/// Finds a task for an arm by its name, or reads it from its folder. `None` for another task.
///
/// # Errors
/// Every problem of the folder.
pub fn arm_task(wanted: &str) -> anyhow::Result<Option<Arc<dyn ArmTask>>> {
    match ARM_TASKS.iter().find(|task| task.name() == wanted) {
        Some(task) => task.with(&Assignment::default()).map(Some).map_err(|why| anyhow!(why)),
        // A folder does not hide a built-in task.
        None if TASKS.iter().any(|task| task.name() == wanted) => Ok(None),
        None if Path::new(wanted).is_dir() => Ok(Some(Arc::new(task_folder::read(Path::new(wanted))?))),
        None if wanted.contains('/') => Err(anyhow!("--task {}: no such folder", foreign(wanted))),
        None => Ok(None),
    }
}

/// Whether robot and engine of a task can be chosen.
pub fn has_robots(task: &str) -> bool {
    matches!(arm_task(task), Ok(Some(_)))
}

/// Names and summaries of all tasks.
pub fn tasks() -> impl Iterator<Item = (&'static str, &'static str)> {
    let arms = ARM_TASKS.iter().map(|task| (task.name(), task.summary()));
    let others = TASKS.iter().map(|task| (task.name(), task.summary()));
    arms.chain(others)
}

/// Finds a task that brings its own world by its name.
pub fn task(name: &str) -> anyhow::Result<&'static dyn SelfContained> {
    TASKS.iter().copied().find(|task| task.name() == name).ok_or_else(|| {
        let known: Vec<&str> = tasks().map(|(name, _)| name).collect();
        anyhow!("--task {name}: unknown task. Expected one of: {}", known.join(", "))
    })
}

/// Names of all parameter spaces. Each task that brings its own world has one of its own name.
pub fn spaces() -> impl Iterator<Item = &'static str> {
    built_in_spaces().chain(TASKS.iter().map(|task| task.name()))
}
