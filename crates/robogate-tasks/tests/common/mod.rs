//! Test cells: a robot in an engine.
#![expect(clippy::unwrap_used, clippy::print_stdout, reason = "a test fails by panicking, and prints its figures")]
#![allow(dead_code, unused_macros, reason = "each test binary uses only some items")]

use std::path::Path;
use std::sync::Arc;

#[cfg(feature = "mujoco")]
use robogate_core::Environment;
use robogate_core::{
    Action, Assignment, Command, Episode, Fault, Observation, Outcome, ParameterSpace, Policy, Scenario, Seed,
    TaskInstance, TaskSpec, Value, rollout,
};
#[cfg(feature = "mujoco")]
use robogate_physics::MujocoEngine;
#[cfg(feature = "rapier")]
use robogate_physics::RapierEngine;
use robogate_physics::{Engine, Robot};
#[cfg(feature = "mujoco")]
use robogate_tasks::ArmEnvironment;
use robogate_tasks::claims::{Bench, Setup, Workbench};
use robogate_tasks::file::{FileTask, shipped};
use robogate_tasks::insertion::Insertion;
use robogate_tasks::pick_place::PickPlace;
use robogate_tasks::{ArmDeclaration, ArmTask, Rig, built_in_space};

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

/// The built-in task from a file.
pub(crate) fn stacking() -> &'static FileTask {
    shipped().find(|task| task.name() == "stacking").unwrap()
}

/// Every built-in task for an arm.
pub(crate) fn arm_tasks() -> [&'static dyn ArmTask; 3] {
    [&PickPlace::DEFAULT, stacking(), &Insertion::DEFAULT]
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
        TestCell { on: self, robot: Robot::from_folder(&folder).unwrap(), task: &PickPlace::DEFAULT }
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

/// A robot in an engine, with a task.
pub(crate) struct TestCell {
    pub(crate) on: EngineKind,
    pub(crate) robot: Robot,
    pub(crate) task: &'static dyn ArmTask,
}

impl TestCell {
    /// The engine without the task.
    pub(crate) fn engine(&self) -> Box<dyn Engine> {
        self.on.engine(self.robot.clone(), self.on.time_step()).unwrap()
    }

    /// The same robot with this task.
    pub(crate) fn with(self, task: &'static dyn ArmTask) -> Self {
        Self { task, ..self }
    }

    /// Checks a claim of the task with this number of episodes, in the default space.
    pub(crate) fn confirm(&self, name: &str, episodes: usize) {
        let gripper = &self.robot.settings.gripper;
        let claim = self.task.claims(gripper).into_iter().find(|claim| claim.name == name).unwrap();
        let space = ParameterSpace::from_toml(built_in_space(self.task.space(gripper)).unwrap()).unwrap();
        let result = claim.check(self, &Arc::new(space), episodes).unwrap();
        println!("{}\n  {}", result.claim, result.figures.join("\n  "));
        assert!(result.holds, "{result:#?}");
    }
}

impl Workbench for TestCell {
    fn setup(&self) -> Setup {
        Setup { robot: self.robot.clone(), time_step_s: self.on.time_step(), settings: Assignment::default() }
    }

    fn bench(&self, setup: &Setup) -> Result<Bench, String> {
        let engine = self.on.engine(setup.robot.clone(), setup.time_step_s)?;
        let policy = self.task.controller(setup.robot.clone(), engine.chain().clone());
        Ok((self.task.with(&setup.settings)?.environment(engine, Rig::default())?, policy))
    }

    fn engine(&self) -> Result<Box<dyn Engine>, String> {
        Ok(TestCell::engine(self))
    }
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

/// The task runs: nothing falls through the table or flies away while the robot waits.
#[cfg(feature = "mujoco")]
pub(crate) fn runs(task: &FileTask) -> ArmEnvironment {
    let rig = Rig { picture_px: [16; 2], ..Rig::default() };
    let mut environment = task.on(EngineKind::Mujoco.robot("franka").engine(), rig).unwrap();
    let start = environment.reset(&scenario(0, &[])).unwrap();
    let posture = start.observation.joint_positions().to_vec();
    for _ in 0..20 {
        let command = Command::JointPosition(posture.clone());
        environment.step(&Action { command, gripper: Some(Action::OPEN), phase: None }).unwrap();
    }
    environment
}

/// A policy that keeps its first posture.
#[derive(Default)]
pub(crate) struct Idle {
    pub(crate) posture: Vec<f64>,
    /// Whether it gives up at once, so that an episode may end as soon as nothing moves.
    pub(crate) gives_up: bool,
}

impl Policy for Idle {
    fn check(&self, _: &TaskSpec) -> Result<(), String> {
        Ok(())
    }

    fn reset(&mut self, _: &TaskSpec, _: &TaskInstance, _: Seed) -> Result<(), Fault> {
        self.posture.clear();
        Ok(())
    }

    fn act(&mut self, observation: &Observation) -> Result<Action, Fault> {
        if self.posture.is_empty() {
            self.posture = observation.joint_positions().to_vec();
        }
        Ok(Action { command: Command::JointPosition(self.posture.clone()), gripper: Some(Action::OPEN), phase: None })
    }

    fn gave_up(&self) -> bool {
        self.gives_up
    }
}
