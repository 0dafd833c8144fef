//! Many worlds that a simulator in another process steps at once, for example on a GPU.
//!
//! Each thread has a [`Member`] with a [`World`] for each of its episodes. A world is compiled by [`MujocoEngine`](crate::MujocoEngine) and
//! sent as numbers, so model, drives and contacts are those of that engine. All members exchange once per control period: when
//! each of them has given its commands, one message to the simulator runs the period in all worlds.
//!
//! Arrays are in files that both processes use; the simulator runs every time step of a period by itself.

mod member;
mod server;
#[cfg(test)]
mod tests;
mod world;

pub use member::{Member, Simulator};
pub use server::{Identity, Server};
pub use world::{Period, StepReport, World};
