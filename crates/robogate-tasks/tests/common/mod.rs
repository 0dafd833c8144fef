//! Test cells: a robot in an engine.
#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]
#![allow(dead_code, reason = "each test binary uses only some items")]

use std::path::Path;

#[cfg(feature = "mujoco")]
use robogate_physics::MujocoEngine;
#[cfg(feature = "rapier")]
use robogate_physics::RapierEngine;
use robogate_physics::{Engine, Robot, SuctionLaw};
use robogate_tasks::pick_place::claims::{Bench, Setup, Workbench};
use robogate_tasks::pick_place::{PickPlace, Rules, Scripted};

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
        let (robot, step) = (self.robot.clone(), self.on.time_step());
        match self.on {
            #[cfg(feature = "mujoco")]
            EngineKind::Mujoco => Box::new(MujocoEngine::new(robot, step).unwrap()),
            #[cfg(feature = "rapier")]
            EngineKind::Rapier => Box::new(RapierEngine::new(robot, step).unwrap()),
        }
    }
}

impl Workbench for TestCell {
    fn setup(&self) -> Setup {
        Setup {
            robot: self.robot.clone(),
            time_step_s: self.on.time_step(),
            suction: SuctionLaw::Vacuum,
            rules: Rules::default(),
        }
    }

    fn bench(&self, setup: &Setup) -> Result<Bench, String> {
        let (robot, step) = (setup.robot.clone(), setup.time_step_s);
        match self.on {
            #[cfg(feature = "mujoco")]
            EngineKind::Mujoco => bench(MujocoEngine::new(robot, step).map_err(|e| e.to_string())?, setup),
            #[cfg(feature = "rapier")]
            EngineKind::Rapier => bench(RapierEngine::new(robot, step).map_err(|e| e.to_string())?, setup),
        }
    }
}

fn bench<E: Engine + 'static>(engine: E, setup: &Setup) -> Result<Bench, String> {
    let policy = Scripted::new(setup.robot.clone(), engine.chain().clone());
    let cell = PickPlace::new(engine, None)?.with_suction(setup.suction).with_rules(setup.rules)?;
    Ok((Box::new(cell), Box::new(policy)))
}
