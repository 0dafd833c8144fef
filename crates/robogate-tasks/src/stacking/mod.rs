//! Stacking: put two parts on a third one, in a given order and with a given offset.
//!
//! Three equal cubes stand on the table. The first one of the order stays where it is; the arm stacks the other two on
//! it. [`statics`] has the limits of overhang that the physics is verified against.

mod controller;
mod parameters;
mod referee;
mod scene;
mod spec;
pub mod statics;

use robogate_core::{Environment, Policy};
use robogate_physics::{Chain, Engine, Gripper, Robot, SuctionLaw};

use crate::arm::{ArmEnvironment, ArmTask};

use self::controller::Scripted;
use self::scene::StackRules;

/// The task's name.
const NAME: &str = "stacking";

/// The stacking task.
#[derive(Debug, Clone, Copy)]
pub struct Stacking;

impl ArmTask for Stacking {
    fn name(&self) -> &'static str {
        NAME
    }

    fn summary(&self) -> &'static str {
        "stack two parts on a third one with a robot arm, in a given order and with a given offset"
    }

    fn space(&self, _: &Gripper) -> &'static str {
        include_str!("space.toml")
    }

    fn suite(&self) -> &'static str {
        "stacking-40"
    }

    fn environment(
        &self,
        engine: Box<dyn Engine>,
        grip_force_n: Option<f64>,
        suction: SuctionLaw,
        picture_px: usize,
    ) -> Result<Box<dyn Environment>, String> {
        Ok(Box::new(ArmEnvironment::new(StackRules, engine, grip_force_n, suction, picture_px)?))
    }

    fn controller(&self, robot: Robot, chain: Chain) -> Box<dyn Policy> {
        Box::new(Scripted::new(robot, chain))
    }
}
