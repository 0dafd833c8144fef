//! The built-in tasks, one module each.
//!
//! A task owns its scene, its referee, its scripted controller, its parameters and the claims about its physics. Nothing
//! outside its module uses the task's vocabulary. [`Random`] is a policy without a task.

pub mod pick_place;
mod random;

pub use random::Random;
