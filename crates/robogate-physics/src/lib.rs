//! Physics of a robot cell: robots, engines, servo, kinematics and suction, without a task.
//!
//! A [`Robot`] is a folder with an MJCF or URDF model and a `robot.toml`. A [`Scene`] describes the bodies in the cell
//! as plain data. An [`Engine`] simulates robot and scene; MuJoCo and Rapier are features of this crate. A [`Plant`]
//! combines an engine with the drives that follow joint commands and the suction cup that holds an object.

pub mod contact;
mod contact_sums;
pub mod description;
#[cfg(feature = "mujoco")]
mod draft;
#[cfg(feature = "mujoco")]
mod drafted_jaw;
mod engine;
mod finger_motion;
#[cfg(any(feature = "mujoco", feature = "rapier"))]
mod friction;
#[cfg(feature = "mujoco")]
mod grasp;
mod gripper_command;
mod hull;
mod includes;
#[cfg(feature = "mujoco")]
mod inspect;
mod joint;
mod kinematics;
mod mass;
mod mesh;
mod mesh_file;
#[cfg(feature = "mujoco")]
mod mesh_files;
#[cfg(feature = "mujoco")]
mod model;
mod motion;
#[cfg(feature = "mujoco")]
pub mod mujoco;
mod named_files;
mod plain;
mod plant;
mod primitive;
#[cfg(feature = "rapier")]
mod rapier;
#[cfg(any(feature = "mujoco", feature = "rapier"))]
mod region;
mod robot;
mod robot_folder;
#[cfg(feature = "mujoco")]
mod robot_model;
mod scene;
mod servo;
mod steering;
pub mod suction;
mod thread;
pub mod trajectory;
mod unrest;
mod visual;
#[cfg(feature = "mujoco")]
pub mod worlds;

#[cfg(feature = "mujoco")]
pub use draft::{Draft, draft};
pub use engine::{
    Collision, Engine, EngineBuild, FixtureRead, FreeBodyRead, Hit, JointTargets, Readback, Side, Touches, Wrench,
};
pub use finger_motion::FingerMotion;
#[cfg(feature = "mujoco")]
pub use grasp::{Grasp, test_grasps};
pub use gripper_command::GripperCommand;
pub use hull::{Hull, MOST_PIECES, Pieces};
#[cfg(feature = "mujoco")]
pub use inspect::{Inspection, Measured, inspect};
pub use joint::{Joint, JointKind, Thread};
pub use kinematics::{Chain, ChainJoint, Unreachable};
pub use mass::MassProperties;
pub use mesh::{Bulk, Mesh};
pub use mesh_file::{MeshProblem, Triangles};
#[cfg(feature = "mujoco")]
pub use model::MujocoModel;
pub use motion::Motion;
#[cfg(feature = "mujoco")]
pub use mujoco::{Input, MujocoEngine, Tape, load_mujoco};
pub use plain::exact_isometry;
pub use plant::{ArmState, GripperState, Plant, StepView, grip_force, state_hash};
pub use primitive::{Part, Primitive};
#[cfg(feature = "rapier")]
pub use rapier::RapierEngine;
pub use robot::{
    Arm, BELLOWS_JOINT, Bellows, FingerDrive, Gripper, ParallelJaw, Problem, Robot, RobotError, RobotFile,
    RobotSettings, RobotSource, Site, SuctionCup, built_in_robot, built_in_robots, is_folder,
};
pub use scene::{
    Fixture, FixtureKind, FreeBody, GRAVITY, GripperUnit, Object, Scene, TABLE_CENTRE, TABLE_HALF, WORKSPACE_CENTRE,
    isometry, pose,
};
pub use servo::Servo;
pub use steering::Steering;
pub use suction::SuctionLaw;
pub use visual::{Color, TableMaterial, Visual};
