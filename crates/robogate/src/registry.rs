//! The engines, tasks, robots, policies, spaces and suites of this build, by name.
//!
//! A new engine or task adds one line here. Robots, spaces and suites are files that their crates embed.

use anyhow::anyhow;
use robogate_camera::Renderer;
use robogate_campaign::BUILT_IN_SUITES;
#[cfg(feature = "mujoco")]
use robogate_physics::MujocoEngine;
#[cfg(feature = "rapier")]
use robogate_physics::RapierEngine;
use robogate_physics::{Chain, Engine, Robot, RobotError, built_in_robots};
use robogate_policy::Profile;
use robogate_tasks::pick_place::claims::Setup;
use robogate_tasks::pick_place::{built_in_spaces, remote};
use robogate_tasks::{ArmTask, SelfContained, pick_place};

use crate::cell::Built;
use crate::remote::PhysicsEngine;
use crate::renderer::RendererRecord;

/// The engines of the built-in cell; the first is the default.
pub(crate) const ENGINES: &[EngineEntry] = &[
    #[cfg(feature = "mujoco")]
    EngineEntry::of::<MujocoEngine>(),
    #[cfg(feature = "rapier")]
    EngineEntry::of::<RapierEngine>(),
];

const _: () = assert!(!ENGINES.is_empty(), "a build needs an engine: --features mujoco, rapier or both");

/// The engines that a build may lack, named like their features.
const OPTIONAL: [&str; 2] = ["mujoco", "rapier"];

/// The tasks for an arm in the cell, in addition to [`CELL_TASK`].
pub(crate) const ARM_TASKS: &[&dyn ArmTask] =
    &[&robogate_tasks::stacking::Stacking, &robogate_tasks::insertion::Insertion];

/// The tasks that bring their own world.
pub(crate) const TASKS: &[&dyn SelfContained] = &[
    #[cfg(feature = "mujoco")]
    &robogate_tasks::pendulum::Pendulum,
];

/// The task of the built-in cell.
pub(crate) const CELL_TASK: &str = pick_place::NAME;

/// The built-in policies. Profiles of external policies are listed beside them.
pub(crate) const POLICIES: [&str; 2] = ["scripted", "random"];

/// An engine of the built-in cell.
pub(crate) struct EngineEntry {
    /// Its name on the command line.
    pub(crate) name: &'static str,
    /// Default time step, in seconds.
    pub(crate) time_step_s: f64,
    /// Builds the task in this engine.
    pub(crate) build: fn(&Setup, Option<&RendererRecord>, usize) -> anyhow::Result<Built>,
    /// Creates the engine.
    pub(crate) engine: fn(Robot, f64) -> Result<Box<dyn Engine>, RobotError>,
    /// Reads a robot's kinematics as this engine models them.
    pub(crate) chain: fn(Robot) -> anyhow::Result<Chain>,
    /// Creates the engine alone, for a server that only computes physics.
    pub(crate) host: fn(Robot, f64) -> anyhow::Result<Box<dyn PhysicsEngine>>,
    /// Opens a renderer that is not the embedded one, and returns its record.
    pub(crate) renderer: fn(&Setup, &RendererRecord) -> anyhow::Result<RendererRecord>,
}

impl EngineEntry {
    const fn of<E: CellEngine>() -> Self {
        Self {
            name: E::NAME,
            time_step_s: E::TIME_STEP,
            build: |setup, record, picture_px| {
                let engine = E::create(setup.robot.clone(), setup.time_step_s)?;
                let renderer = record.map(|record| engine.renderer(record)).transpose()?;
                Built::new(engine, setup, picture_px, renderer.map(|(renderer, _)| renderer))
            },
            engine: |robot, time_step_s| Ok(Box::new(E::create(robot, time_step_s)?)),
            chain: |robot| Ok(E::create(robot, E::TIME_STEP)?.chain().clone()),
            host: |robot, time_step_s| {
                let engine = E::create(robot, time_step_s)?;
                Ok(Box::new(remote::PhysicsHost::new(engine, None).map_err(|why| anyhow!(why))?))
            },
            renderer: |setup, record| Ok(E::create(setup.robot.clone(), setup.time_step_s)?.renderer(record)?.1),
        }
    }

    /// Finds an engine by its name.
    pub(crate) fn find(name: &str) -> anyhow::Result<&'static Self> {
        ENGINES.iter().find(|engine| engine.name == name).ok_or_else(|| {
            let known: Vec<&str> = ENGINES.iter().map(|engine| engine.name).collect();
            let hint = if OPTIONAL.contains(&name) {
                format!("\n  hint: build with --features {name}")
            } else {
                String::new()
            };
            anyhow!("--engine {name}: no such engine in this build. Expected one of: {}{hint}", known.join(", "))
        })
    }
}

/// What the built-in cell needs from an engine in addition to its physics.
trait CellEngine: Engine + Sized + 'static {
    const NAME: &'static str;
    const TIME_STEP: f64;

    fn create(robot: Robot, time_step_s: f64) -> Result<Self, RobotError>;

    /// Opens the renderer that reads this engine's state, and returns it with its record.
    fn renderer(&self, record: &RendererRecord) -> anyhow::Result<(Box<dyn Renderer<Self>>, RendererRecord)> {
        Err(anyhow!("--renderer {}: not available for the engine {}. Expected embedded", record.name(), Self::NAME))
    }
}

#[cfg(feature = "mujoco")]
impl CellEngine for MujocoEngine {
    const NAME: &'static str = "mujoco";
    const TIME_STEP: f64 = Self::TIME_STEP_S;

    fn create(robot: Robot, time_step_s: f64) -> Result<Self, RobotError> {
        Self::new(robot, time_step_s)
    }

    fn renderer(&self, record: &RendererRecord) -> anyhow::Result<(Box<dyn Renderer<Self>>, RendererRecord)> {
        record.open(self)
    }
}

#[cfg(feature = "rapier")]
impl CellEngine for RapierEngine {
    const NAME: &'static str = "rapier";
    const TIME_STEP: f64 = Self::TIME_STEP_S;

    fn create(robot: Robot, time_step_s: f64) -> Result<Self, RobotError> {
        Self::new(robot, time_step_s)
    }
}

/// Finds a task for an arm, other than [`CELL_TASK`], by its name.
pub(crate) fn arm_task(name: &str) -> Option<&'static dyn ArmTask> {
    ARM_TASKS.iter().copied().find(|task| task.name() == name)
}

/// Whether robot and engine of a task can be chosen.
pub(crate) fn has_robots(task: &str) -> bool {
    task == CELL_TASK || arm_task(task).is_some()
}

/// Names and summaries of all tasks.
fn tasks() -> impl Iterator<Item = (&'static str, &'static str)> {
    let arms = ARM_TASKS.iter().map(|task| (task.name(), task.summary()));
    let others = TASKS.iter().map(|task| (task.name(), task.summary()));
    std::iter::once((CELL_TASK, pick_place::SUMMARY)).chain(arms).chain(others)
}

/// Finds a task that brings its own world by its name.
pub(crate) fn task(name: &str) -> anyhow::Result<&'static dyn SelfContained> {
    TASKS.iter().copied().find(|task| task.name() == name).ok_or_else(|| {
        let known: Vec<&str> = tasks().map(|(name, _)| name).collect();
        anyhow!("--task {name}: unknown task. Expected one of: {}", known.join(", "))
    })
}

/// Names of all parameter spaces. Each task beside [`CELL_TASK`] has one of its own name.
pub(crate) fn spaces() -> impl Iterator<Item = &'static str> {
    built_in_spaces().chain(tasks().skip(1).map(|(name, _)| name))
}

/// All names, by kind, for the terminal.
pub(crate) fn listing() -> Vec<(&'static str, Vec<String>)> {
    let names = |names: &mut dyn Iterator<Item = &str>| names.map(str::to_owned).collect::<Vec<String>>();
    vec![
        ("tasks", tasks().map(|(name, summary)| format!("{name}: {summary}")).collect()),
        ("engines", names(&mut ENGINES.iter().map(|engine| engine.name))),
        ("robots", names(&mut built_in_robots())),
        ("policies", names(&mut POLICIES.into_iter().chain(Profile::built_in_names()))),
        ("spaces", names(&mut spaces())),
        ("suites", names(&mut BUILT_IN_SUITES.iter().map(|(name, _)| *name))),
    ]
}
