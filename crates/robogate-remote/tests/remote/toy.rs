//! A simulator without physics, and a policy for it.

use robogate_core::{
    Action, ArmCommand, Assignment, Contact, Ending, FailureMode, Fault, FaultKind, GripperCommand, Image, Measures,
    Observation, Policy, Pose, Scenario, Seed, Simulator, Start, Step, TaskSpec, Value,
};
use robogate_remote::message::{ActionSpace, Camera, DeltaScale, Engine, Hello, Program, Robot};

/// Control period in seconds.
pub(crate) const PERIOD: f64 = 0.05;
/// Number of control periods after which closing the gripper ends an episode.
const LENGTH: u32 = 12;

/// Three joints that reach any commanded position immediately. Closing the gripper ends the episode after [`LENGTH`]
/// control periods, with an outcome that the seed of the scenario decides.
#[derive(Default)]
pub(crate) struct Toy {
    scenario: Option<Scenario>,
    joints: Vec<f64>,
    tick: u32,
}

impl Toy {
    fn observation(&self) -> Observation {
        Observation {
            time_s: f64::from(self.tick) * PERIOD,
            joint_positions: self.joints.clone(),
            joint_velocities: vec![0.1; 3],
            gripper_opening_m: Some(0.08),
            tool_pose: Pose::upright([self.joints[0], 0.1, 0.2], self.joints[1]),
            images: Vec::new(),
        }
    }

    fn hash(&self) -> u64 {
        self.joints.iter().fold(u64::from(self.tick), |hash, q| (hash ^ q.to_bits()).wrapping_mul(0x100_0000_01b3))
    }
}

impl Simulator for Toy {
    fn reset(&mut self, scenario: &Scenario) -> Result<Start, Fault> {
        if scenario.requested.number("mass_kg").is_some_and(|mass| mass > 100.0) {
            return Err(Fault::new(FaultKind::Setup, "too heavy to lift"));
        }
        let mut stream = scenario.seed.stream("toy");
        self.joints = vec![stream.uniform(), stream.uniform(), 0.0];
        self.tick = 0;
        self.scenario = Some(scenario.clone());
        let task = TaskSpec {
            instruction: "wait".to_owned(),
            control_period_s: PERIOD,
            time_limit_s: 2.0,
            shape: "box".to_owned(),
            object_extent_m: [0.05; 3],
            object_pose: Pose::upright([0.5, 0.0, 0.025], 0.3),
            target_pose: Pose::IDENTITY,
            tolerance_m: 0.03,
            approach_speed_m_s: None,
        };
        Ok(Start { task, observation: self.observation(), applied: scenario.requested.clone() })
    }

    fn step(&mut self, action: &Action) -> Result<Step, Fault> {
        match &action.arm {
            ArmCommand::JointPositions(joints) => self.joints.clone_from(joints),
            ArmCommand::ToolDelta { translation_m, .. } => self.joints[0] += translation_m[0],
        }
        self.tick += 1;
        let over = self.tick >= LENGTH && action.gripper == GripperCommand::Close;
        let failure =
            (self.scenario.as_ref().unwrap().seed.stream("end").below(2) == 1).then_some(FailureMode::GripLoss);
        let contact =
            failure.map(|_| Contact { robot_body: "hand".to_owned(), other_body: "table".to_owned(), force_n: 3.25 });
        Ok(Step {
            observation: self.observation(),
            measures: Measures { slip_m: Some(self.joints[0] / 3.0), ..Measures::default() },
            ending: over.then(|| Ending { failure, time_s: f64::from(self.tick) * PERIOD, contact }),
            events: vec![format!("tick {}", self.tick)],
            state_hash: self.hash(),
        })
    }

    fn render(&mut self) -> Result<Vec<Image>, Fault> {
        let rgb = vec![self.tick as u8; 3 * 8 * 6];
        Ok(vec![Image { camera: "front".to_owned(), width: 8, height: 6, rgb }])
    }
}

pub(crate) fn hello() -> Hello {
    Hello {
        server: Program { name: "test".to_owned(), version: "1".to_owned() },
        engine: Engine { name: "toy".to_owned(), version: "1".to_owned(), solver: None },
        robot: Robot { name: "toy".to_owned(), sha256: None },
        time_step_s: PERIOD,
        control_period_s: PERIOD,
        time_limit_s: 2.0,
        joints: ["a", "b", "c"].map(str::to_owned).to_vec(),
        action_spaces: vec![ActionSpace::JointPosition, ActionSpace::ToolDelta],
        tool_delta: Some(DeltaScale { translation_m: 0.02, rotation_rad: 0.05 }),
        cameras: vec![Camera { name: "front".to_owned(), width: 8, height: 6 }],
        quaternion_order: "wxyz".to_owned(),
        image_origin: "top_left".to_owned(),
        parameters: vec!["mass_kg".to_owned(), "shape".to_owned()],
        scores_itself: true,
        deterministic: true,
    }
}

/// Moves all joints a little in each control period, and uses images in every third one.
#[derive(Default)]
pub(crate) struct Creep(u32);

impl Policy for Creep {
    fn reset(&mut self, _: &TaskSpec, _: Seed) -> Result<(), Fault> {
        self.0 = 0;
        Ok(())
    }

    fn looks(&self) -> bool {
        self.0.is_multiple_of(3)
    }

    fn act(&mut self, observation: &Observation) -> Result<Action, Fault> {
        assert_eq!(observation.images.len(), usize::from(self.looks()));
        self.0 += 1;
        let joints = observation.joint_positions.iter().map(|q| q + 0.01).collect();
        Ok(Action { arm: ArmCommand::JointPositions(joints), gripper: GripperCommand::Close, phase: None })
    }
}

pub(crate) fn scenario(index: u64) -> Scenario {
    let mut requested = Assignment::default();
    requested.set("shape", Value::Category("box".into()));
    requested.set("mass_kg", Value::Number(0.1 + 0.01 * index as f64));
    Scenario { index, seed: Seed::campaign(u64::MAX - 3).episode(index), requested }
}
