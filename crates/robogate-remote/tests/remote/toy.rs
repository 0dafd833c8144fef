//! A simulator without physics, and a policy for it.

use std::sync::Arc;

use robogate_core::{
    Action, ActionSpace, ActionSpec, Allowed, Assignment, Better, CameraSpec, Command, Contact, ContactBetween,
    ContactPoint, Ending, Environment, FailureMode, FailureModeSpec, Fault, FaultKind, Frame, GripperKind, Image,
    MeasureSpec, Measures, Observation, ObservationSpec, ParameterSpec, Policy, Pose, Scenario, Seed, Severity, Solid,
    SolidShape, Start, Step, TaskInstance, TaskSpec, Trajectory, Value, VectorSpec, Word, vectors,
};
use robogate_remote::message::{Engine, Hello, Program};

/// Control period in seconds.
pub(crate) const PERIOD: f64 = 0.05;
/// Number of control periods after which closing the gripper ends an episode.
const LENGTH: u32 = 12;

const SPILLED: FailureMode = FailureMode::constant("spilled");
const LEVEL: Word = Word::constant("level_m");
const FORCE: Word = Word::constant("force_n");

/// Three joints that reach any commanded position immediately. Closing the gripper ends the episode after [`LENGTH`]
/// control periods. The seed of the scenario determines the outcome.
pub(crate) struct Toy {
    task: Arc<TaskSpec>,
    scenario: Option<Scenario>,
    joints: Vec<f64>,
    tick: u32,
    recording: bool,
    motion: Trajectory,
}

impl Default for Toy {
    fn default() -> Self {
        Self {
            task: Arc::new(task()),
            scenario: None,
            joints: vec![0.0; 3],
            tick: 0,
            recording: false,
            motion: Trajectory::default(),
        }
    }
}

impl Toy {
    fn observation(&self) -> Observation {
        Observation {
            time_s: f64::from(self.tick) * PERIOD,
            vectors: vec![
                (vectors::JOINT_POSITIONS, self.joints.clone()),
                (vectors::GRIPPER_OPENING, vec![0.08]),
                (vectors::TOOL_POSE, Pose::upright([self.joints[0], 0.1, 0.2], self.joints[1]).to_array().to_vec()),
            ],
            images: Vec::new(),
        }
    }

    /// Adds a frame: a hand at the first joint, and a box that it touches.
    fn note(&mut self) {
        if !self.recording {
            return;
        }
        let x = self.joints[0];
        let contact = ContactPoint {
            position: [x, 0.25, 0.5],
            force_n: [0.0, 0.0, 1.5],
            between: ContactBetween::RobotAndObject,
        };
        self.motion.frames.push(Frame {
            time_s: f64::from(self.tick) * PERIOD,
            poses: vec![Pose::upright([x, 0.0, 1.0], x), Pose::IDENTITY],
            contacts: if self.tick == 2 { vec![contact] } else { Vec::new() },
        });
    }

    fn hash(&self) -> u64 {
        self.joints.iter().fold(u64::from(self.tick), |hash, q| (hash ^ q.to_bits()).wrapping_mul(0x100_0000_01b3))
    }
}

impl Environment for Toy {
    fn task(&self) -> &Arc<TaskSpec> {
        &self.task
    }

    fn reset(&mut self, scenario: &Scenario) -> Result<Start, Fault> {
        if scenario.requested.number("mass_kg").is_some_and(|mass| mass > 100.0) {
            return Err(Fault::new(FaultKind::Setup, "too heavy to lift"));
        }
        let mut stream = scenario.seed.stream("toy");
        self.joints = vec![stream.uniform(), stream.uniform(), 0.0];
        self.tick = 0;
        self.scenario = Some(scenario.clone());
        if self.recording {
            self.motion =
                Trajectory { bodies: vec!["hand".into(), "box".into()], solids: solids(), frames: Vec::new() };
        }
        self.note();
        let details = serde_json::json!({"pose": [0.5, 0.0, 0.025]});
        let instance = TaskInstance { instruction: format!("wait for {}", scenario.index), details };
        Ok(Start { instance, observation: self.observation(), applied: scenario.requested.clone() })
    }

    fn step(&mut self, action: &Action) -> Result<Step, Fault> {
        match &action.command {
            Command::JointPosition(joints) => self.joints.clone_from(joints),
            Command::ToolDelta { translation_m, .. } => self.joints[0] += translation_m[0],
            Command::Vector(_) => return Err(Fault::new(FaultKind::BadAction, "expected no vector")),
        }
        self.tick += 1;
        self.note();
        let over = self.tick >= LENGTH && action.gripper == Some(Action::CLOSE);
        let failure = (self.scenario.as_ref().unwrap().seed.stream("end").below(2) == 1).then_some(SPILLED);
        let contact =
            failure.map(|_| Contact { robot_body: "hand".to_owned(), other_body: "table".to_owned(), force_n: 3.25 });
        Ok(Step {
            observation: self.observation(),
            measures: Measures::from_iter([(LEVEL, Some(self.joints[0] / 3.0)), (FORCE, None)]),
            ending: over.then(|| Ending { failure, time_s: f64::from(self.tick) * PERIOD, contact }),
            events: vec![format!("tick {}", self.tick)],
            state_hash: self.hash(),
        })
    }

    fn record_trajectory(&mut self, period_s: Option<f64>) {
        self.recording = period_s.is_some();
    }

    fn take_trajectory(&mut self) -> Option<Trajectory> {
        Some(std::mem::take(&mut self.motion)).filter(|motion| !motion.frames.is_empty())
    }

    fn render(&mut self) -> Result<Vec<Image>, Fault> {
        let rgb = vec![self.tick as u8; 3 * 8 * 6];
        Ok(vec![Image { camera: "front".to_owned(), width: 8, height: 6, rgb }])
    }
}

/// A solid of each shape.
fn solids() -> Vec<Solid> {
    let triangles = vec![[[0.0, 0.0, 0.0], [0.5, 0.0, 0.0], [0.0, 0.5, 0.25]]; 2];
    let shapes = [
        SolidShape::Box { half: [0.1, 0.2, 0.3] },
        SolidShape::Sphere { radius: 0.05 },
        SolidShape::Capsule { radius: 0.01, half_height: 0.02 },
        SolidShape::Cylinder { radius: 0.03, half_height: 0.04 },
        SolidShape::Mesh { triangles: triangles.clone() },
        SolidShape::Mesh { triangles },
    ];
    let solid = |(at, shape)| Solid {
        body: at % 2,
        shape,
        pose: Pose::upright([0.0, 0.0, 0.1 * at as f64], 0.3),
        color: [10, 20, at as u8],
        opacity: 0.5,
    };
    shapes.into_iter().enumerate().map(solid).collect()
}

pub(crate) fn task() -> TaskSpec {
    let measure = |name: Word, unit: &str| MeasureSpec {
        name,
        unit: unit.to_owned(),
        meaning: String::new(),
        better: Better::Neither,
    };
    let parameter = |name: &str, allowed: Allowed, nominal: Value| ParameterSpec {
        name: name.into(),
        unit: String::new(),
        meaning: String::new(),
        allowed,
        nominal: Some(nominal),
        read_from: String::new(),
        family: None,
    };
    let vector = |name: Word, length: usize| VectorSpec { name, length, unit: String::new() };
    let choices = vec!["box".into(), "sphere".into()];
    TaskSpec {
        name: Word::constant("pour"),
        version: 1,
        instruction: "wait".to_owned(),
        control_period_s: PERIOD,
        time_limit_s: 2.0,
        failure_modes: vec![FailureModeSpec {
            name: SPILLED,
            meaning: "Something is on the table.".to_owned(),
            severity: Severity::Critical,
            published_as: None,
        }],
        measures: vec![measure(LEVEL, "m"), measure(FORCE, "N")],
        draws: Vec::new(),
        phases: Vec::new(),
        stages: Vec::new(),
        parameters: vec![
            parameter("mass_kg", Allowed::Continuous { low: 0.0, high: 200.0 }, Value::Number(1.0)),
            parameter("shape", Allowed::Categorical { choices, open: false }, Value::Category("box".into())),
        ],
        settings: Vec::new(),
        observation: ObservationSpec {
            vectors: vec![
                vector(vectors::JOINT_POSITIONS, 3),
                vector(vectors::GRIPPER_OPENING, 1),
                vector(vectors::TOOL_POSE, 7),
            ],
            cameras: vec![CameraSpec { name: "front".to_owned(), width: 8, height: 6 }],
        },
        action: ActionSpec {
            spaces: vec![
                ActionSpace::JointPosition { joints: ["a", "b", "c"].map(str::to_owned).to_vec() },
                ActionSpace::ToolDelta { translation_m: 0.02, rotation_rad: 0.05 },
            ],
            gripper: Some(GripperKind::Binary),
        },
        details: serde_json::Value::Null,
    }
}

pub(crate) fn hello() -> Hello {
    let server = Program { name: "test".to_owned(), version: "1".to_owned() };
    Hello::new(task(), server, Engine { name: "toy".to_owned(), version: "1".to_owned(), solver: None, sha256: None })
}

/// Moves all joints a little in each control period, and uses images in every third one.
#[derive(Default)]
pub(crate) struct Creep(u32);

impl Policy for Creep {
    fn check(&self, _: &TaskSpec) -> Result<(), String> {
        Ok(())
    }

    fn reset(&mut self, _: &TaskSpec, _: &TaskInstance, _: Seed) -> Result<(), Fault> {
        self.0 = 0;
        Ok(())
    }

    fn wants_images(&self) -> bool {
        self.0.is_multiple_of(3)
    }

    fn act(&mut self, observation: &Observation) -> Result<Action, Fault> {
        assert_eq!(observation.images.len(), usize::from(self.wants_images()));
        self.0 += 1;
        let joints = observation.joint_positions().iter().map(|q| q + 0.01).collect();
        Ok(joint_positions(joints, Action::CLOSE))
    }
}

pub(crate) fn joint_positions(joints: Vec<f64>, gripper: f64) -> Action {
    Action { command: Command::JointPosition(joints), gripper: Some(gripper), phase: None }
}

pub(crate) fn scenario(index: u64) -> Scenario {
    let mut requested = Assignment::default();
    requested.set("shape", Value::Category("box".into()));
    requested.set("mass_kg", Value::Number(0.1 + 0.01 * index as f64));
    Scenario { index, seed: Seed::campaign(u64::MAX - 3).episode(index), requested }
}
