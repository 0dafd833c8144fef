//! Physics only: what a rigid-body engine must do for the cell.

use nalgebra::{Isometry3, Vector3};
use robogate_core::Fault;

use crate::{Chain, Motion, Primitive, Robot, Scene};

/// A rigid-body engine that holds one robot and, after [`Engine::load`], one scene.
pub trait Engine {
    /// Which engine it is, exactly.
    fn build(&self) -> EngineBuild;

    /// The robot it was made for.
    fn robot(&self) -> &Robot;

    /// The robot's kinematics, as the engine has them.
    fn chain(&self) -> &Chain;

    /// The time step in seconds.
    fn time_step(&self) -> f64;

    /// Builds the scene and puts the arm at `joints` (rad), at rest, the gripper open.
    fn load(&mut self, scene: &Scene, joints: &[f64]) -> Result<(), Fault>;

    /// What the engine holds of the scene, read from its own state.
    fn read_back(&self) -> Result<Readback, Fault>;

    /// Advances one time step towards these targets.
    fn advance(&mut self, targets: &JointTargets);

    /// Whether the state is still one to believe: finite, and no engine warning since the last load.
    fn health(&self) -> Result<(), Fault>;

    /// True joint positions of the arm, in radians.
    fn joint_positions(&self) -> Vec<f64>;

    /// True joint velocities of the arm, in rad/s.
    fn joint_velocities(&self) -> Vec<f64>;

    /// Opening between the pads, in metres; `None` for a gripper without fingers.
    fn opening(&self) -> Option<f64>;

    /// Joins the object to the gripper's cup as the two stand now, with next to no give. Loading parts them.
    ///
    /// When this happens and when it ends is no matter of the engine ([`crate::suction`]). Does nothing where the
    /// gripper has no cup.
    fn join(&mut self);

    /// Parts the object from the cup.
    fn part(&mut self);

    /// What the cup did to the object in the last step, the joint's force and that of contact together;
    /// `None` while they are parted.
    fn cup_load(&self) -> Option<Wrench>;

    /// Pose of the tool centre point.
    fn tcp(&self) -> Isometry3<f64>;

    /// Pose of the object (the centre of its bounding box).
    fn object(&self) -> Isometry3<f64>;

    /// Pose of a fixture, by its position in the scene; of one that moves, where it is now.
    fn fixture(&self, fixture: usize) -> Isometry3<f64>;

    /// Velocity of the object's frame (m/s) and its angular velocity (rad/s).
    fn object_velocity(&self) -> (Vector3<f64>, Vector3<f64>);

    /// Who touched whom in the last step.
    fn touches(&self) -> &Touches;

    /// Smallest distance between the robot and any fixture, in metres, where it is below `bound`.
    fn clearance_below(&mut self, bound: f64) -> Option<f64>;

    /// The name of a robot body, by the number that [`Touches`] gives.
    fn robot_body(&self, body: usize) -> String;

    /// The bits of every position and velocity.
    fn state_bits(&self, sink: &mut dyn FnMut(u64));
}

/// What makes an engine's numbers its own.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct EngineBuild {
    /// The engine's name in commands.
    pub name: &'static str,
    /// Its version.
    pub version: String,
    /// The file that it runs from, where it is a library of its own.
    pub library: Option<std::path::PathBuf>,
}

/// Where the robot's drives shall be after a time step.
#[derive(Debug, Clone, PartialEq)]
pub struct JointTargets {
    /// Arm joint positions, in radians.
    pub positions: Vec<f64>,
    /// Arm joint velocities, in rad/s.
    pub velocities: Vec<f64>,
    /// Distance of each finger from the closed position, in metres; without meaning for a gripper without fingers.
    pub finger: f64,
}

/// A force and a torque, about the tool centre point and along its axes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Wrench {
    /// Force in newtons.
    pub force: Vector3<f64>,
    /// Torque in newton metres.
    pub torque: Vector3<f64>,
}

impl Wrench {
    /// No force and no torque.
    pub const ZERO: Self = Self { force: Vector3::new(0.0, 0.0, 0.0), torque: Vector3::new(0.0, 0.0, 0.0) };
}

/// Parameters as an engine holds them.
#[derive(Debug, Clone, PartialEq)]
pub struct Readback {
    /// Friction coefficient of the object's shapes.
    pub friction: f64,
    /// Friction coefficient between the object and the table.
    pub table_friction: f64,
    /// Gravity, in m/s^2, downwards.
    pub gravity: f64,
    /// Mass of the object in kilograms.
    pub mass_kg: f64,
    /// Centre of mass in the object's frame, in metres.
    pub centre_of_mass: Vector3<f64>,
    /// The object's parts.
    pub parts: Vec<Primitive>,
    /// The object's pose.
    pub object: Isometry3<f64>,
    /// The fixtures, in any order.
    pub fixtures: Vec<FixtureRead>,
}

/// A fixture as an engine holds it.
#[derive(Debug, Clone, PartialEq)]
pub struct FixtureRead {
    /// Its position in the scene.
    pub fixture: usize,
    /// Its shape; `None` where it is none of the scene's.
    pub primitive: Option<Primitive>,
    /// Where it stands.
    pub pose: Isometry3<f64>,
    /// How it will move.
    pub motion: Option<Motion>,
}

/// Who touched whom in one time step. Forces are normal forces in newtons.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Touches {
    /// Force of each finger on the object; `None` where they do not touch.
    pub fingers: [Option<f64>; 2],
    /// Whether any other part of the robot touches the object.
    pub body_on_object: bool,
    /// Whether the object touches a fixture.
    pub object_on_fixture: bool,
    /// The strongest contact of the robot with a fixture.
    pub collision: Option<Collision>,
    /// The largest force between the robot and anything.
    pub peak_force: Option<f64>,
}

/// A contact of the robot with a fixture.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Collision {
    /// The robot's body, for [`Engine::robot_body`].
    pub robot_body: usize,
    /// The fixture's position in the scene.
    pub fixture: usize,
    /// Normal force in newtons.
    pub force: f64,
}
