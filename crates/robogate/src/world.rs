//! From settings to a cell: the robot, the engine under it and the scripted controller.

use std::path::Path;

use anyhow::{Context, anyhow, bail};
use clap::Args;
use robogate_campaign::{Station, Workshop};
use robogate_core::{Assignment, Fault, FaultKind, Policy, Scenario, Seed, Simulator};
use robogate_dictionary::provenance;
use robogate_sim::claims::{Bench, Workbench};
use robogate_sim::{Engine, Gripper, MujocoEngine, PickPlace, Robot, Scripted, built_in_robot};
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

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
}

/// The world, on the command line.
#[derive(Debug, Args)]
pub(crate) struct WorldArguments {
    /// A built-in robot (franka), or the folder of your own
    #[arg(long, value_name = "R", default_value = "franka")]
    robot: String,
    /// The physics engine
    #[arg(long, value_name = "E", default_value = "mujoco")]
    engine: String,
    /// The engine's time step in seconds; default: the engine's own
    #[arg(long, value_name = "SECONDS")]
    time_step: Option<f64>,
    /// Normal force of each gripper pad in newtons; default: the robot's own
    #[arg(long, value_name = "NEWTONS")]
    grip_force: Option<f64>,
}

impl WorldArguments {
    /// The world that they name.
    pub(crate) fn world(&self) -> World {
        World {
            robot: absolute(&self.robot),
            engine: self.engine.clone(),
            time_step_s: self.time_step.unwrap_or(MujocoEngine::TIME_STEP_S),
            grip_force_n: self.grip_force,
        }
    }
}

/// A robot's folder by its full path, so that a run can be resumed from anywhere; a name as it is.
fn absolute(robot: &str) -> String {
    let path = Path::new(robot);
    let full = if path.is_dir() { path.canonicalize().ok() } else { None };
    full.map_or_else(|| robot.to_owned(), |path| path.to_string_lossy().into_owned())
}

/// A cell that can be set up again and again, one for each thread.
pub(crate) struct Cell {
    world: World,
    robot: Robot,
}

impl Cell {
    /// Reads the robot and tries the cell out once, so that what is wrong is said before anything starts.
    pub(crate) fn new(world: World) -> anyhow::Result<Self> {
        if world.engine != "mujoco" {
            bail!("there is no engine `{}`; there is mujoco", world.engine);
        }
        let robot = match Path::new(&world.robot) {
            folder if folder.is_dir() => Robot::from_folder(folder),
            _ => built_in_robot(&world.robot),
        }?;
        let cell = Self { world, robot };
        let mut simulator = cell.simulator(cell.world.time_step_s, cell.world.grip_force_n)?;
        let nominal = Scenario { index: 0, seed: Seed::campaign(0).episode(0), requested: Assignment::default() };
        simulator.reset(&nominal).context("the robot cannot be set up in the cell")?;
        Ok(cell)
    }

    /// The cell of a recorded run.
    pub(crate) fn recorded(provenance: &robogate_dictionary::Provenance) -> anyhow::Result<Self> {
        let world = serde_json::from_value(provenance.world.clone())
            .context("the run's plan.json says nothing useful under provenance.world")?;
        Self::new(world)
    }

    /// The world that it is in.
    pub(crate) fn world(&self) -> &World {
        &self.world
    }

    fn simulator(&self, time_step: f64, grip_force: Option<f64>) -> anyhow::Result<PickPlace<MujocoEngine>> {
        let engine = MujocoEngine::new(self.robot.clone(), time_step)?;
        PickPlace::new(engine, grip_force).map_err(|why| anyhow!(why))
    }

    fn make(&self, time_step: f64, grip_force: Option<f64>) -> anyhow::Result<(Box<dyn Simulator>, Box<dyn Policy>)> {
        let simulator = self.simulator(time_step, grip_force)?;
        let policy = Scripted::new(self.robot.clone(), simulator.engine().chain().clone());
        Ok((Box::new(simulator), Box::new(policy)))
    }

    /// The engine's and robot's part of the provenance.
    pub(crate) fn provenance(&self) -> anyhow::Result<(provenance::Engine, provenance::Robot)> {
        let build = self.simulator(self.world.time_step_s, self.world.grip_force_n)?.engine().build();
        let build_sha256 = match &build.library {
            Some(path) => {
                let bytes = std::fs::read(path).with_context(|| format!("cannot read {}", path.display()))?;
                Some(hex(&Sha256::digest(bytes)))
            }
            None => None,
        };
        let engine = provenance::Engine { name: build.name.to_owned(), version: Some(build.version), build_sha256 };
        let mut hash = Sha256::new();
        for (name, bytes) in self.robot.files()? {
            // Lengths before contents: no two folders have the same stream.
            hash.update((name.len() as u64).to_le_bytes());
            hash.update(name.as_bytes());
            hash.update((bytes.len() as u64).to_le_bytes());
            hash.update(&bytes);
        }
        let robot = provenance::Robot { name: self.robot.name().to_owned(), sha256: Some(hex(&hash.finalize())) };
        Ok((engine, robot))
    }
}

fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

impl Workshop for Cell {
    fn station(&self) -> Result<Station, Fault> {
        let (simulator, policy) = self
            .make(self.world.time_step_s, self.world.grip_force_n)
            .map_err(|e| Fault::new(FaultKind::Unavailable, format!("{e:#}")))?;
        Ok(Station { simulator, policy })
    }
}

impl Workbench for Cell {
    fn bench(&self, time_step_s: Option<f64>, grip_force_n: Option<f64>) -> Result<Bench, String> {
        let step = time_step_s.unwrap_or(self.world.time_step_s);
        self.make(step, grip_force_n.or(self.world.grip_force_n)).map_err(|e| format!("{e:#}"))
    }

    fn time_step_s(&self) -> f64 {
        self.world.time_step_s
    }

    fn opening_m(&self) -> f64 {
        let Gripper::ParallelJaw { opening_m, .. } = &self.robot.settings.gripper;
        *opening_m
    }

    fn force_limit_n(&self) -> f64 {
        let Gripper::ParallelJaw { force_limit_n, .. } = &self.robot.settings.gripper;
        *force_limit_n
    }

    fn joint_limits(&self) -> (Vec<f64>, Vec<f64>) {
        let arm = &self.robot.settings.arm;
        (arm.velocity_limit_rad_s.clone(), arm.acceleration_limit_rad_s2.clone())
    }
}
