//! The built-in cell: the task pick_place with a robot, in an engine of this process or in physics servers.

use std::num::NonZeroUsize;
use std::path::Path;
use std::sync::Arc;

use anyhow::{Context, anyhow, bail};
use robogate_camera::{Renderer, SIZE_PX};
use robogate_core::{Assignment, Environment, ParameterSpace, Policy, Scenario, Seed, Suite};
use robogate_demos::Recorder;
use robogate_dictionary::{provenance, robot_sha256};
use robogate_physics::{
    Chain, Engine, EngineBuild, Gripper, Robot, RobotError, RobotFile, SuctionLaw, WORKSPACE_CENTRE, built_in_robot,
    is_folder,
};
use robogate_remote::message::{self, Hello};
use robogate_remote::{Pool, RemotePhysics};
use robogate_tasks::pick_place::claims::{Bench, Setup, Workbench};
use robogate_tasks::pick_place::{
    PickPlace, Rules, SceneParameters, Scripted, check_suite, default_space, remote, unit_space,
};
use serde::{Deserialize, Serialize};

use crate::registry::{ENGINES, EngineEntry};
use crate::remote::{self as servers, CellTask, PhysicsHost};
use crate::renderer::RendererRecord;
use crate::subject::named_space;

/// The settings of the cell, as a run records them.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct CellSettings {
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
    /// The renderer of the cameras. `None` for the embedded one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(crate) renderer: Option<RendererRecord>,
    /// The rules of the task.
    #[serde(default, skip_serializing_if = "Rules::are_default")]
    pub(crate) rules: Rules,
    /// Whether the engine runs in physics servers.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(crate) simulator: Option<Physics>,
}

/// Marks an engine that runs in servers that only compute physics.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum Physics {
    /// In servers.
    Physics,
}

/// The cell. It can be set up several times, once for each thread.
pub(crate) struct Cell {
    settings: CellSettings,
    robot: Robot,
    /// Pixels along each side of the camera images, if they were chosen.
    picture_px: Option<usize>,
    /// The servers, if the engine runs in them.
    pool: Option<Arc<Pool>>,
}

impl Cell {
    /// Reads the robot and sets the cell up once, so that problems are reported before a run starts. `suction` is used
    /// for a suction cup if the settings do not choose a law.
    pub(crate) fn new(
        mut settings: CellSettings,
        suction: SuctionLaw,
        pool: Option<Arc<Pool>>,
    ) -> anyhow::Result<Self> {
        let robot = robot(&settings.robot)?;
        settings.rules.check().map_err(|why| anyhow!(why))?;
        if let Some(pool) = &pool {
            let hello = pool.hello();
            servers::check_robot(hello, &robot, &identity(&robot.files()?))?;
            settings.engine = servers::engine(hello).name;
            settings.time_step_s = hello.time_step_s.unwrap_or_default();
            settings.simulator = Some(Physics::Physics);
        } else {
            EngineEntry::find(&settings.engine)?;
        }
        let (name, gripper) = (robot.name(), &robot.settings.gripper);
        match (gripper.cup(), settings.suction) {
            (Some(_), law) => settings.suction = Some(law.unwrap_or(suction)),
            (None, Some(law)) => {
                bail!("--suction {law} applies to suction cups; the gripper of {name} is {}", gripper.description());
            }
            (None, None) => {}
        }
        if let (Some(_), Some(force)) = (gripper.cup(), settings.grip_force_n) {
            bail!("--grip-force {force} applies to fingers; the gripper of {name} is a suction cup");
        }
        if let Some(record) = &settings.renderer {
            record.check(&settings.engine, pool.is_some())?;
        }
        let mut cell = Self { settings, robot, picture_px: None, pool };
        if let Some(record) = cell.settings.renderer.clone() {
            let engine = EngineEntry::find(&cell.settings.engine)?;
            cell.settings.renderer = Some((engine.renderer)(&cell.setup(), &record)?);
        }
        let mut environment = cell.environment()?;
        environment.reset(&nominal()).context("the robot cannot be set up in the cell")?;
        if cell.settings.renderer.is_some() {
            environment.render()?;
        }
        Ok(cell)
    }

    /// The same cell with camera images of this width and height in pixels.
    pub(crate) fn with_pictures_of(self, picture_px: usize) -> Self {
        Self { picture_px: Some(picture_px), ..self }
    }

    /// Uses the failure modes and the workspace of the paper in every later environment.
    pub(crate) fn set_like_the_paper(&mut self) {
        self.settings.rules = self.settings.rules.like_the_paper();
    }

    /// The cell's settings.
    pub(crate) fn settings(&self) -> &CellSettings {
        &self.settings
    }

    /// The robot.
    pub(crate) fn robot(&self) -> &Robot {
        &self.robot
    }

    /// The hash of the robot's files.
    pub(crate) fn robot_sha256(&self) -> anyhow::Result<String> {
        Ok(identity(&self.robot.files()?))
    }

    /// The robot's name.
    pub(crate) fn robot_name(&self) -> &str {
        self.robot.name()
    }

    /// How many servers the engine runs in, if it is remote. As many episodes run at once.
    pub(crate) fn servers(&self) -> Option<NonZeroUsize> {
        self.pool.as_ref().and_then(|pool| NonZeroUsize::new(pool.len()))
    }

    /// The name of the robot's own parameter space.
    pub(crate) fn default_space(&self) -> &'static str {
        default_space(&self.robot.settings.gripper)
    }

    /// The name of the distribution of this robot's units.
    pub(crate) fn unit_space(&self) -> &'static str {
        unit_space(&self.robot.settings.gripper)
    }

    /// Rejects a space with a parameter that the gripper or the servers do not have.
    pub(crate) fn check_space(&self, space: &ParameterSpace) -> anyhow::Result<()> {
        self.check_known(space).with_context(|| format!("space {}", space.name()))?;
        SceneParameters::check_space(space, Some(&self.robot.settings.gripper))
            .with_context(|| format!("space {}", space.name()))
    }

    /// Rejects a suite with a parameter that the gripper or the servers do not have.
    pub(crate) fn check_suite(&self, suite: &Suite) -> anyhow::Result<()> {
        self.check_known(suite.space()).with_context(|| format!("suite {}", suite.name()))?;
        match &*check_suite(suite, Some(&self.robot.settings.gripper)) {
            [] => Ok(()),
            [misfit] => bail!("suite {}: {misfit}", suite.name()),
            misfits => {
                let lines: Vec<String> = misfits.iter().map(|misfit| format!("\n  {misfit}")).collect();
                bail!("suite {}: {} problems{}", suite.name(), misfits.len(), lines.concat())
            }
        }
    }

    /// Checks that the servers can apply these parameters.
    fn check_known(&self, space: &ParameterSpace) -> anyhow::Result<()> {
        let Some(pool) = &self.pool else { return Ok(()) };
        let task = &pool.hello().task;
        let applies = |name: &str| remote::is_local(name) || task.parameter(name).is_some();
        match space.parameters().iter().find(|parameter| !applies(&parameter.name)) {
            Some(parameter) => {
                let known: Vec<&str> = task.parameters.iter().map(|parameter| &*parameter.name).collect();
                bail!(
                    "the simulator cannot apply the parameter `{}`. Expected one of: {}",
                    parameter.name,
                    known.join(", ")
                )
            }
            None => Ok(()),
        }
    }

    /// Creates an environment, and the scripted controller with a recorder that pushes the arm by `push_m` metres.
    pub(crate) fn demonstrator(&self, push_m: f64) -> anyhow::Result<(Box<dyn Environment>, Recorder<Scripted>)> {
        let setup = self.setup();
        let (environment, chain) = (self.environment()?, self.chain(&setup)?);
        let rest = setup.robot.settings.arm.home_rad.clone();
        Ok((environment, Recorder::new(Scripted::new(setup.robot, chain.clone()), chain, rest, push_m)))
    }

    fn build(&self, setup: &Setup) -> anyhow::Result<Built> {
        let engine = EngineEntry::find(&self.settings.engine)?;
        (engine.build)(setup, self.settings.renderer.as_ref(), self.picture_px.unwrap_or(SIZE_PX))
    }

    /// The robot's kinematics. Those of a remote engine are assumed to be ours, and checked at each reset.
    fn chain(&self, setup: &Setup) -> anyhow::Result<Chain> {
        match self.pool {
            Some(_) => (ENGINES[0].chain)(setup.robot.clone()),
            None => Ok(self.build(setup)?.chain),
        }
    }

    fn make(&self, setup: &Setup) -> anyhow::Result<(Box<dyn Environment>, Box<dyn Policy>)> {
        let (environment, chain): (Box<dyn Environment>, Chain) = match &self.pool {
            Some(pool) => {
                let chain = self.chain(setup)?;
                (Box::new(RemotePhysics::new(Arc::clone(pool), self.task_for(setup, chain.clone())?)?), chain)
            }
            None => {
                let Built { environment, chain, .. } = self.build(setup)?;
                (environment, chain)
            }
        };
        Ok((environment, Box::new(Scripted::new(setup.robot.clone(), chain))))
    }

    fn task_for(&self, setup: &Setup, chain: Chain) -> anyhow::Result<CellTask> {
        let sha256 = identity(&self.robot.files()?);
        CellTask::new(setup, chain, sha256, self.picture_px.unwrap_or(SIZE_PX))
    }

    /// Creates an environment of the cell.
    pub(crate) fn environment(&self) -> anyhow::Result<Box<dyn Environment>> {
        Ok(self.make(&self.setup())?.0)
    }

    /// The scripted controller.
    pub(crate) fn controller(&self) -> anyhow::Result<Box<dyn Policy>> {
        let setup = self.setup();
        let chain = self.chain(&setup)?;
        Ok(Box::new(Scripted::new(setup.robot, chain)))
    }

    /// The task, for servers that only compute its physics.
    pub(crate) fn remote_task(&self) -> anyhow::Result<CellTask> {
        let setup = self.setup();
        let chain = self.chain(&setup)?;
        self.task_for(&setup, chain)
    }

    /// The information that a server of this cell declares.
    pub(crate) fn hello(&self) -> anyhow::Result<Hello> {
        if self.pool.is_some() {
            bail!("`robogate serve` serves built-in environments only\n  hint: leave out --simulator");
        }
        let (engine, robot) = self.provenance()?;
        let program = message::Program { name: "robogate".to_owned(), version: env!("CARGO_PKG_VERSION").to_owned() };
        let (version, sha256) = (engine.version.unwrap_or_default(), engine.build_sha256);
        let engine = message::Engine { name: engine.name, version, solver: None, sha256 };
        let task = (**self.environment()?.task()).clone();
        Ok(Hello {
            robot: Some(message::Robot { name: robot.name, sha256: robot.sha256 }),
            time_step_s: Some(self.settings.time_step_s),
            space: Some(named_space(self.default_space())?),
            ..Hello::new(task, program, engine)
        })
    }

    /// Creates the engine as a server that only computes physics.
    pub(crate) fn physics_host(&self) -> anyhow::Result<PhysicsHost> {
        if self.settings.renderer.is_some() {
            bail!("--renderer egl cannot be used with --physics-only: such a server has no cameras");
        }
        if self.robot.settings.gripper.cup().is_some() {
            bail!("--physics-only supports parallel grippers only: {} has a suction cup", self.robot.name());
        }
        let mut hello = self.hello()?;
        hello.scores_itself = false;
        hello.space = None;
        hello.task.action.spaces.truncate(1);
        hello.task.observation.cameras.clear();
        hello.task.parameters.retain(|parameter| remote::is_for_engines(&parameter.name));
        let Setup { robot, time_step_s, .. } = self.setup();
        Ok(PhysicsHost::new(hello, (EngineEntry::find(&self.settings.engine)?.host)(robot, time_step_s)?))
    }

    /// The engine and robot of the provenance.
    pub(crate) fn provenance(&self) -> anyhow::Result<(provenance::Engine, provenance::Robot)> {
        let engine = match &self.pool {
            Some(pool) => servers::engine(pool.hello()),
            None => engine(self.build(&self.setup())?.engine),
        };
        let arm = &self.robot.settings.arm;
        let [x, y] = WORKSPACE_CENTRE;
        let robot = provenance::Robot {
            name: self.robot.name().to_owned(),
            sha256: Some(identity(&self.robot.files()?)),
            dimensions: Some(provenance::Dimensions {
                reach_m: arm.reach_m,
                payload_kg: arm.payload_kg,
                workspace_m: x.hypot(y),
            }),
        };
        Ok((engine, robot))
    }
}

/// An engine of this process, as records name it.
pub(crate) fn engine(build: EngineBuild) -> provenance::Engine {
    provenance::Engine { name: build.name.to_owned(), version: Some(build.version), build_sha256: build.sha256 }
}

/// A scenario with nominal values only.
pub(crate) fn nominal() -> Scenario {
    Scenario { index: 0, seed: Seed::campaign(0).episode(0), requested: Assignment::default() }
}

/// Loads a robot by its folder or name.
pub(crate) fn robot(wanted: &str) -> Result<Robot, RobotError> {
    if is_folder(wanted) { Robot::from_folder(Path::new(wanted)) } else { built_in_robot(wanted) }
}

/// The files of the robot with this name or folder, if they have this hash.
pub(crate) fn robot_files(wanted: &str, sha256: Option<&String>) -> Option<Vec<RobotFile>> {
    let files = robot(wanted).ok()?.files().ok()?;
    (sha256 == Some(&identity(&files))).then_some(files)
}

/// The identity of a robot, from its files.
pub(crate) fn identity(files: &[RobotFile]) -> String {
    robot_sha256(files.iter().map(|(name, bytes)| (name.as_str(), &**bytes)))
}

/// An environment and the identity of its engine.
pub(crate) struct Built {
    environment: Box<dyn Environment>,
    chain: Chain,
    engine: EngineBuild,
}

impl Built {
    pub(crate) fn new<E: Engine + 'static>(
        engine: E,
        setup: &Setup,
        picture_px: usize,
        renderer: Option<Box<dyn Renderer<E>>>,
    ) -> anyhow::Result<Self> {
        let (chain, build) = (engine.chain().clone(), engine.build());
        let task = PickPlace::new(engine, None).and_then(|task| task.with_rules(setup.rules));
        let mut task = task.map_err(|why| anyhow!(why))?;
        if let Some(renderer) = renderer {
            task = task.with_renderer(renderer);
        }
        let environment = task.with_suction(setup.suction).with_picture_size(picture_px, picture_px);
        Ok(Self { environment: Box::new(environment), chain, engine: build })
    }
}

impl Workbench for Cell {
    fn setup(&self) -> Setup {
        let mut robot = self.robot.clone();
        if let (Gripper::ParallelJaw(jaw), Some(force)) = (&mut robot.settings.gripper, self.settings.grip_force_n) {
            jaw.force_n = force;
        }
        let suction = self.settings.suction.unwrap_or(SuctionLaw::Vacuum);
        Setup { robot, time_step_s: self.settings.time_step_s, suction, rules: self.settings.rules }
    }

    fn bench(&self, setup: &Setup) -> Result<Bench, String> {
        if self.pool.is_some() && setup.time_step_s != self.setup().time_step_s {
            return Err("the time step of a remote simulator cannot be changed".to_owned());
        }
        self.make(setup).map_err(|e| format!("{e:#}"))
    }
}
