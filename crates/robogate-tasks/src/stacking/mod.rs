//! Stacking: put two parts on a third one, in a given order and with a given offset.
//!
//! Three equal cubes stand on the table. The first one of the order stays where it is; the arm stacks the other two on
//! it. [`statics`] has the limits of overhang that the physics is verified against.

mod controller;
mod foresight;
mod parameters;
mod referee;
mod scene;
mod spec;
pub mod statics;

/// The task's name.
const NAME: &str = "stacking";

/// The stacking task.
#[derive(Debug, Clone, Copy)]
pub struct Stacking;
