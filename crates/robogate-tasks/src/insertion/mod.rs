//! Peg insertion: pick up a square peg and insert it into a hole with a small clearance.
//!
//! [`whitney`] has the limits of wedging and jamming that the physics is verified against, [`parts`] the geometry.

mod controller;
mod foresight;
mod parameters;
pub mod parts;
mod referee;
mod scene;
mod spec;
pub mod whitney;

/// The task's name.
const NAME: &str = "insertion";

/// The insertion task.
#[derive(Debug, Clone, Copy)]
pub struct Insertion;
