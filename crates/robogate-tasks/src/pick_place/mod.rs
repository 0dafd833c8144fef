//! Pick and place: pick up an object from the table and place it at a target.
//!
//! [`PickPlace`] is the task with its settings. [`Scripted`] is the controller of the paper's baseline.

mod cell;
mod claims;
mod disturbance;
mod feasibility;
mod foresight;
#[cfg(feature = "mujoco")]
mod inspect;
mod object;
mod occluder;
mod parameters;
mod placement;
mod readback;
mod referee;
mod scene;
mod scripted;
mod settings;
pub mod spec;
mod task;

use robogate_physics::Gripper;

/// The task's name.
pub const NAME: &str = "pick_place";

/// A short description of the task.
pub const SUMMARY: &str = "pick a part from a table with a robot arm and place it at a target";

pub use crate::arm::CONTROL_PERIOD_S;
pub use crate::spaces::{FRANKA_SPACE, built_in_space, built_in_spaces};
pub use cell::ResolvedCell;
pub use disturbance::Disturbance;
pub use foresight::PickPlaceForesight;
#[cfg(feature = "mujoco")]
pub use inspect::{Inspection, Measured, TrialEpisode, inspect};
pub use object::Shape;
pub use parameters::SceneParameters;
pub use placement::Placement;
pub use scene::scene;
pub use scripted::Scripted;
pub use settings::{ModeSet, PickPlace, Workspace};

/// The name of the default parameter space for a robot with this gripper.
fn default_space(gripper: &Gripper) -> &'static str {
    match gripper {
        Gripper::ParallelJaw(_) => "franka",
        Gripper::Suction(_) => "ur",
    }
}
