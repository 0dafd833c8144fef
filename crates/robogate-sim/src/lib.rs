//! RoboGate's own world: a robot at a table, an object, obstacles, a target; the physics under it and
//! the scripted controller that drives it.
//!
//! A [`Robot`] is a folder (MJCF and `robot.toml`). [`Scene`] says in neutral terms what stands in the
//! cell; an [`Engine`] gives it physics (MuJoCo and Rapier, each a feature of this crate); [`PickPlace`] makes an
//! engine, a robot and the task a [`robogate_core::Simulator`]. [`Scripted`] is the policy of the paper's baseline.

pub mod camera;
mod cell;
pub mod claims;
mod description;
mod disturbance;
mod engine;
#[cfg(feature = "mujoco")]
mod inspect;
mod judge;
mod kinematics;
#[cfg(feature = "mujoco")]
mod mujoco;
mod object;
mod occluder;
pub mod offsite;
mod parameters;
mod pick_place;
mod plant;
mod random;
#[cfg(feature = "rapier")]
mod rapier;
mod referee;
mod robot;
#[cfg(feature = "mujoco")]
mod robot_model;
mod scene;
mod scripted;
mod servo;
mod spaces;
mod steering;
pub mod suction;
mod suite;
mod trajectory;
mod visual;

pub use cell::{CONTROL_PERIOD_S, ResolvedCell, TIME_LIMIT_S};
pub use disturbance::{Disturbance, Motion};
pub use engine::{Collision, Engine, EngineBuild, FixtureRead, JointTargets, Readback, Touches, Wrench};
#[cfg(feature = "mujoco")]
pub use inspect::{Inspection, Measured, inspect};
pub use kinematics::{Chain, ChainJoint, Unreachable};
#[cfg(feature = "mujoco")]
pub use mujoco::MujocoEngine;
pub use object::{MassProperties, ObjectModel, Part, Primitive, Shape};
pub use parameters::{ParameterError, Placement, SceneParameters};
pub use pick_place::PickPlace;
pub use random::Random;
#[cfg(feature = "rapier")]
pub use rapier::RapierEngine;
pub use robot::{
    Arm, Gripper, ParallelJaw, Problem, Robot, RobotError, RobotFile, RobotSettings, RobotSource, Site, SuctionCup,
    built_in_robot, built_in_robots, is_folder,
};
pub use scene::{Fixture, FixtureKind, Scene, WORKSPACE_CENTRE};
pub use scripted::Scripted;
pub use spaces::{FRANKA_SPACE, built_in_space, built_in_spaces, default_space};
pub use steering::Steering;
pub use suction::SuctionLaw;
pub use suite::{SuiteMisfit, check_suite};
pub use visual::{Color, FRONT_CAMERA, TableMaterial, Visual};
