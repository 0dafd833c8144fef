//! The built-in tasks, one folder each.
//!
//! Each task folder contains its scene, referee, scripted controller, parameters and physics claims. Code outside the
//! folder does not use the task's vocabulary. A task for an arm implements [`ArmTask`], a task with its own world
//! [`SelfContained`]. [`Random`] is a policy for any task with bounded actions.

mod arm;
pub mod file;
pub mod insertion;
#[cfg(feature = "mujoco")]
pub mod pendulum;
pub mod pick_place;
mod random;
mod self_contained;
mod settings;
mod spaces;

#[cfg(feature = "mujoco")]
pub use arm::ArmWorlds;
pub use arm::{ArmDeclaration, ArmEnvironment, ArmSettings, ArmTask, Parameters, Rig, WristSensor};
pub use arm::{claims, remote};
pub use random::Random;
pub use self_contained::SelfContained;
pub use spaces::{built_in_space, built_in_spaces};
