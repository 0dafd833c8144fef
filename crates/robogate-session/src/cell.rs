//! The built-in cell: a task for an arm with a robot, in an engine of this process or in physics servers.

use std::num::NonZeroUsize;
use std::path::Path;
use std::sync::Arc;
#[cfg(feature = "mujoco")]
use std::sync::{Mutex, PoisonError};

use anyhow::{Context, anyhow, bail};
use robogate_camera::SIZE_PX;
#[cfg(feature = "mujoco")]
use robogate_core::BatchEnvironment;
use robogate_core::{Assignment, Environment, ParameterSpace, Policy, Scenario, Seed, Suite, TaskInstance, TaskSpec};
use robogate_demos::Recorder;
use robogate_dictionary::{CellPlace, provenance, robot_sha256};
use robogate_physics::{
    Chain, Engine, EngineBuild, Robot, RobotError, RobotFile, WORKSPACE_CENTRE, built_in_robot, is_folder,
};
#[cfg(feature = "mujoco")]
use robogate_physics::{MujocoEngine, Tape};
use robogate_remote::message::{self, Hello};
use robogate_remote::{Pool, RemotePhysics};
use robogate_tasks::claims::{Bench, Setup, Workbench};
use robogate_tasks::file::FileTask;
use robogate_tasks::{ArmTask, Rig, remote};

use crate::isolation;
use crate::registry::{self, ENGINES, EngineEntry, ManyWorlds};
use crate::remote::{self as servers, CellTask, PhysicsHost};
use crate::renderer;
use crate::subject::{check_declared, hello_of, named_space};
use crate::text::foreign;
#[cfg(feature = "mujoco")]
use crate::worlds::Worlds;

/// The robot of records that name none.
pub(crate) const FRANKA: &str = "franka";

/// This robot in the default engine.
pub(crate) fn default_place(robot: &str) -> CellPlace {
    CellPlace {
        robot: robot.to_owned(),
        engine: ENGINES[0].name.to_owned(),
        time_step_s: ENGINES[0].time_step_s,
        renderer: None,
        physics_servers: false,
    }
}

/// The cell. It can be set up several times, once for each thread.
pub struct Cell {
    task: Arc<dyn ArmTask>,
    /// Chosen values of the task's settings.
    chosen: Assignment,
    settings: CellPlace,
    robot: Robot,
    /// Pixels along each side of the camera images.
    picture_px: usize,
    /// Where its engines record what moves their scenes.
    #[cfg(feature = "mujoco")]
    tape: Option<Arc<Mutex<Tape>>>,
    /// The servers, if the engine runs in them.
    pool: Option<Arc<Pool>>,
    /// The simulator of many worlds, after its start.
    #[cfg(feature = "mujoco")]
    worlds: Mutex<Option<Arc<Worlds>>>,
}

impl Cell {
    /// Reads the robot and sets the cell up once, so that problems are reported before a run starts. `chosen` are values
    /// of the task's settings.
    pub fn new(
        base: &dyn ArmTask,
        mut settings: CellPlace,
        chosen: Assignment,
        pool: Option<Arc<Pool>>,
    ) -> anyhow::Result<Self> {
        let task = base.with(&chosen).map_err(|why| anyhow!(why))?;
        if let Some(why) = task.only_here()
            && (pool.is_some() || EngineEntry::find(&settings.engine)?.worlds.is_some())
        {
            bail!(why);
        }
        let robot = robot(&settings.robot)?;
        // The kinematics of a remote engine are read by the default one.
        let compiler = if pool.is_some() { &ENGINES[0] } else { EngineEntry::find(&settings.engine)? };
        isolation::check_model(&robot, compiler)?;
        let gripper = &robot.settings.gripper;
        if let Some((setting, _)) = chosen.iter().find(|(setting, _)| !task.has_effect(setting, gripper)) {
            bail!("setting `{setting}` has no effect: the gripper of {} is {}", robot.name(), gripper.description());
        }
        if let Some(pool) = &pool {
            let hello = pool.hello();
            servers::check_robot(hello, &robot, &identity(&robot.files()?))?;
            settings.engine = servers::engine(hello).name;
            settings.time_step_s = hello.time_step_s.unwrap_or_default();
            settings.physics_servers = true;
        }
        if let Some(record) = &settings.renderer {
            renderer::check(record, &settings.engine, pool.is_some())?;
        }
        let mut cell = Self {
            task,
            chosen,
            settings,
            robot,
            picture_px: SIZE_PX,
            #[cfg(feature = "mujoco")]
            tape: None,
            pool,
            #[cfg(feature = "mujoco")]
            worlds: Mutex::default(),
        };
        if let Some(record) = &cell.settings.renderer {
            cell.settings.renderer = Some(renderer::open(record, &*cell.engine(&cell.setup())?)?.1);
        }
        let mut environment = cell.environment()?;
        environment.reset(&nominal()).context("the robot cannot be set up in the cell")?;
        if cell.settings.renderer.is_some() {
            environment.render()?;
        }
        Ok(cell)
    }

    /// Renders camera images of this width and height in pixels in every later environment.
    pub fn set_picture_px(&mut self, picture_px: usize) {
        self.picture_px = picture_px;
    }

    /// Records what moves the scenes of every later environment, for plain MuJoCo.
    ///
    /// # Errors
    /// If the engine is another one, or runs elsewhere.
    #[cfg(feature = "mujoco")]
    pub fn taped(&mut self) -> anyhow::Result<Arc<Mutex<Tape>>> {
        if self.pool.is_some() || self.settings.engine != "mujoco" {
            bail!("the episode ran in the engine {}. Expected mujoco in this process", self.settings.engine);
        }
        Ok(Arc::clone(self.tape.insert(Arc::default())))
    }

    /// The engine that runs the episodes, without a scene.
    #[cfg(feature = "mujoco")]
    pub fn mujoco(&self) -> anyhow::Result<MujocoEngine> {
        Ok(MujocoEngine::new(self.robot.clone(), self.settings.time_step_s)?)
    }

    /// Uses the settings of the paper, other than those that the user chose, in every later environment.
    pub fn set_like_the_paper(&mut self) -> anyhow::Result<()> {
        let mut values = self.task.published(&self.robot.settings.gripper);
        self.chosen.iter().for_each(|(name, value)| values.set(name, value.clone()));
        self.task = self.task.with(&values).map_err(|why| anyhow!(why))?;
        self.chosen = values;
        Ok(())
    }

    /// The task.
    pub fn task(&self) -> &dyn ArmTask {
        &*self.task
    }

    /// The cell's settings.
    pub fn settings(&self) -> &CellPlace {
        &self.settings
    }

    /// The robot.
    pub fn robot(&self) -> &Robot {
        &self.robot
    }

    /// The hash of the robot's files.
    pub fn robot_sha256(&self) -> anyhow::Result<String> {
        Ok(identity(&self.robot.files()?))
    }

    /// The robot's name.
    pub fn robot_name(&self) -> &str {
        self.robot.name()
    }

    /// How many servers the engine runs in, if it is remote. As many episodes run at once.
    pub fn servers(&self) -> Option<NonZeroUsize> {
        self.pool.as_ref().and_then(|pool| NonZeroUsize::new(pool.len()))
    }

    /// The parameter space of the task for this robot.
    ///
    /// # Errors
    /// A robot without room for a range.
    pub fn own_space(&self) -> anyhow::Result<ParameterSpace> {
        if let Some(space) = self.task.brought_space() {
            return Ok(space);
        }
        let space = named_space(self.task.space(&self.robot.settings.gripper))?;
        Ok(self.task.fitted(space, &self.robot)?)
    }

    /// The name of the parameter space of the paper for this robot, if the task is from there.
    pub fn published_space(&self) -> Option<&'static str> {
        self.task.published_space(&self.robot.settings.gripper)
    }

    /// The name of the distribution of this robot's units.
    pub fn unit_space(&self) -> &'static str {
        self.task.unit_space(&self.robot.settings.gripper)
    }

    /// Rejects a space with a parameter that the task or the gripper does not have.
    pub fn check_space(&self, space: &ParameterSpace) -> anyhow::Result<()> {
        let name = || format!("space {}", space.name());
        self.task
            .parameters()
            .check_space(space, Some(&self.robot.settings.gripper))
            .map_err(|why| anyhow!(why))
            .with_context(name)?;
        check_declared(self.environment()?.task(), space).with_context(name)
    }

    /// Rejects a suite with a parameter that the task or the gripper does not have.
    pub fn check_suite(&self, suite: &Suite) -> anyhow::Result<()> {
        let name = || format!("suite {}", suite.name());
        match &*self.task.parameters().check_suite(suite, Some(&self.robot.settings.gripper)) {
            [] => check_declared(self.environment()?.task(), suite.space()).with_context(name),
            [misfit] => bail!("suite {}: {misfit}", suite.name()),
            misfits => {
                let lines: Vec<String> = misfits.iter().map(|misfit| format!("\n  {misfit}")).collect();
                bail!("suite {}: {} problems{}", suite.name(), misfits.len(), lines.concat())
            }
        }
    }

    /// Creates an environment, and the scripted controller with a recorder that pushes the arm by `push_m` metres.
    pub fn demonstrator(&self, push_m: f64) -> anyhow::Result<(Box<dyn Environment>, Recorder)> {
        let chain = self.chain(&self.setup())?;
        let rest = self.robot.settings.arm.home_rad.clone();
        let task = Arc::clone(&self.task);
        let robot = self.robot.clone();
        let told = Box::new(move |instance: &TaskInstance| task.first_part(instance, &robot));
        Ok((self.environment()?, Recorder::new(self.controller()?, told, chain, rest, push_m)))
    }

    /// Creates the engine.
    fn engine(&self, setup: &Setup) -> anyhow::Result<Box<dyn Engine>> {
        #[cfg(feature = "mujoco")]
        if let Some(tape) = &self.tape {
            let engine = MujocoEngine::new(setup.robot.clone(), setup.time_step_s)?;
            return Ok(Box::new(engine.taped(Arc::clone(tape))));
        }
        Ok((EngineEntry::find(&self.settings.engine)?.engine)(setup.robot.clone(), setup.time_step_s)?)
    }

    /// The robot's kinematics. Those of a remote engine are assumed to be ours, and checked at each reset.
    fn chain(&self, setup: &Setup) -> anyhow::Result<Chain> {
        let engine = if self.pool.is_some() { &ENGINES[0] } else { EngineEntry::find(&self.settings.engine)? };
        engine.chain(setup.robot.clone())
    }

    fn make(&self, setup: &Setup) -> anyhow::Result<Box<dyn Environment>> {
        if let Some(pool) = &self.pool {
            let task = self.task_for(setup, self.chain(setup)?)?;
            return Ok(Box::new(RemotePhysics::new(Arc::clone(pool), task)?));
        }
        let engine = self.engine(setup)?;
        let renderer = self.settings.renderer.as_ref().map(|record| renderer::open(record, &*engine)).transpose()?;
        let rig = Rig { picture_px: [self.picture_px; 2], renderer: renderer.map(|(renderer, _)| renderer) };
        self.task
            .with(&setup.settings)
            .map_err(|why| anyhow!(why))?
            .environment(engine, rig)
            .map_err(|why| anyhow!(why))
    }

    fn task_for(&self, setup: &Setup, chain: Chain) -> anyhow::Result<CellTask> {
        let sha256 = identity(&self.robot.files()?);
        let task = self.task.with(&setup.settings).map_err(|why| anyhow!(why))?;
        task.remote(setup.robot.clone(), chain, Some(sha256), [self.picture_px; 2])
            .map(CellTask)
            .map_err(|why| anyhow!(why))
    }

    /// The robot's kinematics.
    pub(crate) fn kinematics(&self) -> anyhow::Result<Chain> {
        self.chain(&self.setup())
    }

    /// Whether campaigns run in many worlds of one simulator.
    pub(crate) fn many_worlds(&self) -> Option<ManyWorlds> {
        if self.pool.is_some() { None } else { EngineEntry::find(&self.settings.engine).ok()?.worlds }
    }

    /// The simulator of many worlds, which is started if it does not run yet.
    #[cfg(feature = "mujoco")]
    pub(crate) fn worlds(&self, many: ManyWorlds) -> anyhow::Result<Arc<Worlds>> {
        let mut worlds = self.worlds.lock().unwrap_or_else(PoisonError::into_inner);
        if worlds.is_none() {
            *worlds = Some(Arc::new(Worlds::start(many.deterministic)?));
        }
        worlds.clone().context("no simulator")
    }

    /// An environment with so many worlds.
    #[cfg(feature = "mujoco")]
    pub(crate) fn batch(&self, many: ManyWorlds, slots: NonZeroUsize) -> anyhow::Result<Box<dyn BatchEnvironment>> {
        let setup = self.setup();
        let engine = MujocoEngine::new(setup.robot, setup.time_step_s)?;
        let rig = Rig { picture_px: [self.picture_px; 2], renderer: None };
        let task = self.task.with(&setup.settings).map_err(|why| anyhow!(why))?;
        let worlds = task.worlds(engine, rig, self.worlds(many)?.join()?, slots).map_err(|why| anyhow!(why))?;
        Ok(Box::new(worlds))
    }

    /// Creates an environment of the cell.
    pub fn environment(&self) -> anyhow::Result<Box<dyn Environment>> {
        self.make(&self.setup())
    }

    /// The scripted controller.
    pub fn controller(&self) -> anyhow::Result<Box<dyn Policy>> {
        let setup = self.setup();
        let chain = self.chain(&setup)?;
        Ok(self.task.controller(setup.robot, chain))
    }

    /// The task, for servers that only compute its physics.
    pub fn remote_task(&self) -> anyhow::Result<CellTask> {
        let setup = self.setup();
        let chain = self.chain(&setup)?;
        self.task_for(&setup, chain)
    }

    /// The information that a server of this cell declares.
    pub fn hello(&self) -> anyhow::Result<Hello> {
        if self.pool.is_some() {
            bail!("`robogate serve` serves built-in environments only\nHint: leave out --simulator");
        }
        let (engine, robot) = self.provenance()?;
        let task = (**self.environment()?.task()).clone();
        Ok(Hello {
            robot: Some(message::Robot { name: robot.name, sha256: robot.sha256 }),
            time_step_s: Some(self.settings.time_step_s),
            space: Some(self.own_space()?),
            ..hello_of(task, engine)
        })
    }

    /// Creates the engine as a server that only computes physics.
    pub fn physics_host(&self) -> anyhow::Result<PhysicsHost> {
        if let Some((setting, _)) = self.chosen.iter().next() {
            bail!(
                "--set {setting} has no effect with --physics-only: the client sends all settings with each cell\n\
                 Hint: use --set where the client starts"
            );
        }
        if self.settings.renderer.is_some() {
            bail!("--renderer egl cannot be used with --physics-only: such a server has no cameras");
        }
        let mut hello = self.hello()?;
        hello.scores_itself = false;
        hello.space = None;
        hello.task.action.spaces.truncate(1);
        hello.task.observation.cameras.clear();
        // All of them act through the cells that clients send.
        hello.task.parameters.clear();
        let host = remote::PhysicsHost::new(self.engine(&self.setup())?).map_err(|why| anyhow!(why))?;
        Ok(PhysicsHost::new(hello, host))
    }

    /// The engine of this process, as records name it.
    fn own_engine(&self) -> anyhow::Result<provenance::Engine> {
        let own = engine(self.engine(&self.setup())?.build());
        #[cfg(feature = "mujoco")]
        if let Some(many) = self.many_worlds() {
            // A replay runs in this process, on machines too that have no simulator of many worlds.
            let version = self.worlds(many).ok().and_then(|worlds| worlds.version());
            return Ok(provenance::Engine { name: self.settings.engine.clone(), version, ..own });
        }
        Ok(own)
    }

    /// The engine and robot of the provenance.
    pub fn provenance(&self) -> anyhow::Result<(provenance::Engine, provenance::Robot)> {
        let engine = match &self.pool {
            Some(pool) => servers::engine(pool.hello()),
            None => self.own_engine()?,
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
pub fn engine(build: EngineBuild) -> provenance::Engine {
    provenance::Engine { name: build.name.to_owned(), version: Some(build.version), build_sha256: build.sha256 }
}

/// The task for an arm of a record: the file that the record contains, or the built-in one with its name.
pub(crate) fn recorded_task(spec: &TaskSpec) -> anyhow::Result<Arc<dyn ArmTask>> {
    match FileTask::recorded(spec) {
        Some(Ok(task)) => Ok(Arc::new(task)),
        Some(Err(problems)) => {
            bail!("the recorded file of the task {} is not valid\n{}", foreign(spec.name.as_str()), listed(&problems))
        }
        // A name in a record is never that of a folder.
        None => match registry::ARM_TASKS.iter().find(|task| task.name() == spec.name.as_str()) {
            Some(task) => task.with(&Assignment::default()).map_err(|why| anyhow!(why)),
            None => bail!("{}: unknown task for an arm", foreign(spec.name.as_str())),
        },
    }
}

/// Whether a task is one for an arm in the cell.
pub(crate) fn is_cell(spec: &TaskSpec) -> bool {
    FileTask::recorded(spec).is_some() || registry::ARM_TASKS.iter().any(|task| task.name() == spec.name.as_str())
}

/// The problems of a task's file, one after another.
pub(crate) fn listed(problems: &[robogate_tasks::file::Problem]) -> String {
    problems.iter().map(ToString::to_string).collect::<Vec<_>>().join("\n")
}

/// A scenario with nominal values only.
pub fn nominal() -> Scenario {
    Scenario { index: 0, seed: Seed::campaign(0).episode(0), requested: Assignment::default() }
}

/// Loads a robot by its folder or name.
pub fn robot(wanted: &str) -> Result<Robot, RobotError> {
    if is_folder(wanted) { Robot::from_folder(Path::new(wanted)) } else { built_in_robot(wanted) }
}

/// The files of the robot with this name or folder, if they have this hash.
pub fn robot_files(wanted: &str, sha256: Option<&String>) -> Option<Vec<RobotFile>> {
    let files = robot(wanted).ok()?.files().ok()?;
    (sha256 == Some(&identity(&files))).then_some(files)
}

/// The identity of a robot, from its files.
pub fn identity(files: &[RobotFile]) -> String {
    robot_sha256(files.iter().map(|(name, bytes)| (name.as_str(), &**bytes)))
}

impl Workbench for Cell {
    fn setup(&self) -> Setup {
        let robot = self.robot.clone();
        Setup { robot, time_step_s: self.settings.time_step_s, settings: self.chosen.clone() }
    }

    fn bench(&self, setup: &Setup) -> Result<Bench, String> {
        if self.pool.is_some() && setup.time_step_s != self.setup().time_step_s {
            return Err("the time step of a remote simulator cannot be changed".to_owned());
        }
        let bench = || anyhow::Ok((self.make(setup)?, self.task.controller(setup.robot.clone(), self.chain(setup)?)));
        bench().map_err(|e| format!("{e:#}"))
    }

    fn engine(&self) -> Result<Box<dyn Engine>, String> {
        if self.pool.is_some() {
            return Err("this claim needs an engine in this process: leave out --simulator".to_owned());
        }
        Cell::engine(self, &self.setup()).map_err(|e| format!("{e:#}"))
    }
}
