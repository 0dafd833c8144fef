//! A task for an arm, as the command selects it.

use robogate_core::{Environment, Policy};
use robogate_physics::{Chain, Engine, Gripper, Robot, SuctionLaw};

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
