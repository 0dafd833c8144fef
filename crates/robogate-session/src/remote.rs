//! Remote simulators: their addresses, what they run, and the built-in task in servers that only compute physics.

use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use anyhow::{anyhow, bail};
use robogate_core::{
    Action, Assignment, Command, Ending, Fault, FaultKind, Foresight, Image, Infeasibility, Observation, Scenario,
    Start, Step, TaskSpec,
};
use robogate_dictionary::provenance;
use robogate_physics::{Engine, GripperCommand, Robot};
use robogate_remote::message::{Hello, ObservationMessage, Period, ResetReply};
use robogate_remote::{Host, Listener, Pool, PoolError, RemoteTask, Timeouts};
use robogate_tasks::pick_place::CONTROL_PERIOD_S;
use robogate_tasks::remote::{self as cell_remote, Cell, RemoteArm, RemotePeriod, RemoteReadback, RemoteSight};
use robogate_zmtp::Address;

use crate::environments::{Interpreter, Servers};
use crate::failure::{Failure, OrFailure};
use crate::isolation::SandboxFolders;
use crate::loaded_policy::LoadedPolicy;
use crate::notice::{note, warning};

/// Simulators in other processes.
#[derive(Debug, Clone)]
pub struct Simulators {
    /// Addresses of servers of the bridge protocol that run already. None for a built-in engine, or for an environment that
    /// this process starts.
    pub addresses: Vec<Address>,
    /// Timeout for a step, in seconds. A reset may take four times as long.
    pub timeout_s: f64,
    /// The Python interpreter of an environment that this process starts. `None` for that of `robogate env setup`, otherwise
    /// the active `python3`.
    pub python: Option<PathBuf>,
    /// Whether these processes run in a sandbox. `None` for the choice of the verb: only evidence of others runs in it.
    pub sandbox: Option<bool>,
    /// What the sandbox opens to these processes beside their own files.
    pub sandbox_folders: SandboxFolders,
    /// A policy that the processes of the environment load.
    pub loads: Option<LoadedPolicy>,
    /// The folder to which these processes write the physics of their episodes. `None`: they write none.
    pub probe: Option<PathBuf>,
}

impl Default for Simulators {
    /// No remote simulator.
    fn default() -> Self {
        Self {
            addresses: Vec::new(),
            python: None,
            timeout_s: 30.0,
            sandbox: None,
            sandbox_folders: SandboxFolders::default(),
            loads: None,
            probe: None,
        }
    }
}

impl Simulators {
    /// The timeouts of requests.
    pub fn timeouts(&self) -> Timeouts {
        Timeouts::from_step(Duration::from_secs_f64(self.timeout_s))
    }

    /// Connect to all simulators; `None` without `--simulator`.
    pub fn connect(&self) -> Result<Option<Arc<Pool>>, Failure> {
        if self.addresses.is_empty() {
            return Ok(None);
        }
        Pool::connect(&self.addresses, self.timeouts(), listener()).map(|pool| Some(Arc::new(pool))).map_err(pool_error)
    }

    /// Start the first server of an environment, and connect to it.
    pub fn launch(&self, environment: &str) -> Result<(Arc<Pool>, Arc<Servers>), Failure> {
        let interpreter = Interpreter::choose(self.python.as_deref(), environment).or_request()?;
        let sandboxed = self.sandbox == Some(true);
        let interpreter = match sandboxed {
            true => interpreter.sandboxed(environment, self.loads.as_ref(), &self.sandbox_folders).or_request()?,
            false if self.sandbox_folders.is_empty() => interpreter,
            false => {
                return Err(anyhow!("--sandbox-read and --sandbox-write cannot be used with --sandbox=off"))
                    .or_request();
            }
        };
        let place = if sandboxed { ", in the sandbox" } else { "" };
        note(format_args!("starting {environment} in {}{place}", interpreter.path().display()));
        let (servers, address) = Servers::start(
            environment.to_owned(),
            self.loads.as_ref(),
            self.python.clone(),
            interpreter,
            self.timeouts(),
            self.probe.as_deref(),
        )?;
        let pool = Pool::connect(&[address], self.timeouts(), listener()).map_err(pool_error)?;
        if !pool.hello().deterministic {
            note(format_args!(
                "note: {environment} does not repeat an episode of the same seed and actions, so `robogate replay` differs from the record"
            ));
        }
        let starter = Arc::clone(&servers);
        let pool = pool.with_restart(Box::new(move |position| starter.restart(position)));
        Ok((Arc::new(pool), servers))
    }
}

/// Prints failures of servers.
fn listener() -> Listener {
    Box::new(|failure: &str| warning(failure))
}

/// Gives an error of a pool its kind.
fn pool_error(error: PoolError) -> Failure {
    Failure::broken_if(matches!(error, PoolError::Request { .. }), error)
}

/// Check that a server has this robot.
pub(crate) fn check_robot(hello: &Hello, robot: &Robot, sha256: &str) -> anyhow::Result<()> {
    let name = robot.name();
    let Some(theirs) = &hello.robot else {
        bail!("the simulator declares no robot, but this task needs {name}");
    };
    match &theirs.sha256 {
        Some(other) if other != sha256 => {
            let (short, other) = (sha256.get(..12).unwrap_or(sha256), other.get(..12).unwrap_or(other));
            bail!(
                "the simulator has another robot: its {} has files with the hash {other}..., the {name} of --robot has \
                 {short}...\nHint: start the simulator with the robot folder that --robot names",
                theirs.name
            );
        }
        Some(_) => {}
        None if theirs.name == name => note(format_args!(
            "note: the simulator reports no hash of its robot's files; its {name} is assumed to be the same as --robot {name}"
        )),
        None => bail!("the simulator has the robot {}, but --robot is {name}", theirs.name),
    }
    check_joints(hello, robot).map_err(|why| anyhow!(why))
}

/// Check that a server's arm has the joints of this robot.
fn check_joints(hello: &Hello, robot: &Robot) -> Result<(), String> {
    let ours = &robot.settings.arm.joints;
    match hello.task.action.joints() {
        Some(joints) if joints == ours.as_slice() => Ok(()),
        Some(joints) => Err(format!("its arm has the joints {}; --robot has {}", joints.join(", "), ours.join(", "))),
        None => Err(format!("it takes no joint positions; expected the joints {}", ours.join(", "))),
    }
}

/// The engine in the provenance. The solver is part of the name: two solvers are two simulators.
pub(crate) fn engine(hello: &Hello) -> provenance::Engine {
    let (name, version) = match &hello.engine.solver {
        None => (hello.engine.name.clone(), hello.engine.version.clone()),
        Some(solver) => {
            let word = solver.split([' ', ',']).next().unwrap_or_default();
            (format!("{}/{word}", hello.engine.name), format!("{}, {solver}", hello.engine.version))
        }
    };
    provenance::Engine { name, version: Some(version), build_sha256: hello.engine.sha256.clone() }
}

/// Whether a server has the engine of a recorded run. A run of version 0.2 does not record its build.
pub(crate) fn is_engine(hello: &Hello, recorded: &provenance::Engine) -> bool {
    let mut now = engine(hello);
    now.build_sha256 = now.build_sha256.filter(|_| recorded.build_sha256.is_some());
    now == *recorded
}

/// The built-in task, for servers that compute its physics.
pub struct CellTask(pub(crate) RemoteArm);

impl RemoteTask for CellTask {
    type Cell = Cell;
    type Readback = RemoteReadback;
    type Sample = RemoteSight;

    fn task(&self) -> &Arc<TaskSpec> {
        self.0.task()
    }

    fn foresight(&self) -> Option<Arc<dyn Foresight>> {
        self.0.foresight()
    }

    fn accepts(&self, hello: &Hello) -> Result<(), String> {
        let period_s = hello.task.control_period_s;
        if (period_s - CONTROL_PERIOD_S).abs() > 1e-9 {
            return Err(format!("its control period is {period_s} s; the task requires {CONTROL_PERIOD_S} s"));
        }
        check_joints(hello, self.0.robot())
    }

    fn resolve(&mut self, scenario: &Scenario) -> Result<Cell, Fault> {
        self.0.resolve(scenario)
    }

    fn start(
        &mut self,
        readback: RemoteReadback,
        sample: &RemoteSight,
        observation: &Observation,
    ) -> Result<Start, Fault> {
        self.0.start(readback, sample, observation)
    }

    fn command(&mut self, action: &Action) -> Result<(Vec<f64>, Option<usize>), Fault> {
        self.0.command(action)
    }

    fn score(
        &mut self,
        samples: &[RemoteSight],
        observation: &Observation,
        clearance_m: Option<f64>,
        state_hash: u64,
    ) -> Result<Step, Fault> {
        self.0.finish(samples, observation, clearance_m, state_hash)
    }

    fn foregone_ending(&self) -> Option<Ending> {
        self.0.foregone_ending()
    }

    fn infeasibility(&self, requested: &Assignment) -> Option<Infeasibility> {
        self.0.infeasibility(requested)
    }

    fn render(&mut self) -> Result<Vec<Image>, Fault> {
        self.0.render()
    }
}

/// A built-in engine as a server that only computes physics.
pub struct PhysicsHost {
    hello: Hello,
    engine: cell_remote::PhysicsHost<Box<dyn Engine>>,
}

impl PhysicsHost {
    /// A server with this hello on this engine.
    pub fn new(hello: Hello, engine: cell_remote::PhysicsHost<Box<dyn Engine>>) -> Self {
        Self { hello, engine }
    }
}

impl Host for PhysicsHost {
    type Cell = Cell;
    type Readback = RemoteReadback;
    type Sample = RemoteSight;

    fn hello(&self) -> &Hello {
        &self.hello
    }

    fn reset(&mut self, _: &Scenario, cell: Option<Cell>) -> Result<ResetReply<RemoteReadback, RemoteSight>, Fault> {
        let cell = cell.ok_or_else(|| Fault::new(FaultKind::Setup, "no cell"))?;
        let (readback, sample, observation) = self.engine.reset(&cell)?;
        Ok(ResetReply {
            observation: ObservationMessage::from(&observation),
            instance: None,
            applied: None,
            draws: None,
            readback: Some(readback),
            sample: Some(sample),
            proposed: None,
        })
    }

    fn select(&mut self, object: usize) {
        self.engine.select(object);
    }

    fn step(&mut self, action: &Action) -> Result<Period<RemoteSight>, Fault> {
        let Command::JointPosition(joints) = &action.command else {
            return Err(Fault::new(FaultKind::BadAction, "expected joint positions"));
        };
        let RemotePeriod { observation, state_hash, sights, clearance_m } =
            self.engine.step(joints, GripperCommand::of(action))?;
        Ok(Period {
            foregone: None,
            observation: ObservationMessage::from(&observation),
            state_hash,
            measures: None,
            ending: None,
            events: None,
            samples: Some(sights),
            clearance_m,
            proposed: None,
        })
    }

    fn render(&mut self) -> Result<Vec<Image>, Fault> {
        Err(Fault::new(FaultKind::Setup, "this simulator has no cameras"))
    }
}
