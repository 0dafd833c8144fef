//! Test cells: a robot in an engine.
#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]
#![allow(dead_code, unused_macros, reason = "each test binary uses only some items")]

use std::path::Path;

use robogate_core::{Assignment, Episode, Outcome, Scenario, Seed, Value, rollout};
#[cfg(feature = "mujoco")]
use robogate_physics::MujocoEngine;
#[cfg(feature = "rapier")]
use robogate_physics::RapierEngine;
use robogate_physics::{Engine, JointTargets, Robot, Scene};
use robogate_tasks::pick_place::claims::{Bench, Setup, Workbench};
use robogate_tasks::pick_place::{PickPlace, Scripted};
use robogate_tasks::{ArmTask, Rig};

/// Creates one test per claim and engine.
macro_rules! of_every_engine {
    ($($(#[$doc:meta])* fn $claim:ident($on:ident: EngineKind) $body:block)*) => {
        $($(#[$doc])* fn $claim($on: EngineKind) $body)*

        #[cfg(feature = "mujoco")]
        mod mujoco {
            $(#[test] fn $claim() { super::$claim(super::EngineKind::Mujoco) })*
        }

        #[cfg(feature = "rapier")]
        mod rapier {
            $(#[test] fn $claim() { super::$claim(super::EngineKind::Rapier) })*
        }
    };
}

/// The engines.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum EngineKind {
    #[cfg(feature = "mujoco")]
    Mujoco,
    #[cfg(feature = "rapier")]
    Rapier,
}

impl EngineKind {
    /// A robot of the repository in this engine, by folder name.
    pub(crate) fn robot(self, name: &str) -> TestCell {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../assets/robots").join(name);
        TestCell { on: self, robot: Robot::from_folder(&folder).unwrap() }
    }

    pub(crate) fn franka(self) -> TestCell {
        self.robot("franka")
    }

    pub(crate) fn ur5e(self) -> TestCell {
        self.robot("ur5e")
    }

    /// A number of episodes: `fast` in a fast engine, a quarter of it in a slow one.
    pub(crate) fn episodes(self, fast: usize) -> usize {
        match self {
            #[cfg(feature = "mujoco")]
            Self::Mujoco => fast,
            #[cfg(feature = "rapier")]
            Self::Rapier => fast / 4,
        }
    }

    /// This robot in the engine.
    fn engine(self, robot: Robot, time_step_s: f64) -> Result<Box<dyn Engine>, String> {
        Ok(match self {
            #[cfg(feature = "mujoco")]
            Self::Mujoco => Box::new(MujocoEngine::new(robot, time_step_s).map_err(|e| e.to_string())?),
            #[cfg(feature = "rapier")]
            Self::Rapier => Box::new(RapierEngine::new(robot, time_step_s).map_err(|e| e.to_string())?),
        })
    }

    pub(crate) fn time_step(self) -> f64 {
        match self {
            #[cfg(feature = "mujoco")]
            Self::Mujoco => MujocoEngine::TIME_STEP_S,
            #[cfg(feature = "rapier")]
            Self::Rapier => RapierEngine::TIME_STEP_S,
        }
    }
}

/// A robot in an engine.
pub(crate) struct TestCell {
    pub(crate) on: EngineKind,
    pub(crate) robot: Robot,
}

impl TestCell {
    /// The engine without the task.
    pub(crate) fn engine(&self) -> Box<dyn Engine> {
        self.on.engine(self.robot.clone(), self.on.time_step()).unwrap()
    }
}

impl Workbench for TestCell {
    fn setup(&self) -> Setup {
        Setup { robot: self.robot.clone(), time_step_s: self.on.time_step(), settings: Assignment::default() }
    }

    fn bench(&self, setup: &Setup) -> Result<Bench, String> {
        let engine = self.on.engine(setup.robot.clone(), setup.time_step_s)?;
        let policy = Scripted::new(setup.robot.clone(), engine.chain().clone());
        Ok((PickPlace::of(&setup.settings)?.environment(engine, Rig::default())?, Box::new(policy)))
    }
}

/// Lets a scene run for this time in seconds, with the arm at home and its fingers open.
pub(crate) fn let_run(engine: &mut dyn Engine, scene: &Scene, seconds: f64) {
    let home = engine.robot().settings.arm.home_rad.clone();
    engine.load(scene, &home).unwrap();
    let targets = JointTargets { velocities: vec![0.0; home.len()], positions: home, finger: 0.04 };
    (0..(seconds / engine.time_step()) as usize).for_each(|_| engine.advance(&targets));
    engine.health().unwrap();
}

/// A scenario of the campaign with seed 5.
pub(crate) fn scenario(index: u64, parameters: &[(&str, f64)]) -> Scenario {
    let requested: Assignment =
        parameters.iter().map(|(name, value)| ((*name).into(), Value::Number(*value))).collect();
    Scenario { index, seed: Seed::campaign(5).episode(index), requested }
}

/// Runs episodes of a task's scripted controller.
pub(crate) fn episodes(on: EngineKind, task: &dyn ArmTask, robot: &str, scenarios: &[Scenario]) -> Vec<Episode> {
    let cell = on.robot(robot);
    let engine = cell.engine();
    let mut controller = task.controller(cell.robot.clone(), engine.chain().clone());
    let mut environment = task.environment(engine, Rig { picture_px: [64; 2], ..Rig::default() }).unwrap();
    controller.check(environment.task()).unwrap();
    scenarios.iter().map(|scenario| rollout(&mut *environment, &mut *controller, scenario)).collect()
}

/// The outcome of a valid episode as a word.
pub(crate) fn outcome(episode: &Episode) -> &str {
    match &episode.outcome {
        Outcome::Failure(mode) => mode.as_str(),
        Outcome::Success => "success",
        Outcome::Invalid(fault) => panic!("{fault}"),
    }
}
