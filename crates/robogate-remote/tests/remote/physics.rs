//! A task of this process whose physics is computed by a server.

use std::sync::Arc;
use std::time::Duration;

use robogate_core::{
    Action, ArmCommand, Assignment, Ending, Fault, FaultKind, GripperCommand, Image, Measures, Observation, Outcome,
    Pose, Scenario, Simulator, Start, Step, TaskSpec, Value, rollout,
};
use robogate_remote::conformance::check;
use robogate_remote::message::{ActionSpace, Hello, ObservationMessage, Period, ResetReply};
use robogate_remote::{Host, PhysicsSession, Pool, RemoteEnvironment, RemotePhysics, RemoteTask, Timeouts};

use crate::server::{Running, in_steps, unchanged};
use crate::toy::{Creep, PERIOD, hello, scenario};

/// Time steps in a control period.
const STEPS: usize = 5;

/// Joints that reach any commanded position immediately. A sample is the sum of their positions.
struct ToyPhysics {
    hello: Hello,
    joints: Vec<f64>,
    tick: u32,
}

fn physics_hello() -> Hello {
    Hello {
        time_step_s: PERIOD / STEPS as f64,
        action_spaces: vec![ActionSpace::JointPosition],
        tool_delta: None,
        cameras: Vec::new(),
        parameters: vec!["mass_kg".to_owned()],
        scores_itself: false,
        ..hello()
    }
}

impl ToyPhysics {
    fn new() -> Self {
        Self { hello: physics_hello(), joints: vec![0.0; 3], tick: 0 }
    }

    fn observation(&self) -> ObservationMessage {
        ObservationMessage {
            time_s: f64::from(self.tick) * PERIOD,
            joint_positions: self.joints.clone(),
            joint_velocities: vec![0.0; 3],
            gripper_opening_m: None,
            tool_pose: Pose::IDENTITY,
        }
    }
}

impl Host for ToyPhysics {
    type Readback = f64;
    type Sample = f64;

    fn hello(&self) -> &Hello {
        &self.hello
    }

    fn reset(&mut self, scenario: &Scenario) -> Result<ResetReply<f64, f64>, Fault> {
        (self.joints, self.tick) = (vec![0.0; 3], 0);
        let mass = scenario.requested.number("mass_kg").unwrap_or(1.0);
        let (readback, sample) = (Some(mass), Some(0.0));
        Ok(ResetReply { observation: self.observation(), task: None, applied: None, readback, sample })
    }

    fn step(&mut self, arm: ArmCommand, _: GripperCommand) -> Result<Period<f64>, Fault> {
        let ArmCommand::JointPositions(joints) = arm else {
            return Err(Fault::new(FaultKind::BadAction, "expected joint positions"));
        };
        self.joints = joints;
        self.tick += 1;
        Ok(Period {
            observation: self.observation(),
            state_hash: self.joints.iter().fold(0, |hash, q| hash ^ q.to_bits()),
            measures: None,
            ending: None,
            events: None,
            samples: Some(vec![self.joints.iter().sum(); STEPS]),
            clearance_m: None,
        })
    }

    fn render(&mut self) -> Result<Vec<Image>, Fault> {
        Err(Fault::new(FaultKind::Setup, "this simulator has no cameras"))
    }
}

/// Succeeds when the sum of the joint positions exceeds 0.16 rad.
struct Reach;

impl RemoteTask for Reach {
    type Cell = &'static str;
    type Readback = f64;
    type Sample = f64;

    fn accepts(&self, hello: &Hello) -> Result<(), String> {
        if hello.joints.len() == 3 { Ok(()) } else { Err("expected three joints".to_owned()) }
    }

    fn is_local(&self, parameter: &str) -> bool {
        parameter == "shape"
    }

    fn resolve(&mut self, _: &Scenario) -> Result<&'static str, Fault> {
        Ok("an empty cell")
    }

    fn start(&mut self, readback: f64, _: &f64, observation: &Observation) -> Result<Start, Fault> {
        let mut applied = Assignment::default();
        applied.set("shape", Value::Category("box".into()));
        applied.set("mass_kg", Value::Number(readback));
        let task = TaskSpec {
            instruction: "reach".to_owned(),
            control_period_s: PERIOD,
            time_limit_s: 2.0,
            shape: "box".to_owned(),
            object_extent_m: [0.05; 3],
            object_pose: Pose::IDENTITY,
            target_pose: Pose::IDENTITY,
            tolerance_m: 0.03,
            approach_speed_m_s: None,
        };
        Ok(Start { task, observation: observation.clone(), applied })
    }

    fn command(&mut self, action: &Action) -> Result<Vec<f64>, Fault> {
        match &action.arm {
            ArmCommand::JointPositions(joints) => Ok(joints.clone()),
            ArmCommand::ToolDelta { .. } => Err(Fault::new(FaultKind::BadAction, "expected joint positions")),
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
fn the_task_scores_what_the_server_reports() {
    let server = Running::start_host(ToyPhysics::new, unchanged);
    let mut simulator = RemotePhysics::new(pool(&server), Reach).unwrap();
    for index in 0..3 {
        let episode = rollout(&mut simulator, &mut Creep::default(), &scenario(index));
        assert_eq!(episode.outcome, Outcome::Success);
        // Each of three joints moves 0.01 rad in a control period: the sum exceeds 0.16 rad after six.
        assert!((episode.time_s - 6.0 * PERIOD).abs() < 1e-9, "{}", episode.time_s);
    }
}

#[test]
fn a_physics_server_conforms() {
    let server = Running::start_host(ToyPhysics::new, unchanged);
    let scenarios: Vec<Scenario> = (0..2).map(scenario).collect();
    let timeouts = Timeouts::from_step(Duration::from_secs(5));
    let report = check(&server.address, timeouts, &scenarios, &mut PhysicsSession(Reach)).unwrap();
    assert!(report.passed(), "{:?}", report.results);
}

#[test]
fn a_missing_sample_is_a_violation() {
    let server = Running::start_host(ToyPhysics::new, |_, request, reply| {
        Some(in_steps::<f64>(request, reply, |reply| {
            reply.steps[0].samples.as_mut().unwrap().pop();
        }))
    });
    let mut simulator = RemotePhysics::new(pool(&server), Reach).unwrap();
    simulator.reset(&scenario(0)).unwrap();
    let arm = ArmCommand::JointPositions(vec![0.0; 3]);
    let fault = simulator.step(&Action { arm, gripper: GripperCommand::Open, phase: None }).unwrap_err();
    assert!(fault.detail.contains("4 entries in `sights`; expected 5"), "{fault}");
}

#[test]
fn the_kind_of_server_must_match() {
    let (physics, scored) = (Running::start_host(ToyPhysics::new, unchanged), Running::start(hello(), unchanged));
    let why = RemoteEnvironment::new(pool(&physics)).err().unwrap().to_string();
    assert!(why.contains("does not score itself"), "{why}");
    let why = RemotePhysics::new(pool(&scored), Reach).err().unwrap().to_string();
    assert!(why.contains("scores itself"), "{why}");
}
