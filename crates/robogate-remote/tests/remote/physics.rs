//! A task of this process whose physics is computed by a server.

use std::sync::Arc;
use std::time::Duration;

use robogate_core::{
    Action, Assignment, Command, Ending, Environment, Fault, FaultKind, Image, Measures, Observation, Outcome,
    Scenario, Start, Step, TaskInstance, TaskSpec, Value, rollout,
};
use robogate_remote::conformance::check;
use robogate_remote::message::{Hello, ObservationMessage, Period, ResetReply};
use robogate_remote::{Host, PhysicsSession, Pool, RemoteEnvironment, RemotePhysics, RemoteTask, Timeouts};

use crate::server::{Running, in_steps, unchanged};
use crate::toy::{Creep, PERIOD, hello, joint_positions, scenario, task};

/// Time steps in a control period.
const STEPS: usize = 5;

/// Joints that reach any commanded position immediately. A sample is the sum of their positions and of the number of the
/// object that the gripper acts on.
struct ToyPhysics {
    hello: Hello,
    joints: Vec<f64>,
    tick: u32,
    object: usize,
}

fn physics_hello() -> Hello {
    let mut hello = Hello { time_step_s: Some(PERIOD / STEPS as f64), scores_itself: false, ..hello() };
    let task = &mut hello.task;
    task.action.spaces.truncate(1);
    task.observation.cameras.clear();
    task.observation.vectors.truncate(1);
    task.measures.clear();
    task.failure_modes.clear();
    task.parameters.clear();
    hello
}

impl ToyPhysics {
    fn new() -> Self {
        Self { hello: physics_hello(), joints: vec![0.0; 3], tick: 0, object: 0 }
    }

    fn observation(&self) -> ObservationMessage {
        ObservationMessage {
            time_s: f64::from(self.tick) * PERIOD,
            vectors: [("joint_positions".to_owned(), self.joints.clone())].into(),
        }
    }
}

impl Host for ToyPhysics {
    /// The mass of the object.
    type Cell = f64;
    type Readback = f64;
    type Sample = f64;

    fn hello(&self) -> &Hello {
        &self.hello
    }

    fn reset(&mut self, _: &Scenario, cell: Option<f64>) -> Result<ResetReply<f64, f64>, Fault> {
        (self.joints, self.tick, self.object) = (vec![0.0; 3], 0, 0);
        let (readback, sample) = (cell, Some(0.0));
        Ok(ResetReply {
            observation: self.observation(),
            instance: None,
            applied: None,
            draws: None,
            readback,
            sample,
            proposed: None,
        })
    }

    fn select(&mut self, object: usize) {
        self.object = object;
    }

    fn step(&mut self, action: &Action) -> Result<Period<f64>, Fault> {
        let Command::JointPosition(joints) = &action.command else {
            return Err(Fault::new(FaultKind::BadAction, "expected joint positions"));
        };
        self.joints.clone_from(joints);
        self.tick += 1;
        Ok(Period {
            foregone: None,
            observation: self.observation(),
            state_hash: self.joints.iter().fold(0, |hash, q| hash ^ q.to_bits()),
            measures: None,
            ending: None,
            events: None,
            samples: Some(vec![self.joints.iter().sum::<f64>() + self.object as f64; STEPS]),
            clearance_m: None,
            proposed: None,
        })
    }

    fn render(&mut self) -> Result<Vec<Image>, Fault> {
        Err(Fault::new(FaultKind::Setup, "this simulator has no cameras"))
    }
}

/// Succeeds when the sum of the joint positions exceeds 0.16 rad.
struct Reach(Arc<TaskSpec>);

fn reach() -> Reach {
    let mut task = task();
    task.observation.vectors.truncate(1);
    Reach(Arc::new(task))
}

impl RemoteTask for Reach {
    type Cell = f64;
    type Readback = f64;
    type Sample = f64;

    fn task(&self) -> &Arc<TaskSpec> {
        &self.0
    }

    fn accepts(&self, hello: &Hello) -> Result<(), String> {
        match hello.task.action.joints() {
            Some([_, _, _]) => Ok(()),
            _ => Err("expected three joints".to_owned()),
        }
    }

    fn resolve(&mut self, scenario: &Scenario) -> Result<f64, Fault> {
        Ok(scenario.requested.number("mass_kg").unwrap_or(1.0))
    }

    fn start(&mut self, readback: f64, _: &f64, observation: &Observation) -> Result<Start, Fault> {
        let mut applied = Assignment::default();
        applied.set("shape", Value::Category("box".into()));
        applied.set("mass_kg", Value::Number(readback));
        Ok(Start { instance: TaskInstance::default(), observation: observation.clone(), applied })
    }

    fn command(&mut self, action: &Action) -> Result<(Vec<f64>, Option<usize>), Fault> {
        match &action.command {
            Command::JointPosition(joints) => {
                // A gripper that closes at home acts on another object.
                let chooses = action.gripper > Some(0.0) && joints.iter().all(|q| q.abs() < 1e-9);
                Ok((joints.clone(), chooses.then_some(1)))
            }
            _ => Err(Fault::new(FaultKind::BadAction, "expected joint positions")),
        }
    }

    fn score(
        &mut self,
        samples: &[f64],
        observation: &Observation,
        _: Option<f64>,
        state_hash: u64,
    ) -> Result<Step, Fault> {
        let reached = samples.iter().any(|sum| *sum > 0.16);
        let ending = reached.then_some(Ending { failure: None, time_s: observation.time_s, contact: None });
        Ok(Step {
            observation: observation.clone(),
            measures: Measures::default(),
            ending,
            events: Vec::new(),
            state_hash,
        })
    }

    fn render(&mut self) -> Result<Vec<Image>, Fault> {
        let image = |name: &str| Image { camera: name.to_owned(), width: 1, height: 1, rgb: vec![0; 3] };
        Ok(vec![image("front")])
    }
}

fn pool(server: &Running) -> Arc<Pool> {
    let address = server.address.clone();
    let timeouts = Timeouts::from_step(Duration::from_secs(5));
    Arc::new(Pool::connect(&[address], timeouts, Box::new(|_| {})).unwrap())
}

#[test]
fn tasks_score_reported_physics() {
    let server = Running::start_host(ToyPhysics::new, unchanged);
    let mut simulator = RemotePhysics::new(pool(&server), reach()).unwrap();
    for index in 0..3 {
        let episode = rollout(&mut simulator, &mut Creep::default(), &scenario(index));
        assert_eq!(episode.outcome, Outcome::Success);
        // Each of three joints moves 0.01 rad per control period, so the sum exceeds 0.16 rad after six periods.
        assert!((episode.time_s - 6.0 * PERIOD).abs() < 1e-9, "{}", episode.time_s);
    }
}

/// A gripper that closes at home chooses object 1, whose number is part of the samples.
#[test]
fn tasks_choose_the_object() {
    let server = Running::start_host(ToyPhysics::new, unchanged);
    let mut simulator = RemotePhysics::new(pool(&server), reach()).unwrap();
    simulator.reset(&scenario(0)).unwrap();
    assert_eq!(simulator.step(&joint_positions(vec![0.0; 3], Action::OPEN)).unwrap().ending, None);
    assert!(simulator.step(&joint_positions(vec![0.0; 3], Action::CLOSE)).unwrap().ending.is_some());
}

#[test]
fn physics_server_conforms() {
    let server = Running::start_host(ToyPhysics::new, unchanged);
    let scenarios: Vec<Scenario> = (0..2).map(scenario).collect();
    let timeouts = Timeouts::from_step(Duration::from_secs(5));
    let report = check(&server.address, timeouts, &scenarios, &mut PhysicsSession(reach())).unwrap();
    assert!(report.passed(), "{:?}", report.results);
}

#[test]
fn missing_samples_are_violations() {
    let server = Running::start_host(ToyPhysics::new, |_, request, reply| {
        Some(in_steps::<f64>(request, reply, |reply| {
            reply.steps[0].samples.as_mut().unwrap().pop();
        }))
    });
    let mut simulator = RemotePhysics::new(pool(&server), reach()).unwrap();
    simulator.reset(&scenario(0)).unwrap();
    let fault = simulator.step(&joint_positions(vec![0.0; 3], Action::OPEN)).unwrap_err();
    assert!(fault.detail.contains("4 entries in `sights`; expected 5"), "{fault}");
}

#[test]
fn server_kind_must_match() {
    let (physics, scored) = (Running::start_host(ToyPhysics::new, unchanged), Running::start(hello(), unchanged));
    let why = RemoteEnvironment::new(pool(&physics)).err().unwrap().to_string();
    assert!(why.contains("does not score itself"), "{why}");
    let why = RemotePhysics::new(pool(&scored), reach()).err().unwrap().to_string();
    assert!(why.contains("scores itself"), "{why}");
}
