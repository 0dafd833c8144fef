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

/// The task's name.
pub const NAME: &str = "pick_place";

pub use crate::arm::CONTROL_PERIOD_S;
pub use crate::spaces::{FRANKA_SPACE, built_in_space, built_in_spaces};
pub use disturbance::Disturbance;
#[cfg(feature = "mujoco")]
pub use inspect::{Inspection, Measured, TrialEpisode, inspect};
pub use object::Shape;
pub use parameters::SceneParameters;
pub use placement::Placement;
pub use scene::scene;
pub use scripted::Scripted;
pub use settings::{ModeSet, PickPlace, Workspace};
