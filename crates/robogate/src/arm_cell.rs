//! Tasks for an arm in this process: a task, a robot and an engine that the user chooses.

use anyhow::{Context, anyhow, bail};
use robogate_camera::SIZE_PX;
use robogate_core::{Environment, ParameterSpace, Policy};
use robogate_dictionary::provenance;
use robogate_physics::{Robot, SuctionLaw, grip_force};
use robogate_remote::message::{self, Hello};
use robogate_tasks::ArmTask;
use serde::{Deserialize, Serialize};

use crate::cell;
use crate::registry::{self, EngineEntry};

/// The settings of an arm's cell, as a run records them.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct ArmSettings {
    /// The task.
    pub(crate) task: String,
    /// The name of a built-in robot, or the folder of a user's robot.
    pub(crate) robot: String,
    /// The physics engine.
    pub(crate) engine: String,
    /// The engine's time step, in seconds.
    pub(crate) time_step_s: f64,
    /// Normal force of each pad, in newtons. `None` for the robot's default.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(crate) grip_force_n: Option<f64>,
    /// How a suction cup holds an object. `None` for a gripper without one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(crate) suction: Option<SuctionLaw>,
}

/// A task for an arm. It can be set up several times, once for each thread.
pub(crate) struct ArmCell {
    task: &'static dyn ArmTask,
    settings: ArmSettings,
    robot: Robot,
    picture_px: usize,
}

impl ArmCell {
    /// Reads the robot and sets the task up once, so that problems are reported before a run starts. `suction` is used for
    /// a suction cup if the settings do not choose a law.
    pub(crate) fn new(mut settings: ArmSettings, suction: SuctionLaw) -> anyhow::Result<Self> {
        let task = registry::arm_task(&settings.task)
            .ok_or_else(|| anyhow!("--task {}: unknown task for an arm", settings.task))?;
        let robot = cell::robot(&settings.robot)?;
        EngineEntry::find(&settings.engine)?;
        let gripper = &robot.settings.gripper;
        match (gripper.cup(), settings.suction) {
            (Some(_), law) => settings.suction = Some(law.unwrap_or(suction)),
            (None, Some(law)) => {
                bail!(
                    "--suction {law} applies to suction cups; the gripper of {} is {}",
                    robot.name(),
                    gripper.description()
                );
            }
            (None, None) => {}
        }
        grip_force(gripper, settings.grip_force_n).map_err(|why| anyhow!("--grip-force: {why}"))?;
        let cell = Self { task, settings, robot, picture_px: SIZE_PX };
        cell.environment()?.reset(&cell::nominal()).context("the robot cannot be set up for this task")?;
        Ok(cell)
    }

    /// The same cell with camera images of this width and height in pixels.
    pub(crate) fn with_pictures_of(self, picture_px: usize) -> Self {
        Self { picture_px, ..self }
    }

    /// The settings.
    pub(crate) fn settings(&self) -> &ArmSettings {
        &self.settings
    }

    /// The robot.
    pub(crate) fn robot(&self) -> &Robot {
        &self.robot
    }

    /// The hash of the robot's files.
    pub(crate) fn robot_sha256(&self) -> anyhow::Result<String> {
        Ok(cell::identity(&self.robot.files()?))
    }

    /// The name of the task's suite.
    pub(crate) fn suite(&self) -> &'static str {
        self.task.suite()
    }

    /// The parameter space of the task for this robot.
    pub(crate) fn space(&self) -> anyhow::Result<ParameterSpace> {
        Ok(ParameterSpace::from_toml(self.task.space(&self.robot.settings.gripper))?)
    }

    /// Creates an environment.
    pub(crate) fn environment(&self) -> anyhow::Result<Box<dyn Environment>> {
        let ArmSettings { engine, time_step_s, grip_force_n, suction, .. } = &self.settings;
        let engine = (EngineEntry::find(engine)?.engine)(self.robot.clone(), *time_step_s)?;
        let suction = suction.unwrap_or(SuctionLaw::Vacuum);
        self.task.environment(engine, *grip_force_n, suction, self.picture_px).map_err(|why| anyhow!(why))
    }

    /// The scripted controller.
    pub(crate) fn controller(&self) -> anyhow::Result<Box<dyn Policy>> {
        let ArmSettings { engine, .. } = &self.settings;
        let chain = (EngineEntry::find(engine)?.chain)(self.robot.clone())?;
        Ok(self.task.controller(self.robot.clone(), chain))
    }

    /// The engine and robot of the provenance.
    pub(crate) fn provenance(&self) -> anyhow::Result<(provenance::Engine, provenance::Robot)> {
        let ArmSettings { engine, time_step_s, .. } = &self.settings;
        let build = (EngineEntry::find(engine)?.engine)(self.robot.clone(), *time_step_s)?.build();
        let robot = provenance::Robot {
            name: self.robot.name().to_owned(),
            sha256: Some(self.robot_sha256()?),
            dimensions: None,
        };
        Ok((cell::engine(build), robot))
    }

    /// The information that a server of this task declares.
    pub(crate) fn hello(&self) -> anyhow::Result<Hello> {
        let (engine, robot) = self.provenance()?;
        let program = message::Program { name: "robogate".to_owned(), version: env!("CARGO_PKG_VERSION").to_owned() };
        let (version, sha256) = (engine.version.unwrap_or_default(), engine.build_sha256);
        let engine = message::Engine { name: engine.name, version, solver: None, sha256 };
        let task = (**self.environment()?.task()).clone();
        Ok(Hello {
            robot: Some(message::Robot { name: robot.name, sha256: robot.sha256 }),
            time_step_s: Some(self.settings.time_step_s),
            space: Some(self.space()?),
            ..Hello::new(task, program, engine)
        })
    }
}
