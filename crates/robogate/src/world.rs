//! From settings to a cell: the robot, the engine under it and the scripted controller.

use std::num::NonZeroUsize;
use std::path::Path;
use std::sync::Arc;

use anyhow::{Context, anyhow, bail};
use clap::Args;
use robogate_bridge::simulator::Pool;
use robogate_bridge::simulator::message::{self, ActionSpace, Camera, DeltaScale, Hello};
use robogate_camera::{Renderer, SIZE_PX};
use robogate_campaign::{Station, Workshop};
use robogate_core::{Assignment, Fault, FaultKind, ParameterSpace, Policy, Scenario, Seed, Simulator, Suite};
use robogate_demos::Recorder;
use robogate_dictionary::{hex, provenance, robot_sha256};
#[cfg(feature = "mujoco")]
use robogate_physics::MujocoEngine;
#[cfg(feature = "rapier")]
use robogate_physics::RapierEngine;
use robogate_physics::{
    Chain, Engine, EngineBuild, Gripper, Robot, RobotError, RobotFile, SuctionLaw, WORKSPACE_CENTRE, built_in_robot,
    is_folder,
};
use robogate_tasks::pick_place::claims::{Bench, Setup, Workbench};
use robogate_tasks::pick_place::{
    CONTROL_PERIOD_S, PickPlace, SceneParameters, Scripted, TIME_LIMIT_S, built_in_space, built_in_spaces, check_suite,
    default_space, remote,
};
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

use crate::exit::{Exit, OrExit};
use crate::far::{self, Far, OurWorld, Simulators, Told};
use crate::guest::Guest;
use crate::renderer::{Drawn, RendererName};

/// The engines of this build by name, each with its own time step in seconds; the first is the default.
const ENGINES: &[(&str, f64)] = &[
    #[cfg(feature = "mujoco")]
    ("mujoco", MujocoEngine::TIME_STEP_S),
    #[cfg(feature = "rapier")]
    ("rapier", RapierEngine::TIME_STEP_S),
];

const _: () = assert!(!ENGINES.is_empty(), "a build needs an engine: --features mujoco, rapier or both");

/// The engine by which the robot's kinematics are known where the physics is elsewhere: the first of [`ENGINES`].
#[cfg(feature = "mujoco")]
type OwnEngine = MujocoEngine;
#[cfg(not(feature = "mujoco"))]
type OwnEngine = RapierEngine;

/// Which world an episode runs in.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct World {
    /// A built-in robot's name, or the folder of one's own.
    pub(crate) robot: String,
    /// The physics engine.
    pub(crate) engine: String,
    /// The engine's time step in seconds.
    pub(crate) time_step_s: f64,
    /// Normal force of each pad in newtons; the robot's own setting where it is left out.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) grip_force_n: Option<f64>,
    /// What holds an object at a suction cup; nothing for a gripper without one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(crate) suction: Option<SuctionLaw>,
    /// What takes the pictures; the embedded caster where it is left out.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(crate) renderer: Option<Drawn>,
    /// What the engine is to us where it is behind a socket.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(crate) simulator: Option<Far>,
    /// The policy in place of the scripted controller.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(crate) policy: Option<Guest>,
}

/// The world, on the command line.
#[derive(Debug, Args)]
pub(crate) struct WorldArguments {
    /// A built-in robot (robogate robots), or the folder of your own
    #[arg(long, value_name = "R", default_value = "franka")]
    robot: String,
    /// The physics engine: mujoco or rapier
    #[arg(long, value_name = "E", default_value = ENGINES[0].0, conflicts_with = "addresses")]
    engine: String,
    /// The engine's time step in seconds; default: the engine's own
    #[arg(long, value_name = "SECONDS", conflicts_with = "addresses")]
    time_step: Option<f64>,
    /// Normal force of each gripper pad in newtons; default: the robot's own
    #[arg(long, value_name = "NEWTONS")]
    grip_force: Option<f64>,
    /// What holds an object at a suction cup: surface (a joint that never breaks, the paper's) or vacuum (pressure and
    /// friction, up to their limits); default: surface for the paper preset, vacuum otherwise
    #[arg(long, value_name = "LAW")]
    suction: Option<SuctionLaw>,
    /// What takes the cameras' pictures: the embedded ray caster, or MuJoCo's own renderer by EGL (docs/cameras.md)
    #[arg(long, value_name = "R", default_value = "embedded")]
    renderer: RendererName,
    #[command(flatten)]
    pub(crate) simulators: Simulators,
}

impl WorldArguments {
    /// The cell that they name; a suction cup holds by `suction` where they do not say.
    pub(crate) fn cell(&self, suction: SuctionLaw) -> Result<Cell, Exit> {
        let pool = self.simulators.connect()?;
        Cell::new(self.world(), suction, pool).or_usage()
    }

    /// The world that they name.
    fn world(&self) -> World {
        World {
            robot: absolute(&self.robot),
            engine: self.engine.clone(),
            time_step_s: self.time_step.unwrap_or_else(|| time_step(&self.engine)),
            grip_force_n: self.grip_force,
            suction: self.suction,
            renderer: self.renderer.drawn(),
            simulator: None,
            policy: None,
        }
    }
}

/// The time step of the engine of that name, in seconds; that of an engine that there is not is never used.
fn time_step(engine: &str) -> f64 {
    ENGINES.iter().find(|(name, _)| *name == engine).map_or(ENGINES[0].1, |(_, step)| *step)
}

/// A robot's folder by its full path, so that a run can be resumed from anywhere; a name as it is.
fn absolute(robot: &str) -> String {
    let path = Path::new(robot);
    let full = if is_folder(robot) { path.canonicalize().ok() } else { None };
    full.map_or_else(|| robot.to_owned(), |path| path.to_string_lossy().into_owned())
}

/// A cell that can be set up again and again, one for each thread.
pub(crate) struct Cell {
    world: World,
    robot: Robot,
    /// Pixels along each side of the cameras' pictures, where they are asked for.
    picture_px: Option<usize>,
    /// The servers, where the engine is behind a socket.
    pool: Option<Arc<Pool>>,
}

/// What 1 means in a tool delta that we serve.
const DELTA: DeltaScale = DeltaScale { translation_m: 0.02, rotation_rad: 0.05 };

impl Cell {
    /// Reads the robot and tries the cell out once, so that what is wrong is said before anything starts.
    ///
    /// A suction cup holds by `suction` where the world does not say.
    pub(crate) fn new(mut world: World, suction: SuctionLaw, pool: Option<Arc<Pool>>) -> anyhow::Result<Self> {
        let robot = robot(&world.robot)?;
        if let Some(pool) = &pool {
            let hello = pool.hello();
            far::check(hello, &robot, &identity(&robot.files()?))?;
            world.engine = far::engine(hello).name;
            world.time_step_s = hello.time_step_s;
            world.simulator = Some(if hello.judges { Far::Judging } else { Far::Physics });
        } else if !ENGINES.iter().any(|(name, _)| *name == world.engine) {
            let known = ENGINES.iter().map(|(name, _)| *name).collect::<Vec<_>>().join(" and ");
            bail!("there is no engine `{}` in this build; it has {known}", world.engine);
        }
        match (robot.settings.gripper.cup(), world.suction) {
            (Some(_), law) => world.suction = Some(law.unwrap_or(suction)),
            (None, Some(law)) => {
                let (name, gripper) = (robot.name(), robot.settings.gripper.description());
                bail!("--suction {law} is for a suction cup: the gripper of {name} is {gripper}");
            }
            (None, None) => {}
        }
        if let (Some(_), Some(force)) = (robot.settings.gripper.cup(), world.grip_force_n) {
            bail!("--grip-force {force} is for fingers: the gripper of {} is a suction cup", robot.name());
        }
        if let Some(drawn) = &world.renderer {
            drawn.check(&world.engine, pool.is_some())?;
        }
        #[cfg(feature = "mujoco")]
        if let Some(drawn) = &world.renderer {
            world.renderer = Some(drawn.open(&MujocoEngine::new(robot.clone(), world.time_step_s)?)?.1);
        }
        let cell = Self { world, robot, picture_px: None, pool };
        let mut simulator = cell.simulator()?;
        simulator.reset(&nominal()).context("the robot cannot be set up in the cell")?;
        if cell.world.renderer.is_some() {
            simulator.render()?;
        }
        Ok(cell)
    }

    /// The same cell, its cameras' pictures so many pixels wide and high.
    pub(crate) fn with_pictures_of(self, picture_px: usize) -> Self {
        Self { picture_px: Some(picture_px), ..self }
    }

    /// Pixels along each side of the cameras' pictures: as asked for, or as the policy wants them.
    fn picture_px(&self) -> usize {
        let wanted = || self.world.policy.as_ref()?.profile()?.rendered_px;
        self.picture_px.or_else(wanted).unwrap_or(SIZE_PX)
    }

    /// The same cell with this policy in place of the scripted controller, if there is one.
    pub(crate) fn with_policy(mut self, policy: Option<Guest>) -> Self {
        self.world.policy = policy;
        self
    }

    /// The same cell, its policy's server (if it has one) asked anew what it is.
    pub(crate) fn asked_again(mut self) -> Result<Self, Exit> {
        self.world.policy = self.world.policy.as_ref().map(Guest::asked_again).transpose()?;
        Ok(self)
    }

    /// The policy's name in records.
    pub(crate) fn policy(&self) -> &str {
        self.world.policy.as_ref().map_or("scripted", Guest::name)
    }

    /// At how many stations the policy can be at once, where that is limited.
    pub(crate) fn at_most(&self) -> Option<NonZeroUsize> {
        self.world.policy.as_ref()?.profile()?.dialect.one_at_a_time().then_some(NonZeroUsize::MIN)
    }

    /// The cell of a recorded run. One in servers needs to be told where they are now.
    pub(crate) fn recorded(
        provenance: &robogate_dictionary::Provenance,
        simulators: &Simulators,
    ) -> Result<Self, Exit> {
        let world: World = serde_json::from_value(provenance.world.clone())
            .context("the run's plan.json says nothing useful under provenance.world")
            .or_usage()?;
        let pool = simulators.connect()?;
        let engine = &provenance.engine;
        match (world.simulator, &pool) {
            (Some(_), None) => {
                let name = &engine.name;
                Err(anyhow!("the run was made in {name}, a simulator behind a socket\n  hint: --simulator ADDRESS"))
            }
            (None, Some(_)) => {
                Err(anyhow!("the run was made in {}, an engine of our own, without --simulator", engine.name))
            }
            (Some(_), Some(pool)) if far::engine(pool.hello()) != *engine => {
                let (is, version) = (far::engine(pool.hello()), engine.version.as_deref().unwrap_or_default());
                let now = is.version.as_deref().unwrap_or_default();
                Err(anyhow!("the run was made in {} {version}, this is {} {now}", engine.name, is.name))
            }
            _ => Ok(()),
        }
        .or_usage()?;
        // Runs of robots with a cup all say by which law it holds.
        Self::new(world, SuctionLaw::Vacuum, pool).or_usage()
    }

    /// How many servers the engine is behind, if it is behind any: as many episodes run at once.
    pub(crate) fn servers(&self) -> Option<NonZeroUsize> {
        self.pool.as_ref().and_then(|pool| NonZeroUsize::new(pool.len()))
    }

    /// A parameter space by its name, or the file that it is in; without either the robot's own.
    pub(crate) fn space(&self, wanted: Option<&str>) -> anyhow::Result<ParameterSpace> {
        let gripper = &self.robot.settings.gripper;
        let wanted = wanted.unwrap_or_else(|| default_space(gripper));
        let space = match built_in_space(wanted) {
            Some(text) => ParameterSpace::from_toml(text).with_context(|| wanted.to_owned()),
            None if !Path::new(wanted).exists() && !wanted.contains(['/', '.']) => {
                let known = built_in_spaces().collect::<Vec<_>>().join(", ");
                bail!("there is no parameter space `{wanted}`; built in: {known}; one of your own is named by its file")
            }
            None => std::fs::read_to_string(wanted)
                .with_context(|| format!("cannot read {wanted}"))
                .and_then(|text| ParameterSpace::from_toml(&text).with_context(|| wanted.to_owned())),
        }?;
        let named = space.parameters().iter().map(|parameter| &*parameter.name);
        self.check_known(named).with_context(|| format!("space {}", space.name()))?;
        // What parameters mean in a world that is not ours is not ours to say.
        if self.world.simulator != Some(Far::Judging) {
            SceneParameters::check_space(&space, Some(gripper)).with_context(|| format!("space {}", space.name()))?;
        }
        Ok(space)
    }

    /// Whether a simulator behind a socket can apply these parameters.
    fn check_known<'a>(&self, mut names: impl Iterator<Item = &'a str>) -> anyhow::Result<()> {
        let Some(pool) = &self.pool else { return Ok(()) };
        let hello = pool.hello();
        let here = |name: &str| !hello.judges && remote::is_local(name);
        match names.find(|name| !here(name) && !hello.parameters.iter().any(|known| known == name)) {
            Some(name) => {
                bail!("the simulator cannot apply the parameter `{name}`; it knows {}", hello.parameters.join(", "))
            }
            None => Ok(()),
        }
    }

    /// Whether the gripper has every parameter that a suite asks for.
    pub(crate) fn check_suite(&self, suite: &Suite) -> anyhow::Result<()> {
        let named = suite.space().parameters().iter().map(|parameter| &*parameter.name);
        self.check_known(named).with_context(|| format!("suite {}", suite.name()))?;
        if self.world.simulator == Some(Far::Judging) {
            return Ok(());
        }
        match check_suite(suite, Some(&self.robot.settings.gripper)).first() {
            Some(misfit) => bail!("suite {}: {misfit}", suite.name()),
            None => Ok(()),
        }
    }

    /// The robot's name.
    pub(crate) fn robot_name(&self) -> &str {
        self.robot.name()
    }

    /// A simulator, and the scripted controller under a recorder that pushes the arm about by `push_m`.
    pub(crate) fn demonstrator(&self, push_m: f64) -> anyhow::Result<(Box<dyn Simulator>, Recorder<Scripted>)> {
        let setup = self.setup();
        let (simulator, chain) = (self.simulator()?, self.chain(&setup)?);
        let rest = setup.robot.settings.arm.home_rad.clone();
        Ok((simulator, Recorder::new(Scripted::new(setup.robot, chain.clone()), chain, rest, push_m)))
    }

    /// The world that it is in.
    pub(crate) fn world(&self) -> &World {
        &self.world
    }

    fn build(&self, setup: &Setup) -> anyhow::Result<Built> {
        let (robot, step) = (setup.robot.clone(), setup.time_step_s);
        match self.world.engine.as_str() {
            #[cfg(feature = "mujoco")]
            "mujoco" => {
                let engine = MujocoEngine::new(robot, step)?;
                let renderer = self.world.renderer.as_ref().map(|drawn| drawn.open(&engine)).transpose()?;
                Built::new(engine, setup.suction, self.picture_px(), renderer.map(|(renderer, _)| renderer))
            }
            #[cfg(feature = "rapier")]
            "rapier" => Built::new(RapierEngine::new(robot, step)?, setup.suction, self.picture_px(), None),
            other => bail!("there is no engine `{other}` in this build"),
        }
    }

    /// The robot's kinematics; those of an engine behind a socket are taken to be ours, and held against it at each reset.
    fn chain(&self, setup: &Setup) -> anyhow::Result<Chain> {
        match self.pool {
            Some(_) => Ok(OwnEngine::new(setup.robot.clone(), ENGINES[0].1)?.chain().clone()),
            None => Ok(self.build(setup)?.chain),
        }
    }

    fn make(&self, setup: &Setup) -> anyhow::Result<(Box<dyn Simulator>, Box<dyn Policy>)> {
        let (simulator, chain) = match &self.pool {
            Some(pool) => {
                let chain = self.chain(setup)?;
                let sha256 = identity(&self.robot.files()?);
                (far::simulator(pool, &setup.robot, chain.clone(), sha256, self.picture_px())?, chain)
            }
            None => {
                let Built { simulator, chain, .. } = self.build(setup)?;
                (simulator, chain)
            }
        };
        Ok((simulator, Box::new(Scripted::new(setup.robot.clone(), chain))))
    }

    /// A simulator of the cell.
    pub(crate) fn simulator(&self) -> anyhow::Result<Box<dyn Simulator>> {
        Ok(self.make(&self.setup())?.0)
    }

    /// Our world, for a server that does not judge.
    pub(crate) fn our_world(&self) -> anyhow::Result<OurWorld> {
        let setup = self.setup();
        OurWorld::new(&setup.robot, self.chain(&setup)?, identity(&self.robot.files()?), self.picture_px())
    }

    /// What a server says of this cell.
    pub(crate) fn hello(&self) -> anyhow::Result<Hello> {
        if self.pool.is_some() {
            bail!("--simulator names a simulator that is served already");
        }
        let (engine, robot) = self.provenance()?;
        let mut simulator = self.simulator()?;
        simulator.reset(&nominal())?;
        // A robot that cannot be drawn has no cameras.
        let images = simulator.render().unwrap_or_default();
        let camera =
            |image: robogate_core::Image| Camera { name: image.camera, width: image.width, height: image.height };
        let program = |name: &str, version: &str| message::Program { name: name.into(), version: version.into() };
        Ok(Hello {
            server: program("robogate", env!("CARGO_PKG_VERSION")),
            engine: message::Engine { name: engine.name, version: engine.version.unwrap_or_default(), solver: None },
            robot: message::Robot { name: robot.name, sha256: robot.sha256 },
            time_step_s: self.world.time_step_s,
            control_period_s: CONTROL_PERIOD_S,
            time_limit_s: TIME_LIMIT_S,
            joints: self.robot.settings.arm.joints.clone(),
            action_spaces: vec![ActionSpace::JointPosition, ActionSpace::ToolDelta],
            tool_delta: Some(DELTA),
            cameras: images.into_iter().map(camera).collect(),
            quaternion_order: "wxyz".to_owned(),
            image_origin: "top_left".to_owned(),
            parameters: SceneParameters::names(&self.robot.settings.gripper).map(str::to_owned).collect(),
            judges: true,
            deterministic: true,
        })
    }

    /// The engine alone, to be told and to report.
    pub(crate) fn physics_host(&self) -> anyhow::Result<far::PhysicsHost> {
        if self.world.renderer.is_some() {
            bail!("--renderer egl: a server of the physics alone takes no pictures");
        }
        let hello = self.hello()?;
        let here = |name: &String| !remote::is_local(name);
        let hello = Hello {
            judges: false,
            action_spaces: vec![ActionSpace::JointPosition],
            tool_delta: None,
            cameras: Vec::new(),
            parameters: hello.parameters.into_iter().filter(here).collect(),
            ..hello
        };
        let Setup { robot, time_step_s: step, .. } = self.setup();
        if robot.settings.gripper.cup().is_some() {
            bail!("{} holds by suction, which has no place behind the bridge without a judge", robot.name());
        }
        let host: Box<dyn Told> = match self.world.engine.as_str() {
            #[cfg(feature = "rapier")]
            "rapier" => {
                Box::new(remote::PhysicsHost::new(RapierEngine::new(robot, step)?, None).map_err(|why| anyhow!(why))?)
            }
            #[cfg(feature = "mujoco")]
            "mujoco" => {
                Box::new(remote::PhysicsHost::new(MujocoEngine::new(robot, step)?, None).map_err(|why| anyhow!(why))?)
            }
            other => bail!("there is no engine `{other}` in this build"),
        };
        Ok(far::PhysicsHost::new(hello, host))
    }

    /// The engine's and robot's part of the provenance.
    pub(crate) fn provenance(&self) -> anyhow::Result<(provenance::Engine, provenance::Robot)> {
        let engine = match &self.pool {
            Some(pool) => far::engine(pool.hello()),
            None => engine(self.build(&self.setup())?.engine)?,
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

/// An engine in this process, as records name it.
fn engine(build: EngineBuild) -> anyhow::Result<provenance::Engine> {
    let build_sha256 = match &build.library {
        Some(path) => {
            let bytes = std::fs::read(path).with_context(|| format!("cannot read {}", path.display()))?;
            Some(hex(&Sha256::digest(bytes)))
        }
        None => None,
    };
    Ok(provenance::Engine { name: build.name.to_owned(), version: Some(build.version), build_sha256 })
}

/// The scenario in which nothing is asked for.
fn nominal() -> Scenario {
    Scenario { index: 0, seed: Seed::campaign(0).episode(0), requested: Assignment::default() }
}

/// A robot by its folder or its name.
fn robot(wanted: &str) -> Result<Robot, RobotError> {
    if is_folder(wanted) { Robot::from_folder(Path::new(wanted)) } else { built_in_robot(wanted) }
}

/// The files of the robot of a recorded run, where they are still those that it ran with.
pub(crate) fn recorded_robot(provenance: &robogate_dictionary::Provenance) -> Option<Vec<RobotFile>> {
    let world: World = serde_json::from_value(provenance.world.clone()).ok()?;
    let files = robot(&world.robot).ok()?.files().ok()?;
    (provenance.robot.sha256.as_ref() == Some(&identity(&files))).then_some(files)
}

/// The identity of a robot by its files.
fn identity(files: &[RobotFile]) -> String {
    robot_sha256(files.iter().map(|(name, bytes)| (name.as_str(), &**bytes)))
}

/// A simulator, and what is known of the engine in it.
struct Built {
    simulator: Box<dyn Simulator>,
    chain: Chain,
    engine: EngineBuild,
}

impl Built {
    fn new<E: Engine + 'static>(
        engine: E,
        suction: SuctionLaw,
        picture_px: usize,
        renderer: Option<Box<dyn Renderer<E>>>,
    ) -> anyhow::Result<Self> {
        let (chain, build) = (engine.chain().clone(), engine.build());
        let mut task = PickPlace::new(engine, None).map_err(|why| anyhow!(why))?;
        if let Some(renderer) = renderer {
            task = task.with_renderer(renderer);
        }
        let simulator = task.with_suction(suction).with_picture_size(picture_px, picture_px);
        Ok(Self { simulator: Box::new(simulator), chain, engine: build })
    }
}

impl Workshop for Cell {
    fn station(&self) -> Result<Station, Fault> {
        let (simulator, scripted) =
            self.make(&self.setup()).map_err(|e| Fault::new(FaultKind::Unavailable, format!("{e:#}")))?;
        let policy = match &self.world.policy {
            Some(guest) => guest.policy()?,
            None => scripted,
        };
        Ok(Station { simulator, policy })
    }
}

impl Workbench for Cell {
    fn setup(&self) -> Setup {
        let mut robot = self.robot.clone();
        if let (Gripper::ParallelJaw(jaw), Some(force)) = (&mut robot.settings.gripper, self.world.grip_force_n) {
            jaw.force_n = force;
        }
        Setup { robot, time_step_s: self.world.time_step_s, suction: self.world.suction.unwrap_or(SuctionLaw::Vacuum) }
    }

    fn bench(&self, setup: &Setup) -> Result<Bench, String> {
        let own = self.setup();
        let fixed = match self.world.simulator {
            None => false,
            Some(Far::Physics) => setup.time_step_s != own.time_step_s,
            Some(Far::Judging) => *setup != own,
        };
        if fixed {
            return Err(
                "a simulator behind a socket keeps its own time step, and one that judges its own robot".to_owned()
            );
        }
        self.make(setup).map_err(|e| format!("{e:#}"))
    }
}
