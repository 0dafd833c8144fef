//! Peg insertion: pick up a square peg and insert it into a hole with a small clearance.
//!
//! [`whitney`] has the limits of wedging and jamming that the physics is verified against, [`parts`] the geometry.

mod controller;
mod parameters;
pub mod parts;
mod referee;
mod scene;
mod spec;
pub mod whitney;

use robogate_core::{Environment, Policy};
use robogate_physics::{Chain, Engine, Gripper, Robot, SuctionLaw};

use crate::arm::{ArmEnvironment, ArmTask};

use self::controller::Scripted;
use self::scene::InsertionRules;

/// The task's name.
const NAME: &str = "insertion";

/// The insertion task.
#[derive(Debug, Clone, Copy)]
pub struct Insertion;

impl ArmTask for Insertion {
    fn name(&self) -> &'static str {
        NAME
    }

    fn summary(&self) -> &'static str {
        "insert a peg into a hole with a small clearance with a robot arm"
    }

    fn space(&self, _: &Gripper) -> &'static str {
        include_str!("space.toml")
    }

    fn suite(&self) -> &'static str {
        "insertion-40"
    }

    fn environment(
        &self,
        engine: Box<dyn Engine>,
        grip_force_n: Option<f64>,
        suction: SuctionLaw,
        picture_px: usize,
    ) -> Result<Box<dyn Environment>, String> {
        Ok(Box::new(ArmEnvironment::new(InsertionRules, engine, grip_force_n, suction, picture_px)?))
    }

    fn controller(&self, robot: Robot, chain: Chain) -> Box<dyn Policy> {
        Box::new(Scripted::new(robot, chain))
    }
}
