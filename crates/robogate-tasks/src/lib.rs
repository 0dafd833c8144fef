//! The built-in tasks, one folder each.
//!
//! Each task folder contains its scene, referee, scripted controller, parameters and physics claims. Code outside the
//! folder does not use the task's vocabulary. A task with its own world implements [`SelfContained`]. [`Random`] is a
//! policy for any task with bounded actions.

#[cfg(feature = "mujoco")]
pub mod pendulum;
pub mod pick_place;
mod random;
mod self_contained;

pub use random::Random;
pub use self_contained::SelfContained;
