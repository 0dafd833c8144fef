//! What this build has, by name: engines, tasks, robots, policies, spaces and suites.
//!
//! A new engine or task is one line here. Robots, spaces and suites are files that their crates embed.

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
use robogate_tasks::{SelfContained, pick_place};

use crate::cell::Built;
use crate::remote::PhysicsEngine;
use crate::renderer::Drawn;

/// The engines of the built-in cell; the first is the default.
pub(crate) const ENGINES: &[EngineEntry] = &[
    #[cfg(feature = "mujoco")]
    EngineEntry::of::<MujocoEngine>(),
    #[cfg(feature = "rapier")]
    EngineEntry::of::<RapierEngine>(),
];

const _: () = assert!(!ENGINES.is_empty(), "a build needs an engine: --features mujoco, rapier or both");

/// The tasks that bring their own world.
pub(crate) const TASKS: &[&dyn SelfContained] = &[
    #[cfg(feature = "mujoco")]
    &robogate_tasks::pendulum::Pendulum,
];

/// The task of the built-in cell.
pub(crate) const CELL_TASK: &str = pick_place::NAME;

/// The policies that come with RoboGate, beside the profiles of external ones.
pub(crate) const POLICIES: [&str; 2] = ["scripted", "random"];

/// An engine of the built-in cell.
pub(crate) struct EngineEntry {
    /// Its name on the command line.
    pub(crate) name: &'static str,
    /// Its own time step, in seconds.
    pub(crate) time_step_s: f64,
    /// The task in it.
    pub(crate) build: fn(&Setup, Option<&Drawn>, usize) -> anyhow::Result<Built>,
    /// A robot's kinematics, as it has them.
    pub(crate) chain: fn(Robot) -> anyhow::Result<Chain>,
    /// It alone, for a server that only computes physics.
    pub(crate) host: fn(Robot, f64) -> anyhow::Result<Box<dyn PhysicsEngine>>,
    /// A renderer of its own, and what is recorded of it.
    pub(crate) renderer: fn(&Setup, &Drawn) -> anyhow::Result<Drawn>,
}

impl EngineEntry {
    const fn of<E: CellEngine>() -> Self {
        Self {
            name: E::NAME,
            time_step_s: E::TIME_STEP,
            build: |setup, drawn, picture_px| {
                let engine = E::create(setup.robot.clone(), setup.time_step_s)?;
                let renderer = drawn.map(|drawn| engine.renderer(drawn)).transpose()?;
                Built::new(engine, setup.suction, picture_px, renderer.map(|(renderer, _)| renderer))
            },
            chain: |robot| Ok(E::create(robot, E::TIME_STEP)?.chain().clone()),
            host: |robot, time_step_s| {
                let engine = E::create(robot, time_step_s)?;
                Ok(Box::new(remote::PhysicsHost::new(engine, None).map_err(|why| anyhow!(why))?))
            },
            renderer: |setup, drawn| Ok(E::create(setup.robot.clone(), setup.time_step_s)?.renderer(drawn)?.1),
        }
    }

    /// The engine of this name.
    pub(crate) fn find(name: &str) -> anyhow::Result<&'static Self> {
        ENGINES.iter().find(|engine| engine.name == name).ok_or_else(|| {
            let known: Vec<&str> = ENGINES.iter().map(|engine| engine.name).collect();
            anyhow!("--engine {name}: this build has no such engine. Expected one of: {}", known.join(", "))
        })
    }
}

/// What the built-in cell needs of an engine beside its physics.
trait CellEngine: Engine + Sized + 'static {
    const NAME: &'static str;
    const TIME_STEP: f64;

    fn create(robot: Robot, time_step_s: f64) -> Result<Self, RobotError>;

    /// Opens the renderer that works on this engine's state, and returns what is recorded of it.
    fn renderer(&self, drawn: &Drawn) -> anyhow::Result<(Box<dyn Renderer<Self>>, Drawn)> {
        Err(anyhow!("--renderer {}: the engine {} has no renderer of its own", drawn.name(), Self::NAME))
    }
}

#[cfg(feature = "mujoco")]
impl CellEngine for MujocoEngine {
    const NAME: &'static str = "mujoco";
    const TIME_STEP: f64 = Self::TIME_STEP_S;

    fn create(robot: Robot, time_step_s: f64) -> Result<Self, RobotError> {
        Self::new(robot, time_step_s)
    }

    fn renderer(&self, drawn: &Drawn) -> anyhow::Result<(Box<dyn Renderer<Self>>, Drawn)> {
        drawn.open(self)
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

/// The task of this name that brings its own world.
pub(crate) fn task(name: &str) -> anyhow::Result<&'static dyn SelfContained> {
    TASKS.iter().copied().find(|task| task.name() == name).ok_or_else(|| {
        let known: Vec<&str> = std::iter::once(CELL_TASK).chain(TASKS.iter().map(|task| task.name())).collect();
        anyhow!("--task {name}: unknown task. Expected one of: {}", known.join(", "))
    })
}

/// Everything by its kind and name, for people.
pub(crate) fn listing() -> Vec<(&'static str, Vec<String>)> {
    let names = |names: &mut dyn Iterator<Item = &str>| names.map(str::to_owned).collect::<Vec<String>>();
    let tasks = TASKS.iter().map(|task| format!("{}: {}", task.name(), task.summary()));
    vec![
        ("tasks", std::iter::once(format!("{CELL_TASK}: {}", pick_place::SUMMARY)).chain(tasks).collect()),
        ("engines", names(&mut ENGINES.iter().map(|engine| engine.name))),
        ("robots", names(&mut built_in_robots())),
        ("policies", names(&mut POLICIES.into_iter().chain(Profile::built_in_names()))),
        ("spaces", names(&mut built_in_spaces().chain(TASKS.iter().map(|task| task.name())))),
        ("suites", names(&mut BUILT_IN_SUITES.iter().map(|(name, _)| *name))),
    ]
}
