//! A task for an arm, as the command selects it.

use robogate_core::{Environment, Policy, TaskSpec};
use robogate_physics::{Chain, Engine, Gripper, Robot, SuctionLaw};

use super::{ArmEnvironment, Rules};

/// A built-in task for an arm in the cell. The user chooses robot and engine.
pub trait ArmTask: Sync {
    /// The name on the command line, as in the declaration.
    fn name(&self) -> &'static str;

    /// A short description.
    fn summary(&self) -> &'static str;

    /// The parameter space for a robot with this gripper, as TOML.
    fn space(&self, gripper: &Gripper) -> &'static str;

    /// The name of the task's built-in suite.
    fn suite(&self) -> &'static str;

    /// Creates an environment on this engine. `grip_force_n` replaces the robot's setting, `suction` is the law of a
    /// suction cup, and camera images have `picture_px` pixels along each side.
    ///
    /// # Errors
    /// If the task does not support the engine's time step or the robot's gripper.
    fn environment(
        &self,
        engine: Box<dyn Engine>,
        grip_force_n: Option<f64>,
        suction: SuctionLaw,
        picture_px: usize,
    ) -> Result<Box<dyn Environment>, String>;

    /// The scripted controller for a robot with these kinematics.
    fn controller(&self, robot: Robot, chain: Chain) -> Box<dyn Policy>;
}

impl<R: Rules + Copy + Sync + 'static> ArmTask for R {
    fn name(&self) -> &'static str {
        R::NAME
    }

    fn summary(&self) -> &'static str {
        R::SUMMARY
    }

    fn space(&self, _: &Gripper) -> &'static str {
        R::SPACE
    }

    fn suite(&self) -> &'static str {
        R::SUITE
    }

    fn environment(
        &self,
        engine: Box<dyn Engine>,
        grip_force_n: Option<f64>,
        suction: SuctionLaw,
        picture_px: usize,
    ) -> Result<Box<dyn Environment>, String> {
        Ok(Box::new(ArmEnvironment::new(*self, engine, grip_force_n, suction, picture_px)?))
    }

    fn controller(&self, robot: Robot, chain: Chain) -> Box<dyn Policy> {
        R::scripted(robot, chain)
    }
}

/// Checks that a scripted controller of the task `name` for this robot drives `task`.
pub(crate) fn drives_task(name: &str, robot: &Robot, task: &TaskSpec) -> Result<(), String> {
    if task.name != *name || task.action.joints() != Some(&*robot.settings.arm.joints) {
        return Err(format!("the scripted controller drives {name} on {}, not {}", robot.name(), task.name));
    }
    Ok(())
}
