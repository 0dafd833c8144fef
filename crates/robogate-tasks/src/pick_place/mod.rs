//! Pick and place: take an object from the table and put it at a target.
//!
//! [`PickPlace`] makes an engine, a robot and this task a [`robogate_core::Simulator`]. [`Scripted`] is the controller of
//! the paper's baseline. [`remote`] runs the task in an engine of another process.

mod cell;
pub mod claims;
mod disturbance;
#[cfg(feature = "mujoco")]
mod inspect;
mod judge;
mod object;
mod occluder;
mod parameters;
mod placement;
mod referee;
pub mod remote;
mod scene;
mod scripted;
mod simulator;
mod spaces;
mod suite;

pub use cell::{CONTROL_PERIOD_S, ResolvedCell, TIME_LIMIT_S};
pub use disturbance::Disturbance;
#[cfg(feature = "mujoco")]
pub use inspect::{Inspection, Measured, inspect};
pub use object::Shape;
pub use parameters::{ActsOn, ParameterError, ParameterKind, ParameterRow, SceneParameters, parameters};
pub use placement::Placement;
pub use scene::scene;
pub use scripted::Scripted;
pub use simulator::PickPlace;
pub use spaces::{FRANKA_SPACE, built_in_space, built_in_spaces, default_space};
pub use suite::{SuiteMisfit, check_suite};
