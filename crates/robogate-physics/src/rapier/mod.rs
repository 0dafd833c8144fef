//! The Rapier engine: pure Rust with a different solver, for the same robot folders and scenes.
//!
//! The arm is a multibody in reduced coordinates. These settings make grasps correct (`robogate check physics --engine
//! rapier` measures them): contacts are stiff and detected again in every step, the prediction distance is small,
//! friction is solved together with position correction, and only the object's friction coefficients count. Rapier has
//! no rolling friction, so a ball gets an additional moment.

mod contacts;
mod convert;
mod joints;
mod load;

use nalgebra::{Isometry3, Vector3};
use rapier3d_f64::dynamics::{
    GenericJointBuilder, ImpulseJointHandle, JointAxesMask, JointAxis, MotorModel, MultibodyJointHandle,
    RigidBodyHandle,
};
use rapier3d_f64::geometry::ColliderHandle;
use rapier3d_f64::prelude::PhysicsWorld;
use robogate_core::{ContactPoint, Fault, FaultKind, Region};

use self::convert::{pose, quarter, read_primitive, vector};
use crate::contact_sums::ContactSums;
use crate::description::{Description, isometry};
use crate::friction::Friction;
use crate::{
    Arm, Chain, Engine, EngineBuild, FixtureRead, FreeBodyRead, JointTargets, Motion, ParallelJaw, Problem, Readback,
    Robot, RobotError, Scene, Side, Touches, Wrench,
};

/// Number of solver substeps in a time step.
const SUBSTEPS: usize = 4;

/// Stiffness of a cup's lip, in N/m: a load of 3 kg stretches it by 0.3 mm. A rigid joint would transmit the arm's
/// compliance to an object that still stands on the table: a few newtons of shear, and a moment that peels the lip off.
const LIP_STIFFNESS_N_M: f64 = 1e5;

/// Damping of a cup's lip, in N s/m: critical for 0.5 kg.
const LIP_DAMPING_NS_M: f64 = 450.0;

/// Rapier with one robot.
pub struct RapierEngine {
    robot: Robot,
    description: Description,
    time_step: f64,
    loaded: Option<Loaded>,
}

/// The role of a collider.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Kind {
    Robot {
        body: usize,
        finger: Option<usize>,
        fixed: bool,
    },
    /// A free body, by its index in the scene.
    Object(usize),
    Fixture(usize),
}

/// A scene and its state.
struct Loaded {
    world: PhysicsWorld,
    /// Names of the robot's bodies.
    bodies: Vec<String>,
    /// The region of the robot to which each of them belongs.
    regions: Vec<Region>,
    /// All colliders with their roles, in the order of insertion: the index is the collider's user data.
    colliders: Vec<(ColliderHandle, Kind)>,
    arm: Vec<MultibodyJointHandle>,
    /// Finger joints; empty without fingers.
    fingers: Vec<MultibodyJointHandle>,
    /// The spring of a suction cup.
    bellows: Option<MultibodyJointHandle>,
    tcp: RigidBodyHandle,
    /// The free bodies with their shapes: the object, then the others.
    free: Vec<(RigidBodyHandle, Vec<ColliderHandle>)>,
    /// The joint of each of them, if it is on one.
    joints: Vec<Option<joints::Handles>>,
    /// The joint between each body with a thread and what it has taken up, or the ground.
    threads: Vec<(usize, ImpulseJointHandle)>,
    /// The free body that is the object.
    selected: usize,
    /// The joint between cup and object, while they are attached.
    joined: Option<ImpulseJointHandle>,
    /// Wrench of the cup on the object in the last step.
    cup_load: Option<Wrench>,
    /// Whether the object is a ball, which has rolling friction.
    ball: bool,
    touches: Touches,
    /// Force of each touching pair in the last step: robot body, and fixture or object.
    forces: ContactSums,
    scene: Scene,
    /// Fixtures that move: their index in the scene and their body.
    movers: Vec<(usize, RigidBodyHandle)>,
    /// Steps taken since the scene was loaded.
    steps: u64,
}

impl RapierEngine {
    /// Default time step in seconds.
    pub const TIME_STEP_S: f64 = 0.0025;

    /// An engine for this robot, with this time step in seconds.
    ///
    /// # Errors
    /// If the robot's model is not MJCF, uses elements that Rapier does not support, or does not match `robot.toml`.
    pub fn new(robot: Robot, time_step: f64) -> Result<Self, RobotError> {
        if robot.settings.gripper.jaw().is_some_and(|jaw| !jaw.drives.is_empty()) {
            let problem = Problem::new(
                "[[gripper.drive]]: Rapier simulates only fingers that slide (gripper.finger_joints)",
                "use --engine mujoco",
            );
            return Err(RobotError::Invalid { path: "robot.toml".into(), problems: vec![problem] });
        }
        let description = Description::read(&robot)?;
        Ok(Self { robot, description, time_step, loaded: None })
    }

    /// The loaded scene. All methods that read the state require one.
    fn loaded(&self) -> &Loaded {
        self.loaded.as_ref().expect("a scene must be loaded before it is read")
    }
}

impl Engine for RapierEngine {
    fn build(&self) -> EngineBuild {
        EngineBuild { name: "rapier", version: rapier3d_f64::VERSION.to_owned(), sha256: None }
    }

    fn robot(&self) -> &Robot {
        &self.robot
    }

    fn chain(&self) -> &Chain {
        &self.description.chain
    }

    fn time_step(&self) -> f64 {
        self.time_step
    }

    fn load(&mut self, scene: &Scene, joints: &[f64]) -> Result<(), Fault> {
        let mut loaded = self.build_scene(scene, joints)?;
        let settings = &self.robot.settings;
        let jaw = settings.gripper.jaw();
        let targets = JointTargets {
            positions: joints.to_vec(),
            velocities: vec![0.0; joints.len()],
            finger: jaw.map_or(0.0, |jaw| 0.5 * jaw.opening_m),
        };
        loaded.drive(&settings.arm, jaw, &targets);
        loaded.read_touches_at_start();
        loaded.lock_threads();
        self.loaded = Some(loaded);
        Ok(())
    }

    fn read_back(&self) -> Result<Readback, Fault> {
        let loaded = self.loaded();
        let Friction { others, table, pads, own } = loaded.friction()?;
        let free = |body: usize| {
            let (handle, shapes) = &loaded.free[body];
            let object = &loaded.world.bodies[*handle];
            let com = object.mass_properties().local_mprops.local_com;
            let parts = shapes.iter().filter_map(|shape| read_primitive(&loaded.world.colliders[*shape]));
            FreeBodyRead {
                mass_kg: object.mass(),
                centre_of_mass: Vector3::new(com.x, com.y, com.z),
                parts: parts.collect(),
                pose: self.free_body(body),
            }
        };
        let mut fixtures = Vec::new();
        for (handle, kind) in &loaded.colliders {
            let Kind::Fixture(fixture) = *kind else { continue };
            let collider = &loaded.world.colliders[*handle];
            fixtures.push(FixtureRead {
                fixture,
                primitive: read_primitive(collider),
                pose: {
                    let upright = collider.shape().as_cylinder().map(|_| quarter().inverse());
                    isometry(collider.position()) * upright.unwrap_or_default()
                },
                motion: loaded.scene.fixtures[fixture].motion,
                friction: loaded.scene.fixtures[fixture].friction.map(|_| collider.friction()),
            });
        }
        let FreeBodyRead { mass_kg, centre_of_mass, parts, pose: object } = free(0);
        Ok(Readback {
            friction: others,
            table_friction: table,
            pad_friction: pads,
            own_friction: own,
            gravity: -loaded.world.gravity.z,
            arm_stiffness: loaded.arm_stiffness(&self.robot.settings.arm),
            mass_kg,
            centre_of_mass,
            parts,
            object,
            others: (1..loaded.free.len()).map(free).collect(),
            fixtures,
            joints: loaded.joints_read(),
        })
    }

    fn advance(&mut self, targets: &JointTargets) {
        let Some(loaded) = self.loaded.as_mut() else { return };
        loaded.drive(&self.robot.settings.arm, self.robot.settings.gripper.jaw(), targets);
        loaded.resist_rolling();
        loaded.move_fixtures(self.time_step);
        let before = loaded.momentum();
        loaded.world.step();
        loaded.steps += 1;
        loaded.read_touches();
        loaded.cup_load = loaded.joined.map(|_| loaded.load_about(&self.description.tcp.1, before));
    }

    fn health(&self) -> Result<(), Fault> {
        let mut finite = true;
        self.state_bits(&mut |bits| finite &= f64::from_bits(bits).is_finite());
        if finite { Ok(()) } else { Err(Fault::new(FaultKind::Diverged, "Rapier: the state is not finite")) }
    }

    fn joint_positions(&self) -> Vec<f64> {
        let loaded = self.loaded();
        loaded.arm.iter().map(|joint| loaded.position(*joint, 3)).collect()
    }

    fn joint_velocities(&self) -> Vec<f64> {
        let loaded = self.loaded();
        loaded.arm.iter().map(|joint| loaded.velocity(*joint)).collect()
    }

    fn opening(&self) -> Option<f64> {
        let loaded = self.loaded();
        let fingers = loaded.fingers.iter().map(|joint| loaded.position(*joint, 0));
        (!loaded.fingers.is_empty()).then(|| fingers.sum())
    }

    fn cup_travel(&self) -> f64 {
        let loaded = self.loaded();
        loaded.bellows.map_or(0.0, |joint| -loaded.position(joint, 0))
    }

    fn attach(&mut self) {
        let Some(cup) = self.robot.settings.gripper.cup() else { return };
        let (tcp, object) = (self.tcp(), self.object());
        let Some(loaded) = self.loaded.as_mut().filter(|loaded| loaded.joined.is_none()) else { return };
        // The centre of the lip in the frame of the cup's link and in the object's frame.
        let mut lip = GenericJointBuilder::new(JointAxesMask::empty())
            .local_frame1(pose(&self.description.tcp.1))
            .local_frame2(pose(&(object.inverse() * tcp)))
            // While they are attached, the joint replaces their contact.
            .contacts_enabled(false);
        for axis in [JointAxis::LinX, JointAxis::LinY, JointAxis::LinZ] {
            lip = lip.motor_model(axis, MotorModel::ForceBased).motor_position(
                axis,
                0.0,
                LIP_STIFFNESS_N_M,
                LIP_DAMPING_NS_M,
            );
        }
        // Springs along a circle give half the radius squared. Rapier uses the sine of half the angle as the angle.
        let inertia = 0.5 * (0.5 * cup.cup_diameter_m).powi(2);
        let (stiffness, damping) = (2.0 * inertia * LIP_STIFFNESS_N_M, inertia * LIP_DAMPING_NS_M);
        for axis in [JointAxis::AngX, JointAxis::AngY, JointAxis::AngZ] {
            lip = lip.motor_model(axis, MotorModel::ForceBased).motor_position(axis, 0.0, stiffness, damping);
        }
        loaded.joined = Some(loaded.world.insert_impulse_joint(loaded.tcp, loaded.object(), lip.build()));
    }

    fn detach(&mut self) {
        if let Some(loaded) = self.loaded.as_mut()
            && let Some(joint) = loaded.joined.take()
        {
            loaded.world.remove_impulse_joint(joint);
            loaded.cup_load = None;
        }
    }

    fn take_up(&mut self, screw: usize, body: usize) {
        if let Some(loaded) = self.loaded.as_mut() {
            loaded.take_up(screw, body);
        }
    }

    fn let_go(&mut self, screw: usize) {
        if let Some(loaded) = self.loaded.as_mut() {
            loaded.let_go(screw);
        }
    }

    fn body_joint(&self, body: usize) -> Option<[f64; 2]> {
        self.loaded().joint_state(body)
    }

    fn cup_load(&self) -> Option<Wrench> {
        self.loaded().cup_load
    }

    fn tcp(&self) -> Isometry3<f64> {
        let loaded = self.loaded();
        isometry(loaded.world.bodies[loaded.tcp].position()) * self.description.tcp.1
    }

    fn object(&self) -> Isometry3<f64> {
        self.free_body(self.loaded().selected)
    }

    fn select(&mut self, body: usize) {
        if let Some(loaded) = self.loaded.as_mut().filter(|loaded| body < loaded.free.len() && loaded.joined.is_none())
        {
            loaded.selected = body;
        }
    }

    fn free_body(&self, body: usize) -> Isometry3<f64> {
        let loaded = self.loaded();
        isometry(loaded.world.bodies[loaded.free[body].0].position())
    }

    fn free_body_velocity(&self, body: usize) -> (Vector3<f64>, Vector3<f64>) {
        let loaded = self.loaded();
        let body = &loaded.world.bodies[loaded.free[body].0];
        let at = body.velocity_at_point(body.position().translation);
        let angular = body.angvel();
        (Vector3::new(at.x, at.y, at.z), Vector3::new(angular.x, angular.y, angular.z))
    }

    fn fixture(&self, fixture: usize) -> Isometry3<f64> {
        let loaded = self.loaded();
        match loaded.movers.iter().find(|(moving, _)| *moving == fixture) {
            Some((_, body)) if !matches!(loaded.scene.fixtures[fixture].motion, Some(Motion::Belt { .. })) => {
                isometry(loaded.world.bodies[*body].position())
            }
            _ => loaded.scene.fixtures[fixture].part.pose,
        }
    }

    fn object_velocity(&self) -> (Vector3<f64>, Vector3<f64>) {
        self.free_body_velocity(self.loaded().selected)
    }

    fn touches(&self) -> &Touches {
        &self.loaded().touches
    }

    fn support(&self) -> Wrench {
        self.loaded().support()
    }

    fn force_between(&self, one: Side, other: Side) -> Option<f64> {
        self.loaded().force_between(one, other)
    }

    fn contact_points(&self) -> Vec<ContactPoint> {
        self.loaded().contact_points()
    }

    fn clearance_below(&mut self, bound: f64) -> Option<f64> {
        let loaded = self.loaded();
        let mut best = bound;
        for (robot, kind) in &loaded.colliders {
            // Fixed parts of the base are at the table's level and have no clearance.
            let Kind::Robot { fixed: false, .. } = kind else { continue };
            let robot = &loaded.world.colliders[*robot];
            let ball = robot.shape().compute_bounding_sphere(robot.position());
            for (other, kind) in &loaded.colliders {
                let Kind::Fixture(fixture) = kind else { continue };
                let centre = [ball.center.x, ball.center.y, ball.center.z];
                let place = self.fixture(*fixture);
                if loaded.scene.fixtures[*fixture].distance_bound_at(&place, centre, ball.radius) >= best {
                    continue;
                }
                let other = &loaded.world.colliders[*other];
                let near = rapier3d_f64::parry::query::contact(
                    robot.position(),
                    robot.shape(),
                    other.position(),
                    other.shape(),
                    best,
                );
                if let Ok(Some(contact)) = near {
                    best = best.min(contact.dist);
                }
            }
        }
        (best < bound).then_some(best)
    }

    fn robot_body(&self, body: usize) -> String {
        self.loaded().bodies.get(body).cloned().unwrap_or_else(|| format!("body {body}"))
    }

    fn state_bits(&self, sink: &mut dyn FnMut(u64)) {
        let loaded = self.loaded();
        let mut put = |x: f64| sink(x.to_bits());
        for joint in &loaded.arm {
            put(loaded.position(*joint, 3));
            put(loaded.velocity(*joint));
        }
        for joint in loaded.fingers.iter().chain(&loaded.bellows) {
            put(loaded.position(*joint, 0));
            put(loaded.velocity(*joint));
        }
        for (body, _) in &loaded.free {
            let object = &loaded.world.bodies[*body];
            let (t, r) = (object.position().translation, object.position().rotation);
            let (v, w) = (object.linvel(), object.angvel());
            [t.x, t.y, t.z, r.x, r.y, r.z, r.w, v.x, v.y, v.z, w.x, w.y, w.z].into_iter().for_each(&mut put);
        }
    }
}

impl Loaded {
    /// The body that is the object.
    fn object(&self) -> RigidBodyHandle {
        self.free[self.selected].0
    }

    /// Position of a joint; axis 0 slides, axis 3 rotates.
    fn position(&self, joint: MultibodyJointHandle, axis: usize) -> f64 {
        let link = self.world.multibody_joints.get(joint).and_then(|(body, id)| body.link(id));
        link.map_or(f64::NAN, |link| link.joint().coords()[axis])
    }

    /// Stiffness of the first servo of the arm, as a multiple of the robot's setting.
    fn arm_stiffness(&self, arm: &Arm) -> Option<f64> {
        let (body, id) = self.world.multibody_joints.get(*self.arm.first()?)?;
        Some(body.link(id)?.joint.data.motor(JointAxis::AngX)?.stiffness / arm.stiffness_nm_rad[0])
    }

    fn velocity(&self, joint: MultibodyJointHandle) -> f64 {
        let Some((body, id)) = self.world.multibody_joints.get(joint) else { return f64::NAN };
        body.link(id).map_or(f64::NAN, |link| body.joint_velocity(link)[0])
    }

    /// Sets the targets of the drives.
    fn drive(&mut self, arm: &Arm, jaw: Option<&ParallelJaw>, targets: &JointTargets) {
        let mut set = |joint: MultibodyJointHandle, axis, position, velocity, stiffness, damping| {
            if let Some((body, id)) = self.world.multibody_joints.get_mut(joint)
                && let Some(link) = body.link_mut(id)
            {
                link.joint.data.set_motor(axis, position, velocity, stiffness, damping);
            }
        };
        for (j, joint) in self.arm.iter().enumerate() {
            let scale = self.scene.arm_stiffness;
            let (stiffness, damping) = (arm.stiffness_nm_rad[j] * scale, arm.damping_nms_rad[j] * scale.sqrt());
            set(*joint, JointAxis::AngX, targets.positions[j], targets.velocities[j], stiffness, damping);
        }
        for (joint, jaw) in self.fingers.iter().zip(jaw.into_iter().cycle()) {
            set(*joint, JointAxis::LinX, targets.finger, 0.0, jaw.stiffness_n_m, jaw.damping_ns_m);
        }
    }

    /// Sets the target of every moving fixture for the end of the next step.
    fn move_fixtures(&mut self, time_step: f64) {
        let time = (self.steps + 1) as f64 * time_step;
        for (fixture, body) in &self.movers {
            let fixture = &self.scene.fixtures[*fixture];
            let (Some(motion), Some(body)) = (fixture.motion, self.world.bodies.get_mut(*body)) else { continue };
            match motion {
                Motion::Straight { .. } => {
                    let at = motion.at(time).translation.vector + fixture.part.pose.translation.vector;
                    body.set_next_kinematic_translation(vector(&at));
                }
                Motion::Belt { .. } => {
                    // In each step it moves from the same place.
                    body.set_position(pose(&fixture.part.pose), false);
                    body.set_next_kinematic_position(pose(&(motion.riding(time_step) * fixture.part.pose)));
                }
                _ => body.set_next_kinematic_position(pose(&(motion.at(time) * fixture.part.pose))),
            }
        }
    }
}
