//! Pick and place: pick up an object from the table and place it at a target.
//!
//! [`PickPlace`] combines an engine, a robot and this task into a [`robogate_core::Environment`]. [`Scripted`] is the
//! controller of the paper's baseline. [`remote`] runs the task on an engine in another process.

mod cell;
pub mod claims;
mod disturbance;
mod feasibility;
mod foresight;
#[cfg(feature = "mujoco")]
mod inspect;
mod judge;
mod object;
mod occluder;
mod parameters;
mod placement;
mod referee;
pub mod remote;
mod rules;
mod scene;
mod scripted;
mod simulator;
mod spaces;
pub mod spec;
mod suite;
mod tool_expert;

/// The task's name.
pub const NAME: &str = "pick_place";

/// A short description of the task.
pub const SUMMARY: &str = "pick a part from a table with a robot arm and place it at a target";

pub use cell::{CONTROL_PERIOD_S, ResolvedCell, TIME_LIMIT_S};
pub use disturbance::Disturbance;
pub use foresight::PickPlaceForesight;
#[cfg(feature = "mujoco")]
pub use inspect::{Inspection, Measured, TrialEpisode, inspect};
pub use object::Shape;
pub use parameters::{ActsOn, ParameterError, ParameterRow, SceneParameters, parameters};
pub use placement::Placement;
pub use rules::{ModeSet, Rules, Workspace};
pub use scene::scene;
pub use scripted::Scripted;
pub use simulator::PickPlace;
pub use spaces::{FRANKA_SPACE, built_in_space, built_in_spaces, default_space, unit_space};
pub use suite::{SuiteMisfit, check_suite};
pub use tool_expert::ToolExpert;
