//! The built-in tasks, one folder each.
//!
//! A task owns its scene, its referee, its scripted controller, its parameters and the claims about its physics. Nothing
//! outside its folder uses the task's vocabulary. A task that brings its own world implements [`SelfContained`].
//! [`Random`] is a policy for any task with bounded actions.

#[cfg(feature = "mujoco")]
pub mod pendulum;
pub mod pick_place;
mod random;
mod self_contained;

pub use random::Random;
pub use self_contained::SelfContained;
