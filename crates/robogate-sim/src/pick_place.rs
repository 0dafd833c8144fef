//! Engine, robot and task as one simulator.

use nalgebra::Isometry3;
use robogate_core::{
    Action, Assignment, Fault, FaultKind, GripperCommand, Image, Observation, Scenario, Simulator, Start, Step,
    TaskSpec, Value,
};

use crate::camera::{Cameras, Posture};
use crate::referee::{Hand, Referee, Sight};
use crate::scene::{GRAVITY, isometry, pose};
use crate::servo::Servo;
use crate::steering::Steering;
use crate::suction::{self, Change, Suction};
use crate::{
    Engine, FixtureKind, FixtureRead, Gripper, JointTargets, ObjectModel, Part, Placement, Primitive, Readback, Scene,
    SceneParameters, SuctionLaw, Visual,
};

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
    suction_law: SuctionLaw,
    steps_per_period: usize,
    /// Or why there are none.
    cameras: Result<Cameras, String>,
    episode: Option<Running>,
}

/// The state of the episode under way beyond the engine's.
struct Running {
    steering: Steering,
    servo: Servo,
    referee: Referee,
    /// The cup at work, of a gripper that has one.
    suction: Option<Suction>,
    /// The object's parts, which the cup looks at.
    parts: Vec<Part>,
    /// The fixtures' names, in the order of the scene.
    fixtures: Vec<String>,
    /// What each joint's encoder reads too much, in radians.
    bias: Vec<f64>,
    ticks: u64,
    targets: JointTargets,
}

impl<E: Engine> PickPlace<E> {
    /// The task on this engine; `grip_force_n` replaces the robot's own setting. A suction cup holds by vacuum
    /// ([`Self::with_suction`]).
    ///
    /// Fails where the control period is no whole number of the engine's time steps, or the grip force
    /// is none that the gripper can hold.
    pub fn new(engine: E, grip_force_n: Option<f64>) -> Result<Self, String> {
        let steps = CONTROL_PERIOD_S / engine.time_step();
        if !(1.0..=1e4).contains(&steps) || (steps - steps.round()).abs() > 1e-6 {
            let step = engine.time_step();
            return Err(format!("the control period of {CONTROL_PERIOD_S} s is no whole number of steps of {step} s"));
        }
        let grip_force_n = match &engine.robot().settings.gripper {
            Gripper::ParallelJaw(jaw) => {
                let force = grip_force_n.unwrap_or(jaw.force_n);
                if !(force > 0.0 && force <= jaw.force_limit_n) {
                    return Err(format!(
                        "a grip force of {force} N is outside 0 to {} N, the gripper's limit",
                        jaw.force_limit_n
                    ));
                }
                force
            }
            Gripper::Suction(cup) => match grip_force_n {
                Some(force) => {
                    return Err(format!(
                        "a grip force of {force} N is for fingers: this gripper is {}",
                        engine.robot().settings.gripper.words()
                    ));
                }
                None => cup.force_n(),
            },
        };
        Ok(Self {
            cameras: Cameras::new(engine.robot()),
            engine,
            grip_force_n,
            suction_law: SuctionLaw::Vacuum,
            steps_per_period: steps.round() as usize,
            episode: None,
        })
    }

    /// The same task, a suction cup holding by this law.
    #[must_use]
    pub fn with_suction(mut self, law: SuctionLaw) -> Self {
        self.suction_law = law;
        self
    }

    /// The same task, the cameras' pictures of this size in pixels.
    #[must_use]
    pub fn with_picture_size(mut self, width: usize, height: usize) -> Self {
        self.cameras = self.cameras.map(|cameras| cameras.with_size(width, height));
        self
    }

    /// The engine, for looking at the world.
    pub fn engine(&self) -> &E {
        &self.engine
    }

    fn observation(&self, running: &Running) -> Observation {
        let measured = self.measured(running);
        Observation {
            time_s: running.ticks as f64 * CONTROL_PERIOD_S,
            tool_pose: pose(&self.engine.chain().tcp_at(&measured)),
            joint_positions: measured,
            joint_velocities: self.engine.joint_velocities(),
            gripper_opening_m: self.engine.opening(),
            images: Vec::new(),
        }
    }

    /// Joint positions as the encoders read them, in radians.
    fn measured(&self, running: &Running) -> Vec<f64> {
        self.engine.joint_positions().iter().zip(&running.bias).map(|(q, bias)| q + bias).collect()
    }

    /// Where everything that moves is.
    fn posture(&self, fixtures: usize) -> Posture {
        Posture {
            joints: self.engine.joint_positions(),
            opening_m: self.engine.opening(),
            object: self.engine.object(),
            fixtures: (0..fixtures).map(|i| self.engine.fixture(i)).collect(),
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
        if let Ok(cameras) = &mut self.cameras {
            cameras.clear();
        }
        let gripper = &self.engine.robot().settings.gripper;
        let parameters =
            SceneParameters::from_assignment(&scenario.requested, Some(gripper)).map_err(|e| setup(e.to_string()))?;
        let placement = Placement::from_name(&parameters.placement)
            .ok_or_else(|| setup(format!("there is no placement `{}`", parameters.placement)))?;
        let placement = placement.moved(parameters.offset_m);
        let mut jitter = scenario.seed.stream("position-jitter");
        let off = parameters.position_jitter_m * jitter.uniform().sqrt();
        let (sin, cos) = jitter.between(0.0, std::f64::consts::TAU).sin_cos();
        // Where the object really stands; the policy is told the placement.
        let standing = placement.moved([off * cos, off * sin]);
        let mut obstacles = scenario.seed.stream("obstacles");
        let scene = Scene::new(&parameters, &standing, &mut obstacles).map_err(setup)?;
        let suction = gripper.cup().map(|cup| {
            Suction::new(
                self.suction_law,
                cup.clone(),
                parameters.grip_threshold_m,
                parameters.friction,
                self.engine.time_step(),
            )
        });
        let finger = gripper.jaw().map_or(0.0, |jaw| 0.5 * jaw.opening_m);
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
        // How it looks is read from the cameras, where the robot's model allows any.
        let visual = match &mut self.cameras {
            Ok(cameras) => {
                cameras.set_up(&scene);
                cameras.visual().unwrap_or(scene.visual)
            }
            Err(_) => scene.visual,
        };
        let held = Held { engine: &self.engine.read_back()?, visual: &visual };
        let applied = applied(&scenario.requested, &parameters, &standing, &scene, &held);
        let running = Running {
            steering: Steering::default(),
            servo: Servo::at_rest(&home, CONTROL_PERIOD_S),
            referee: Referee::new(scene.target, TOLERANCE_M, self.grip_force_n),
            suction,
            parts: scene.object.parts.clone(),
            fixtures: scene.fixtures.iter().map(|fixture| fixture.name.clone()).collect(),
            bias,
            ticks: 0,
            targets: JointTargets { positions: home.clone(), velocities: vec![0.0; home.len()], finger },
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
            approach_speed_m_s: parameters.approach_speed_m_s,
        };
        let observation = self.observation(&running);
        self.episode = Some(running);
        Ok(Start { task, observation, applied })
    }

    fn step(&mut self, action: &Action) -> Result<Step, Fault> {
        let Some(mut running) = self.episode.take() else {
            return Err(Fault::new(FaultKind::Setup, "no episode is under way"));
        };
        let arm = &self.engine.robot().settings.arm;
        let wanted =
            running.steering.joints(&action.arm, &self.measured(&running), self.engine.chain(), &arm.home_rad)?;
        // The servo closes its loop on the encoders: what they read too much, the arm lacks.
        let command: Vec<f64> = wanted.iter().zip(&running.bias).map(|(q, bias)| q - bias).collect();
        running.servo.command(&command, arm, self.engine.chain());
        let jaw = self.engine.robot().settings.gripper.jaw().map(|jaw| {
            // Closing drives past the closed position: what stops the fingers is the object or each other.
            let goal = match action.gripper {
                GripperCommand::Open => 0.5 * jaw.opening_m,
                GripperCommand::Close => -0.5 * jaw.opening_m,
            };
            // The fingers press with the grip force: their target runs ahead of them by no more than the way on
            // which the servo's spring builds it up.
            (goal, self.grip_force_n / jaw.stiffness_n_m, jaw.finger_speed_m_s * self.engine.time_step())
        });
        for k in 1..=self.steps_per_period {
            let share = k as f64 / self.steps_per_period as f64;
            let targets = &mut running.targets;
            running.servo.targets(share, &mut targets.positions, &mut targets.velocities);
            if let (Some((goal, lead, step)), Some(opening)) = (jaw, self.engine.opening()) {
                let finger = 0.5 * opening;
                let next = targets.finger + (goal - targets.finger).clamp(-step, step);
                targets.finger = next.clamp(finger - lead, finger + lead);
            }
            self.engine.advance(targets);
            if let Some(suction) = &mut running.suction {
                let (engine, parts) = (&self.engine, &running.parts);
                let view = |cup: &_| suction::look(cup, &engine.tcp(), parts, &engine.object());
                match suction.step(action.gripper, view, engine.cup_load()) {
                    Some(Change::Join) => self.engine.join(),
                    Some(Change::Part) => self.engine.part(),
                    None => {}
                }
            }
            let holding = running.suction.as_ref().is_some_and(Suction::holding);
            running.referee.look(&Sight {
                time: (running.ticks as f64 + share) * CONTROL_PERIOD_S,
                gripper: action.gripper,
                hand: self.engine.opening().map_or(Hand::Cup(holding), Hand::Fingers),
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

    fn render(&mut self) -> Result<Vec<Image>, Fault> {
        let setup = |why: String| Fault::new(FaultKind::Setup, why);
        let cameras = self.cameras.as_ref().map_err(|why| setup(format!("this robot cannot be drawn: {why}")))?;
        let fixtures = cameras.fixtures().ok_or_else(|| setup("no scenario is set up".to_owned()))?;
        Ok(cameras.render(&self.posture(fixtures)))
    }
}

/// What was made of a scenario.
struct Held<'a> {
    engine: &'a Readback,
    visual: &'a Visual,
}

/// The requested parameters as engine and cameras hold them.
fn applied(
    requested: &Assignment,
    asked: &SceneParameters,
    standing: &Placement,
    scene: &Scene,
    Held { engine, visual }: &Held<'_>,
) -> Assignment {
    let size = engine_size(asked, engine);
    let model = ObjectModel::new(asked.shape, size, engine.mass_kg, 0.0);
    let there = stands(standing, asked.size_m, &engine.object);
    let count = |kind| engine.fixtures.iter().filter(|read| is_there(read, scene, kind)).count() as i64;
    let mover = engine.fixtures.iter().find(|read| is_there(read, scene, FixtureKind::Disturbance));
    let disturbance = asked.disturbance.read(mover.and_then(|read| Some((&read.pose, read.motion.as_ref()?))));
    let offset = |axis: usize| asked.offset_m[axis] + engine.object.translation.vector[axis] - standing.position[axis];
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
            "obstacles" => number(count(FixtureKind::Obstacle) as f64),
            "occluders" => number(count(FixtureKind::Occluder) as f64),
            "offset_x_m" => number(offset(0)),
            "offset_y_m" => number(offset(1)),
            "table_friction" => number(engine.table_friction),
            "gravity_scale" => number(engine.gravity / GRAVITY),
            "position_jitter_m" => number(if there { asked.position_jitter_m } else { f64::NAN }),
            "placement" if there => value.clone(),
            "placement" => Value::Category(format!("{:.6?}", engine.object.translation.vector.as_slice()).into()),
            "shape" => Value::Category(engine_shape(asked, engine).into()),
            _ if disturbance.value(name).is_some() => number(disturbance.value(name).unwrap_or(f64::NAN)),
            _ if visual.value(name).is_some() => match visual.value(name) {
                Some(Value::Number(x)) => number(x),
                word => word.unwrap_or(Value::Number(f64::NAN)),
            },
            // What acts through the servo, the cup or the policy is applied by the simulator itself.
            _ => value.clone(),
        };
        applied.set(name, read);
    }
    applied
}

/// Whether a fixture of this kind stands where the scene has it, as it has it.
fn is_there(read: &FixtureRead, scene: &Scene, kind: FixtureKind) -> bool {
    scene.fixtures.get(read.fixture).is_some_and(|fixture| {
        let off = fixture.part.pose.inverse() * read.pose;
        fixture.kind == kind
            && read.primitive.is_some_and(|primitive| same_primitive(&fixture.part.primitive, &primitive))
            && off.translation.vector.norm() < 1e-6
            && off.rotation.angle() < 1e-6
    })
}

fn same_primitive(a: &Primitive, b: &Primitive) -> bool {
    std::mem::discriminant(a) == std::mem::discriminant(b)
        && a.half_extent().iter().zip(b.half_extent()).all(|(a, b)| (a - b).abs() < 1e-9)
}

/// The size at which the shape asked for has the engine's first part.
fn engine_size(asked: &SceneParameters, engine: &Readback) -> f64 {
    let unit = ObjectModel::new(asked.shape, 1.0, 1.0, 0.0);
    let extent = |part: &Primitive| part.half_extent()[0];
    engine.parts.first().map_or(f64::NAN, extent) / extent(&unit.parts[0].primitive)
}

/// The shape whose parts the engine holds.
fn engine_shape(asked: &SceneParameters, engine: &Readback) -> &'static str {
    let parts = ObjectModel::new(asked.shape, asked.size_m, 1.0, 0.0).parts;
    let same = parts.len() == engine.parts.len()
        && parts.iter().zip(&engine.parts).all(|(part, read)| same_primitive(&part.primitive, read));
    if same { asked.shape.word() } else { "another" }
}

/// Whether the object stands where it shall.
fn stands(standing: &Placement, size: f64, object: &Isometry3<f64>) -> bool {
    let pose = standing.pose(size);
    let off = isometry(&pose.position, &pose.orientation).inverse() * object;
    off.translation.vector.norm() < 1e-6 && off.rotation.angle() < 1e-6
}
