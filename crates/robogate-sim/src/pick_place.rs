//! Engine, robot and task as one simulator.

use nalgebra::Isometry3;
use robogate_core::{
    Action, ArmCommand, Assignment, Fault, FaultKind, GripperCommand, Observation, Scenario, Simulator, Start, Step,
    TaskSpec, Value,
};

use crate::referee::{Referee, Sight};
use crate::scene::isometry;
use crate::servo::Servo;
use crate::{Engine, Gripper, JointTargets, ObjectModel, Placement, Readback, Scene, SceneParameters};

/// Time between two actions, in seconds (paper, section 4.1).
const CONTROL_PERIOD_S: f64 = 0.05;
/// An episode's time limit, in seconds (paper, section 4.1).
const TIME_LIMIT_S: f64 = 15.0;
/// Success is within this distance of the target, in metres (paper, section 4.3).
const TOLERANCE_M: f64 = 0.03;
/// Clearance beyond this is not measured, in metres.
const CLEARANCE_LIMIT_M: f64 = 0.25;

/// Pick an object from the table and place it at the target.
pub struct PickPlace<E> {
    engine: E,
    grip_force_n: f64,
    steps_per_period: usize,
    episode: Option<Running>,
}

/// The state of the episode under way beyond the engine's.
struct Running {
    servo: Servo,
    referee: Referee,
    /// The fixtures' names, in the order of the scene.
    fixtures: Vec<String>,
    /// What each joint's encoder reads too much, in radians.
    bias: Vec<f64>,
    ticks: u64,
    targets: JointTargets,
}

impl<E: Engine> PickPlace<E> {
    /// The task on this engine; `grip_force_n` replaces the robot's own setting.
    ///
    /// Fails where the control period is no whole number of the engine's time steps, or the grip force
    /// is none that the gripper can hold.
    pub fn new(engine: E, grip_force_n: Option<f64>) -> Result<Self, String> {
        let steps = CONTROL_PERIOD_S / engine.time_step();
        if !(1.0..=1e4).contains(&steps) || (steps - steps.round()).abs() > 1e-6 {
            let step = engine.time_step();
            return Err(format!("the control period of {CONTROL_PERIOD_S} s is no whole number of steps of {step} s"));
        }
        let Gripper::ParallelJaw { force_n, force_limit_n, .. } = &engine.robot().settings.gripper;
        let grip_force_n = grip_force_n.unwrap_or(*force_n);
        if !(grip_force_n > 0.0 && grip_force_n <= *force_limit_n) {
            return Err(format!(
                "a grip force of {grip_force_n} N is outside 0 to {force_limit_n} N, the gripper's limit"
            ));
        }
        Ok(Self { engine, grip_force_n, steps_per_period: steps.round() as usize, episode: None })
    }

    /// The engine, for looking at the world.
    pub fn engine(&self) -> &E {
        &self.engine
    }

    fn observation(&self, running: &Running) -> Observation {
        let measured = self.engine.joint_positions().iter().zip(&running.bias).map(|(q, bias)| q + bias).collect();
        Observation {
            time_s: running.ticks as f64 * CONTROL_PERIOD_S,
            joint_positions: measured,
            joint_velocities: self.engine.joint_velocities(),
            gripper_opening_m: Some(self.engine.opening()),
        }
    }

    fn state_hash(&self) -> u64 {
        // FNV-1a over 64-bit words.
        let mut hash = 0xcbf2_9ce4_8422_2325_u64;
        self.engine.state_bits(&mut |bits| hash = (hash ^ bits).wrapping_mul(0x0000_0100_0000_01b3).rotate_left(5));
        hash
    }
}

impl<E: Engine> Simulator for PickPlace<E> {
    fn reset(&mut self, scenario: &Scenario) -> Result<Start, Fault> {
        let setup = |why: String| Fault::new(FaultKind::Setup, why);
        self.episode = None;
        let parameters = SceneParameters::from_assignment(&scenario.requested).map_err(|e| setup(e.to_string()))?;
        let placement = Placement::from_name(&parameters.placement)
            .ok_or_else(|| setup(format!("there is no placement `{}`", parameters.placement)))?;
        let mut obstacles = scenario.seed.stream("obstacles");
        let scene = Scene::new(&parameters, &placement, &mut obstacles).map_err(setup)?;
        let mut encoders = scenario.seed.stream("encoder-bias");
        let noise = parameters.ik_noise_rad;
        let arm = &self.engine.robot().settings.arm;
        let bias: Vec<f64> = arm.joints.iter().map(|_| encoders.between(-noise, noise)).collect();
        let home = arm.home_rad.clone();
        self.engine.load(&scene, &home)?;
        let touches = self.engine.touches();
        if touches.collision.is_some() || touches.body_on_object || touches.fingers.iter().any(Option::is_some) {
            return Err(setup("the robot starts in contact".to_owned()));
        }
        let applied = applied(&scenario.requested, &parameters, &self.engine.read_back()?);
        let Gripper::ParallelJaw { opening_m, .. } = &self.engine.robot().settings.gripper;
        let running = Running {
            servo: Servo::at_rest(&home, CONTROL_PERIOD_S),
            referee: Referee::new(scene.target, TOLERANCE_M, self.grip_force_n),
            fixtures: scene.fixtures.iter().map(|fixture| fixture.name.clone()).collect(),
            bias,
            ticks: 0,
            targets: JointTargets {
                positions: home.clone(),
                velocities: vec![0.0; home.len()],
                finger: 0.5 * opening_m,
            },
        };
        let size = parameters.size_m;
        let task = TaskSpec {
            instruction: format!("pick up the {} and place it at the target", parameters.shape.word()),
            control_period_s: CONTROL_PERIOD_S,
            time_limit_s: TIME_LIMIT_S,
            shape: parameters.shape.word().to_owned(),
            object_extent_m: [size; 3],
            object_pose: placement.pose(size),
            target_pose: robogate_core::Pose::upright(scene.target, 0.0),
            tolerance_m: TOLERANCE_M,
        };
        let observation = self.observation(&running);
        self.episode = Some(running);
        Ok(Start { task, observation, applied })
    }

    fn step(&mut self, action: &Action) -> Result<Step, Fault> {
        let Some(mut running) = self.episode.take() else {
            return Err(Fault::new(FaultKind::Setup, "no episode is under way"));
        };
        let ArmCommand::JointPositions(wanted) = &action.arm;
        let arm = &self.engine.robot().settings.arm;
        if wanted.len() != arm.joints.len() || wanted.iter().any(|q| !q.is_finite()) {
            let why = format!("{} finite joint positions were due, got {wanted:?}", arm.joints.len());
            return Err(Fault::new(FaultKind::BadAction, why));
        }
        // The servo closes its loop on the encoders: what they read too much, the arm lacks.
        let command: Vec<f64> = wanted.iter().zip(&running.bias).map(|(q, bias)| q - bias).collect();
        running.servo.command(&command, arm, self.engine.chain());
        let Gripper::ParallelJaw { opening_m, finger_speed_m_s, stiffness_n_m, .. } =
            &self.engine.robot().settings.gripper;
        // Closing drives past the closed position: what stops the fingers is the object or each other.
        let finger_goal = match action.gripper {
            GripperCommand::Open => 0.5 * opening_m,
            GripperCommand::Close => -0.5 * opening_m,
        };
        // The fingers press with the grip force: their target runs ahead of them by no more than the way on
        // which the servo's spring builds it up.
        let lead = self.grip_force_n / stiffness_n_m;
        let finger_step = finger_speed_m_s * self.engine.time_step();
        for k in 1..=self.steps_per_period {
            let share = k as f64 / self.steps_per_period as f64;
            let targets = &mut running.targets;
            running.servo.targets(share, &mut targets.positions, &mut targets.velocities);
            let finger = 0.5 * self.engine.opening();
            let next = targets.finger + (finger_goal - targets.finger).clamp(-finger_step, finger_step);
            targets.finger = next.clamp(finger - lead, finger + lead);
            self.engine.advance(targets);
            running.referee.look(&Sight {
                time: (running.ticks as f64 + share) * CONTROL_PERIOD_S,
                gripper: action.gripper,
                opening: self.engine.opening(),
                touches: self.engine.touches(),
                object: self.engine.object(),
                velocity: self.engine.object_velocity(),
                tcp: self.engine.tcp(),
            });
        }
        running.ticks += 1;
        self.engine.health()?;
        let bound = running.referee.measures().min_clearance_m.unwrap_or(CLEARANCE_LIMIT_M);
        if let Some(clearance) = self.engine.clearance_below(bound) {
            running.referee.note_clearance(clearance);
        }
        let step = Step {
            observation: self.observation(&running),
            events: running.referee.take_events(),
            measures: running.referee.measures(),
            ending: running.referee.ending(|collision| {
                let fixture = running.fixtures[collision.fixture].clone();
                (self.engine.robot_body(collision.robot_body), fixture)
            }),
            state_hash: self.state_hash(),
        };
        if !running.referee.decided() {
            self.episode = Some(running);
        }
        Ok(step)
    }
}

/// The requested parameters as the engine holds them.
fn applied(requested: &Assignment, asked: &SceneParameters, engine: &Readback) -> Assignment {
    let size = engine_size(asked, engine);
    let model = ObjectModel::new(asked.shape, size, engine.mass_kg, 0.0);
    let mut applied = Assignment::default();
    for (name, value) in requested.iter() {
        // A whole number that was asked for as one comes back as one.
        let number = |x: f64| match value {
            Value::Integer(_) if (x - x.round()).abs() < 1e-6 => Value::Integer(x.round() as i64),
            _ => Value::Number(x),
        };
        let read = match name {
            "friction" => number(engine.friction),
            "mass_kg" => number(engine.mass_kg),
            "com_offset" => number(model.com_offset_of(&engine.centre_of_mass)),
            "size_m" => number(size),
            "obstacles" => Value::Integer(engine.obstacles as i64),
            "placement" => Value::Category(engine_placement(asked, &engine.object).into()),
            "shape" => Value::Category(engine_shape(asked, engine).into()),
            // What acts through the servo is applied by the simulator itself.
            _ => value.clone(),
        };
        applied.set(name, read);
    }
    applied
}

/// The size at which the shape asked for has the engine's first part.
fn engine_size(asked: &SceneParameters, engine: &Readback) -> f64 {
    let unit = ObjectModel::new(asked.shape, 1.0, 1.0, 0.0);
    let extent = |part: &crate::Primitive| part.half_extent()[0];
    engine.parts.first().map_or(f64::NAN, extent) / extent(&unit.parts[0].primitive)
}

/// The shape whose parts the engine holds.
fn engine_shape(asked: &SceneParameters, engine: &Readback) -> &'static str {
    let parts = ObjectModel::new(asked.shape, asked.size_m, 1.0, 0.0).parts;
    let same = parts.len() == engine.parts.len()
        && parts.iter().zip(&engine.parts).all(|(part, read)| {
            std::mem::discriminant(&part.primitive) == std::mem::discriminant(read)
                && part.primitive.half_extent().iter().zip(read.half_extent()).all(|(a, b)| (a - b).abs() < 1e-9)
        });
    if same { asked.shape.word() } else { "another" }
}

/// The placement at which the object stands.
fn engine_placement(asked: &SceneParameters, object: &Isometry3<f64>) -> String {
    let wanted = Placement::from_name(&asked.placement).map(|placement| placement.pose(asked.size_m));
    let there = wanted.is_some_and(|pose| {
        let off = isometry(&pose.position, &pose.orientation).inverse() * object;
        off.translation.vector.norm() < 1e-6 && off.rotation.angle() < 1e-6
    });
    if there { asked.placement.clone() } else { format!("{:.6?}", object.translation.vector.as_slice()) }
}
