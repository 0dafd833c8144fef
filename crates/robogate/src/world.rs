//! From settings to a cell: the robot, the engine under it and the scripted controller.

use std::path::Path;

use anyhow::{Context, anyhow, bail};
use clap::Args;
use robogate_campaign::{Station, Workshop};
use robogate_core::{Assignment, Fault, FaultKind, ParameterSpace, Policy, Scenario, Seed, Simulator, Suite};
use robogate_dictionary::{hex, provenance, robot_sha256};
#[cfg(feature = "mujoco")]
use robogate_sim::MujocoEngine;
#[cfg(feature = "rapier")]
use robogate_sim::RapierEngine;
use robogate_sim::camera::SIZE_PX;
use robogate_sim::claims::{Bench, Setup, Workbench};
use robogate_sim::{
    Chain, Engine, EngineBuild, Gripper, PickPlace, Robot, RobotError, RobotFile, SceneParameters, Scripted,
    SuctionLaw, WORKSPACE_CENTRE, built_in_robot, built_in_space, built_in_spaces, check_suite, default_space,
    is_folder,
};
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

/// The engines of this build by name, each with its own time step in seconds; the first is the default.
const ENGINES: &[(&str, f64)] = &[
    #[cfg(feature = "mujoco")]
    ("mujoco", MujocoEngine::TIME_STEP_S),
    #[cfg(feature = "rapier")]
    ("rapier", RapierEngine::TIME_STEP_S),
];

const _: () = assert!(!ENGINES.is_empty(), "a build needs an engine: --features mujoco, rapier or both");

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
}

/// The world, on the command line.
#[derive(Debug, Args)]
pub(crate) struct WorldArguments {
    /// A built-in robot (robogate robots), or the folder of your own
    #[arg(long, value_name = "R", default_value = "franka")]
    robot: String,
    /// The physics engine: mujoco or rapier
    #[arg(long, value_name = "E", default_value = ENGINES[0].0)]
    engine: String,
    /// The engine's time step in seconds; default: the engine's own
    #[arg(long, value_name = "SECONDS")]
    time_step: Option<f64>,
    /// Normal force of each gripper pad in newtons; default: the robot's own
    #[arg(long, value_name = "NEWTONS")]
    grip_force: Option<f64>,
    /// What holds an object at a suction cup: surface (a joint that never breaks, the paper's) or vacuum (pressure and
    /// friction, up to their limits); default: surface for the paper preset, vacuum otherwise
    #[arg(long, value_name = "LAW")]
    suction: Option<SuctionLaw>,
}

impl WorldArguments {
    /// The world that they name.
    pub(crate) fn world(&self) -> World {
        World {
            robot: absolute(&self.robot),
            engine: self.engine.clone(),
            time_step_s: self.time_step.unwrap_or_else(|| time_step(&self.engine)),
            grip_force_n: self.grip_force,
            suction: self.suction,
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
    /// Pixels along each side of the cameras' pictures.
    picture_px: usize,
}

impl Cell {
    /// Reads the robot and tries the cell out once, so that what is wrong is said before anything starts.
    ///
    /// A suction cup holds by `suction` where the world does not say.
    pub(crate) fn new(mut world: World, suction: SuctionLaw) -> anyhow::Result<Self> {
        if !ENGINES.iter().any(|(name, _)| *name == world.engine) {
            let known = ENGINES.iter().map(|(name, _)| *name).collect::<Vec<_>>().join(" and ");
            bail!("there is no engine `{}` in this build; it has {known}", world.engine);
        }
        let robot = robot(&world.robot)?;
        match (robot.settings.gripper.cup(), world.suction) {
            (Some(_), law) => world.suction = Some(law.unwrap_or(suction)),
            (None, Some(law)) => {
                let (name, gripper) = (robot.name(), robot.settings.gripper.words());
                bail!("--suction {law} is for a suction cup: the gripper of {name} is {gripper}");
            }
            (None, None) => {}
        }
        if let (Some(_), Some(force)) = (robot.settings.gripper.cup(), world.grip_force_n) {
            bail!("--grip-force {force} is for fingers: the gripper of {} is a suction cup", robot.name());
        }
        let cell = Self { world, robot, picture_px: SIZE_PX };
        let mut built = cell.build(&cell.setup())?;
        let nominal = Scenario { index: 0, seed: Seed::campaign(0).episode(0), requested: Assignment::default() };
        built.simulator.reset(&nominal).context("the robot cannot be set up in the cell")?;
        Ok(cell)
    }

    /// The same cell, its cameras' pictures so many pixels wide and high.
    pub(crate) fn with_pictures_of(self, picture_px: usize) -> Self {
        Self { picture_px, ..self }
    }

    /// The cell of a recorded run.
    pub(crate) fn recorded(provenance: &robogate_dictionary::Provenance) -> anyhow::Result<Self> {
        let world = serde_json::from_value(provenance.world.clone())
            .context("the run's plan.json says nothing useful under provenance.world")?;
        // Runs of robots with a cup all say by which law it holds.
        Self::new(world, SuctionLaw::Vacuum)
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
        SceneParameters::check_space(&space, Some(gripper)).with_context(|| format!("space {}", space.name()))?;
        Ok(space)
    }

    /// Whether the gripper has every parameter that a suite asks for.
    pub(crate) fn check_suite(&self, suite: &Suite) -> anyhow::Result<()> {
        match check_suite(suite, Some(&self.robot.settings.gripper)).first() {
            Some(misfit) => bail!("suite {}: {misfit}", suite.name()),
            None => Ok(()),
        }
    }

    /// The world that it is in.
    pub(crate) fn world(&self) -> &World {
        &self.world
    }

    fn build(&self, setup: &Setup) -> anyhow::Result<Built> {
        let (robot, step) = (setup.robot.clone(), setup.time_step_s);
        match self.world.engine.as_str() {
            #[cfg(feature = "mujoco")]
            "mujoco" => Built::new(MujocoEngine::new(robot, step)?, setup.suction, self.picture_px),
            #[cfg(feature = "rapier")]
            "rapier" => Built::new(RapierEngine::new(robot, step)?, setup.suction, self.picture_px),
            other => bail!("there is no engine `{other}` in this build"),
        }
    }

    fn make(&self, setup: &Setup) -> anyhow::Result<(Box<dyn Simulator>, Box<dyn Policy>)> {
        let Built { simulator, chain, .. } = self.build(setup)?;
        Ok((simulator, Box::new(Scripted::new(setup.robot.clone(), chain))))
    }

    /// The engine's and robot's part of the provenance.
    pub(crate) fn provenance(&self) -> anyhow::Result<(provenance::Engine, provenance::Robot)> {
        let build = self.build(&self.setup())?.engine;
        let build_sha256 = match &build.library {
            Some(path) => {
                let bytes = std::fs::read(path).with_context(|| format!("cannot read {}", path.display()))?;
                Some(hex(&Sha256::digest(bytes)))
            }
            None => None,
        };
        let engine = provenance::Engine { name: build.name.to_owned(), version: Some(build.version), build_sha256 };
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
    fn new<E: Engine + 'static>(engine: E, suction: SuctionLaw, picture_px: usize) -> anyhow::Result<Self> {
        let (chain, build) = (engine.chain().clone(), engine.build());
        let task = PickPlace::new(engine, None).map_err(|why| anyhow!(why))?;
        let simulator = task.with_suction(suction).with_picture_size(picture_px, picture_px);
        Ok(Self { simulator: Box::new(simulator), chain, engine: build })
    }
}

impl Workshop for Cell {
    fn station(&self) -> Result<Station, Fault> {
        let (simulator, policy) =
            self.make(&self.setup()).map_err(|e| Fault::new(FaultKind::Unavailable, format!("{e:#}")))?;
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
        self.make(setup).map_err(|e| format!("{e:#}"))
    }
}
