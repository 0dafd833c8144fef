//! The interface of a rigid-body engine. It is independent of the task.

use std::any::Any;

use nalgebra::{Isometry3, Vector3};
use robogate_core::{ContactPoint, Fault, RegionForces};
use serde::{Deserialize, Serialize};

use crate::{Chain, Joint, Motion, Primitive, Robot, Scene, plain};

/// A rigid-body engine that holds one robot and, after [`Engine::load`], one scene.
pub trait Engine: Any {
    /// Identifies the engine and its version.
    fn build(&self) -> EngineBuild;

    /// The robot that the engine was made for.
    fn robot(&self) -> &Robot;

    /// The robot's kinematics, as used by the engine.
    fn chain(&self) -> &Chain;

    /// The time step in seconds.
    fn time_step(&self) -> f64;

    /// Builds the scene and puts the arm at `joints` (rad), at rest, the gripper open.
    fn load(&mut self, scene: &Scene, joints: &[f64]) -> Result<(), Fault>;

    /// Reads the physical quantities of the scene from the engine's state.
    fn read_back(&self) -> Result<Readback, Fault>;

    /// Advances one time step towards these targets.
    fn advance(&mut self, targets: &JointTargets);

    /// Checks that the state is finite and that the engine has issued no warning since the last load.
    fn health(&self) -> Result<(), Fault>;

    /// True joint positions of the arm, in radians.
    fn joint_positions(&self) -> Vec<f64>;

    /// True joint velocities of the arm, in rad/s.
    fn joint_velocities(&self) -> Vec<f64>;

    /// Opening between the pads, in metres; `None` for a gripper without fingers.
    fn opening(&self) -> Option<f64>;

    /// The opening that the position of the fingers' drives stands for, in metres: what the gripper's own controller
    /// measures. It differs from [`Engine::opening`] where a linkage between drive and pads yields.
    fn drive_opening(&self) -> Option<f64> {
        self.opening()
    }

    /// How far the lip of a suction cup is pressed back against its spring, in metres; 0 without a spring.
    fn cup_travel(&self) -> f64 {
        0.0
    }

    /// Selects the free body that is "the object" in all other methods and in [`Touches`]: 0 is the object of the scene,
    /// then come the others. [`Engine::load`] selects 0. A body that the cup holds stays selected.
    fn select(&mut self, body: usize);

    /// Pose of a free body of the scene.
    fn free_body(&self, body: usize) -> Isometry3<f64>;

    /// Velocity (m/s) and angular velocity (rad/s) of the frame of a free body of the scene.
    fn free_body_velocity(&self, body: usize) -> (Vector3<f64>, Vector3<f64>);

    /// Attaches the object to the gripper's cup at their current relative pose, by a stiff joint. [`Engine::load`]
    /// detaches them.
    ///
    /// [`crate::suction`] decides when this happens and when it ends. Does nothing if the gripper has no cup.
    fn attach(&mut self);

    /// Detaches the object from the cup.
    fn detach(&mut self);

    /// Joins a body on a screw and a free body of the scene at their current relative pose, by a stiff joint. [`Engine::load`]
    /// separates them. [`crate::Thread`] says when.
    fn take_up(&mut self, _screw: usize, _body: usize) {}

    /// Separates a body on a screw and the body that it has taken up.
    fn let_go(&mut self, _screw: usize) {}

    /// The wrench of the cup on the object in the last step: joint force and contact force together. `None` while
    /// they are detached.
    fn cup_load(&self) -> Option<Wrench>;

    /// Pose of the tool centre point.
    fn tcp(&self) -> Isometry3<f64>;

    /// Pose of the object's frame.
    fn object(&self) -> Isometry3<f64>;

    /// Current pose of a fixture, by its index in the scene.
    fn fixture(&self, fixture: usize) -> Isometry3<f64>;

    /// Velocity of the object's frame (m/s) and its angular velocity (rad/s).
    fn object_velocity(&self) -> (Vector3<f64>, Vector3<f64>);

    /// Contacts of the last step.
    fn touches(&self) -> &Touches;

    /// Wrench of the fixtures and the other free bodies on the object in the last step, about its centre of mass, along the
    /// axes of the base frame. Computed on request.
    fn support(&self) -> Wrench;

    /// Wrench of everything but the robot on hand and fingers in the last step, about the tool centre point and along its axes, without
    /// weight and inertia of the hand. `None` if the engine does not report it: MuJoCo alone does. Computed on request.
    fn hand_wrench(&self) -> Option<Wrench> {
        None
    }

    /// Value (m or rad) and speed of the joint of a body of the scene. `None` for a body that moves freely.
    fn body_joint(&self, _body: usize) -> Option<[f64; 2]> {
        None
    }

    /// Sum of the normal forces between two sides in the last step, in newtons. `None` if they do not touch. Computed on
    /// request.
    fn force_between(&self, one: Side, other: Side) -> Option<f64>;

    /// Contact points of the last step with their normal forces. Computed on request, because only viewers need them.
    fn contact_points(&self) -> Vec<ContactPoint>;

    /// Smallest distance between the robot and any fixture, in metres, if it is below `bound`.
    fn clearance_below(&mut self, bound: f64) -> Option<f64>;

    /// Name of a robot body, by the index in [`Touches`].
    fn robot_body(&self, body: usize) -> String;

    /// Passes the bits of every position and velocity to `sink`.
    fn state_bits(&self, sink: &mut dyn FnMut(u64));
}

impl<E: Engine + ?Sized> Engine for Box<E> {
    fn build(&self) -> EngineBuild {
        (**self).build()
    }

    fn robot(&self) -> &Robot {
        (**self).robot()
    }

    fn chain(&self) -> &Chain {
        (**self).chain()
    }

    fn time_step(&self) -> f64 {
        (**self).time_step()
    }

    fn load(&mut self, scene: &Scene, joints: &[f64]) -> Result<(), Fault> {
        (**self).load(scene, joints)
    }

    fn read_back(&self) -> Result<Readback, Fault> {
        (**self).read_back()
    }

    fn advance(&mut self, targets: &JointTargets) {
        (**self).advance(targets);
    }

    fn health(&self) -> Result<(), Fault> {
        (**self).health()
    }

    fn joint_positions(&self) -> Vec<f64> {
        (**self).joint_positions()
    }

    fn joint_velocities(&self) -> Vec<f64> {
        (**self).joint_velocities()
    }

    fn opening(&self) -> Option<f64> {
        (**self).opening()
    }

    fn drive_opening(&self) -> Option<f64> {
        (**self).drive_opening()
    }

    fn cup_travel(&self) -> f64 {
        (**self).cup_travel()
    }

    fn select(&mut self, body: usize) {
        (**self).select(body);
    }

    fn free_body(&self, body: usize) -> Isometry3<f64> {
        (**self).free_body(body)
    }

    fn free_body_velocity(&self, body: usize) -> (Vector3<f64>, Vector3<f64>) {
        (**self).free_body_velocity(body)
    }

    fn attach(&mut self) {
        (**self).attach();
    }

    fn detach(&mut self) {
        (**self).detach();
    }

    fn take_up(&mut self, screw: usize, body: usize) {
        (**self).take_up(screw, body);
    }

    fn let_go(&mut self, screw: usize) {
        (**self).let_go(screw);
    }

    fn cup_load(&self) -> Option<Wrench> {
        (**self).cup_load()
    }

    fn tcp(&self) -> Isometry3<f64> {
        (**self).tcp()
    }

    fn object(&self) -> Isometry3<f64> {
        (**self).object()
    }

    fn fixture(&self, fixture: usize) -> Isometry3<f64> {
        (**self).fixture(fixture)
    }

    fn object_velocity(&self) -> (Vector3<f64>, Vector3<f64>) {
        (**self).object_velocity()
    }

    fn touches(&self) -> &Touches {
        (**self).touches()
    }

    fn support(&self) -> Wrench {
        (**self).support()
    }

    fn hand_wrench(&self) -> Option<Wrench> {
        (**self).hand_wrench()
    }

    fn body_joint(&self, body: usize) -> Option<[f64; 2]> {
        (**self).body_joint(body)
    }

    fn force_between(&self, one: Side, other: Side) -> Option<f64> {
        (**self).force_between(one, other)
    }

    fn contact_points(&self) -> Vec<ContactPoint> {
        (**self).contact_points()
    }

    fn clearance_below(&mut self, bound: f64) -> Option<f64> {
        (**self).clearance_below(bound)
    }

    fn robot_body(&self, body: usize) -> String {
        (**self).robot_body(body)
    }

    fn state_bits(&self, sink: &mut dyn FnMut(u64)) {
        (**self).state_bits(sink);
    }
}

/// Identifies an engine's build: results depend on it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct EngineBuild {
    /// The engine's name in commands.
    pub name: &'static str,
    /// The version.
    pub version: String,
    /// SHA-256 digest of the shared library that it runs from, if there is one, in lower-case hexadecimal digits.
    pub sha256: Option<String>,
}

/// Targets of the robot's drives at the end of a time step.
#[derive(Debug, Clone, PartialEq)]
pub struct JointTargets {
    /// Arm joint positions, in radians.
    pub positions: Vec<f64>,
    /// Arm joint velocities, in rad/s.
    pub velocities: Vec<f64>,
    /// Distance of each finger from the closed position, in metres. A gripper without fingers ignores it.
    pub finger: f64,
}

/// A force and a torque. The source states point and axes; for a cup they are the tool centre point and its axes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Wrench {
    /// Force in newtons.
    pub force: Vector3<f64>,
    /// Torque in newton metres.
    pub torque: Vector3<f64>,
}

impl Wrench {
    /// Zero force and zero torque.
    pub const ZERO: Self = Self { force: Vector3::new(0.0, 0.0, 0.0), torque: Vector3::new(0.0, 0.0, 0.0) };

    /// The wrench along the axes of a frame.
    #[cfg(feature = "mujoco")]
    pub(crate) fn in_frame(&self, frame: &Isometry3<f64>) -> Self {
        let along = |vector| frame.inverse_transform_vector(vector);
        Self { force: along(&self.force), torque: along(&self.torque) }
    }

    /// The wrench without another one.
    #[cfg(feature = "mujoco")]
    pub(crate) fn minus(self, other: Option<Self>) -> Self {
        let other = other.unwrap_or(Self::ZERO);
        Self { force: self.force - other.force, torque: self.torque - other.torque }
    }
}

/// Physical quantities of the scene, as read from an engine.
#[derive(Debug, Clone, PartialEq)]
pub struct Readback {
    /// Friction coefficient that acts between the object and everything but the table.
    pub friction: f64,
    /// Friction coefficient that acts between the object and the table.
    pub table_friction: f64,
    /// Friction coefficient that acts between the object and the pads; `None` without pads.
    pub pad_friction: Option<f64>,
    /// Friction coefficients of the bodies that have their own, by the body's index. The ones above are those of the others, and
    /// not a number if there are none.
    pub own_friction: Vec<(usize, f64)>,
    /// Gravity, in m/s^2, downwards.
    pub gravity: f64,
    /// Stiffness of the arm's servos as a multiple of the robot's setting; `None` if the engine does not report it.
    pub arm_stiffness: Option<f64>,
    /// Mass of the object in kilograms.
    pub mass_kg: f64,
    /// Centre of mass in the object's frame, in metres.
    pub centre_of_mass: Vector3<f64>,
    /// The object's parts.
    pub parts: Vec<Primitive>,
    /// The object's pose.
    pub object: Isometry3<f64>,
    /// The other free bodies, in the order of the scene.
    pub others: Vec<FreeBodyRead>,
    /// The fixtures, in any order.
    pub fixtures: Vec<FixtureRead>,
    /// The joints of bodies, by the body's index: axis and anchor of the scene, all numbers as they act in the engine.
    pub joints: Vec<(usize, Joint)>,
}

/// A free body other than the object, as read from an engine.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct FreeBodyRead {
    /// Mass in kilograms.
    pub mass_kg: f64,
    /// Centre of mass in the body's frame, in metres.
    #[serde(with = "plain")]
    pub centre_of_mass: Vector3<f64>,
    /// The body's parts.
    pub parts: Vec<Primitive>,
    /// The pose.
    #[serde(with = "plain")]
    pub pose: Isometry3<f64>,
}

/// A fixture, as read from an engine.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct FixtureRead {
    /// The index in the scene.
    pub fixture: usize,
    /// The shape; `None` if it is not a primitive.
    pub primitive: Option<Primitive>,
    /// The pose.
    #[serde(with = "plain")]
    pub pose: Isometry3<f64>,
    /// The motion, if it moves.
    pub motion: Option<Motion>,
    /// Its friction coefficient, if it has its own.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub friction: Option<f64>,
}

/// Contacts of one time step. Forces are normal forces in newtons.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Touches {
    /// Force of each finger on the object; `None` without contact.
    pub fingers: [Option<f64>; 2],
    /// Whether any other part of the robot touches the object.
    pub body_on_object: bool,
    /// Whether the object touches a fixture or another free body.
    pub object_on_fixture: bool,
    /// The strongest contact of the robot with a fixture or with itself.
    pub collision: Option<Collision>,
    /// The largest contact force on any body of the robot.
    pub peak_force: Option<f64>,
    /// The largest contact force of each region of the robot. Empty where an engine in another process does not report it.
    pub regions: RegionForces,
    /// What the fingers press against each other through one thing. `None` where an engine in another process does not report it.
    pub squeeze: Option<f64>,
}

impl Touches {
    /// The force of a gripper that holds with `grip_force_n` newtons, as far as its fingers press against each other: two that push one
    /// thing the same way hold nothing.
    pub fn grip(&self, grip_force_n: f64) -> f64 {
        self.squeeze.map_or(grip_force_n, |squeeze| squeeze.min(grip_force_n))
    }
}

/// A contact of the robot with a fixture or with itself.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Collision {
    /// The robot's body, for [`Engine::robot_body`].
    pub robot_body: usize,
    /// The body that it hit.
    pub hit: Hit,
    /// Normal force in newtons.
    pub force: f64,
}

/// What a contact is between.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Side {
    /// Any part of the robot.
    Robot,
    /// A body of the scene that moves freely or on a joint, by its index.
    Body(usize),
    /// A fixture, by its index in the scene.
    Fixture(usize),
}

/// The body that the robot hit.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Hit {
    /// A fixture, by its index in the scene.
    Fixture(usize),
    /// Another body of the robot, for [`Engine::robot_body`]. MuJoCo alone reports such contacts.
    Itself(usize),
}

impl Hit {
    /// The name in reports: that of the fixture, or `self (BODY)`. `fixture` and `body` return the names.
    pub fn name(self, fixture: impl FnOnce(usize) -> String, body: impl FnOnce(usize) -> String) -> String {
        match self {
            Self::Fixture(index) => fixture(index),
            Self::Itself(index) => format!("self ({})", body(index)),
        }
    }
}
