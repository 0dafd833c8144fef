//! Simulators behind a socket: where they are, what they run, and our world in them.

use std::sync::Arc;
use std::time::Duration;

use anyhow::{anyhow, bail};
use clap::Args;
use robogate_bridge::simulator::message::{Begun, Hello, Period, Seen};
use robogate_bridge::simulator::{Host, NoWorld, Patience, Pool, PoolError, Remote, World};
use robogate_bridge::zmtp::Address;
use robogate_core::{
    Action, ArmCommand, Fault, FaultKind, GripperCommand, Image, Observation, Scenario, Simulator, Start, Step,
};
use robogate_dictionary::provenance;
use robogate_physics::{Chain, Engine, Robot};
use robogate_tasks::pick_place::CONTROL_PERIOD_S;
use robogate_tasks::pick_place::remote::{self, Cell, RemotePeriod, RemotePickPlace, RemoteReadback, RemoteSight};
use serde::{Deserialize, Serialize};

use crate::exit::{Exit, INFRASTRUCTURE, USAGE};
use crate::terminal::note;

/// What a simulator behind a socket is to a run. Where it is has no part in the results and is not recorded.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum Far {
    /// It has a world and a task of its own.
    Judging,
    /// It is physics for ours.
    Physics,
}

/// Simulators behind a socket, on the command line.
#[derive(Debug, Clone, Args)]
pub(crate) struct Simulators {
    /// Simulators that speak the bridge protocol, in place of an engine: tcp://HOST:PORT, several with commas between
    /// them
    #[arg(long = "simulator", value_name = "ADDRESSES", value_delimiter = ',')]
    pub(crate) addresses: Vec<Address>,
    /// How long such a simulator may take for a step, in seconds
    #[arg(long = "simulator-timeout", value_name = "SECONDS", default_value_t = 30.0, value_parser = seconds)]
    timeout_s: f64,
}

/// A time that makes sense as a deadline.
fn seconds(text: &str) -> Result<f64, String> {
    let seconds: f64 = text.parse().map_err(|_| format!("`{text}` is no number"))?;
    if (1e-3..=86_400.0).contains(&seconds) { Ok(seconds) } else { Err("0.001 to 86400 seconds make sense".to_owned()) }
}

impl Simulators {
    /// The deadlines that are kept.
    pub(crate) fn patience(&self) -> Patience {
        Patience::of(Duration::from_secs_f64(self.timeout_s))
    }

    /// Connects to all of them; `None` where none is named.
    pub(crate) fn connect(&self) -> Result<Option<Arc<Pool>>, Exit> {
        if self.addresses.is_empty() {
            return Ok(None);
        }
        let listener = Box::new(|trouble: &str| note(format_args!("warning: {trouble}")));
        match Pool::connect(&self.addresses, self.patience(), listener) {
            Ok(pool) => Ok(Some(Arc::new(pool))),
            Err(why @ PoolError::Ask { .. }) => Err(Exit { code: INFRASTRUCTURE, error: why.into() }),
            Err(why) => Err(Exit { code: USAGE, error: why.into() }),
        }
    }
}

/// Whether a simulator has this robot, and runs at our rates where the world is ours.
pub(crate) fn check(hello: &Hello, robot: &Robot, sha256: &str) -> anyhow::Result<()> {
    let name = robot.name();
    match &hello.robot.sha256 {
        Some(theirs) if theirs != sha256 => {
            let (short, other) = (sha256.get(..12).unwrap_or(sha256), theirs.get(..12).unwrap_or(theirs));
            bail!(
                "the simulator has another robot: its {} has the files {other}..., our {name} has {short}...\n  \
                 hint: --robot names ours; start the simulator with the same folder",
                hello.robot.name
            );
        }
        Some(_) => {}
        None if hello.robot.name == name => note(format_args!(
            "note: the simulator says nothing of its robot's files; it is taken for {name} by its name"
        )),
        None => bail!("the simulator has the robot {}, and --robot is {name}", hello.robot.name),
    }
    if hello.joints != robot.settings.arm.joints {
        let ours = robot.settings.arm.joints.join(", ");
        bail!("the simulator's arm has the joints {}; ours has {ours}", hello.joints.join(", "));
    }
    Ok(())
}

/// The engine's part of the provenance. A solver is part of its name: two of them are two simulators.
pub(crate) fn engine(hello: &Hello) -> provenance::Engine {
    let (name, version) = match &hello.engine.solver {
        None => (hello.engine.name.clone(), hello.engine.version.clone()),
        Some(solver) => {
            let word = solver.split([' ', ',']).next().unwrap_or_default();
            (format!("{}/{word}", hello.engine.name), format!("{}, {solver}", hello.engine.version))
        }
    };
    provenance::Engine { name, version: Some(version), build_sha256: None }
}

/// A simulator in these servers for this robot.
pub(crate) fn simulator(
    pool: &Arc<Pool>,
    robot: &Robot,
    chain: Chain,
    sha256: String,
    picture_px: usize,
) -> anyhow::Result<Box<dyn Simulator>> {
    let pool = Arc::clone(pool);
    Ok(if pool.hello().judges {
        Box::new(Remote::<NoWorld>::new(pool, None).map_err(|why| anyhow!(why))?)
    } else {
        let ours = OurWorld::new(robot, chain, sha256, picture_px)?;
        Box::new(Remote::new(pool, Some(ours)).map_err(|why| anyhow!(why))?)
    })
}

/// Our world for servers that do not judge.
pub(crate) struct OurWorld(RemotePickPlace);

impl OurWorld {
    pub(crate) fn new(robot: &Robot, chain: Chain, sha256: String, picture_px: usize) -> anyhow::Result<Self> {
        let offsite = RemotePickPlace::new(robot.clone(), chain, Some(sha256), None).map_err(|why| anyhow!(why))?;
        Ok(Self(offsite.with_picture_size(picture_px, picture_px)))
    }
}

impl World for OurWorld {
    type Cell = Cell;
    type Readback = RemoteReadback;
    type Sight = RemoteSight;

    fn accepts(&self, hello: &Hello) -> Result<(), String> {
        if (hello.control_period_s - CONTROL_PERIOD_S).abs() > 1e-9 {
            return Err(format!("its control period is {} s; ours is {CONTROL_PERIOD_S} s", hello.control_period_s));
        }
        if hello.joints != self.0.robot().settings.arm.joints {
            return Err("its arm has other joints".to_owned());
        }
        Ok(())
    }

    fn acts_here(&self, parameter: &str) -> bool {
        remote::is_local(parameter)
    }

    fn brief(&mut self, scenario: &Scenario) -> Result<Cell, Fault> {
        self.0.resolve(scenario)
    }

    fn start(&mut self, held: RemoteReadback, sight: &RemoteSight, observation: &Observation) -> Result<Start, Fault> {
        self.0.start(held, sight, observation)
    }

    fn command(&mut self, action: &Action) -> Result<Vec<f64>, Fault> {
        self.0.command(action)
    }

    fn finish(
        &mut self,
        sights: &[RemoteSight],
        observation: &Observation,
        clearance_m: Option<f64>,
        state_hash: u64,
    ) -> Result<Step, Fault> {
        self.0.finish(sights, observation, clearance_m, state_hash)
    }

    fn render(&mut self) -> Result<Vec<Image>, Fault> {
        self.0.render()
    }
}

/// An engine of ours that is told and reports, whichever it is.
pub(crate) trait Told {
    fn reset(&mut self, scenario: &Scenario) -> Result<(RemoteReadback, RemoteSight, Observation), Fault>;
    fn step(&mut self, joints: &[f64], told: GripperCommand) -> Result<RemotePeriod, Fault>;
}

impl<E: Engine> Told for remote::PhysicsHost<E> {
    fn reset(&mut self, scenario: &Scenario) -> Result<(RemoteReadback, RemoteSight, Observation), Fault> {
        remote::PhysicsHost::reset(self, scenario)
    }

    fn step(&mut self, joints: &[f64], told: GripperCommand) -> Result<RemotePeriod, Fault> {
        remote::PhysicsHost::step(self, joints, told)
    }
}

/// An engine of ours as a server that does not judge.
pub(crate) struct PhysicsHost {
    hello: Hello,
    engine: Box<dyn Told>,
}

impl PhysicsHost {
    pub(crate) fn new(hello: Hello, engine: Box<dyn Told>) -> Self {
        Self { hello, engine }
    }
}

impl Host for PhysicsHost {
    type Readback = RemoteReadback;
    type Sight = RemoteSight;

    fn hello(&self) -> &Hello {
        &self.hello
    }

    fn reset(&mut self, scenario: &Scenario) -> Result<Begun<RemoteReadback, RemoteSight>, Fault> {
        let (held, sight, observation) = self.engine.reset(scenario)?;
        Ok(Begun {
            observation: Seen::from(&observation),
            task: None,
            applied: None,
            readback: Some(held),
            sight: Some(sight),
        })
    }

    fn step(&mut self, arm: ArmCommand, gripper: GripperCommand) -> Result<Period<RemoteSight>, Fault> {
        let ArmCommand::JointPositions(joints) = arm else {
            return Err(Fault::new(FaultKind::BadAction, "joint positions were due"));
        };
        let RemotePeriod { observation, state_hash, sights, clearance_m } = self.engine.step(&joints, gripper)?;
        Ok(Period {
            observation: Seen::from(&observation),
            state_hash,
            measures: None,
            ending: None,
            events: None,
            sights: Some(sights),
            clearance_m,
        })
    }

    fn render(&mut self) -> Result<Vec<Image>, Fault> {
        Err(Fault::new(FaultKind::Setup, "this simulator has no cameras"))
    }
}
