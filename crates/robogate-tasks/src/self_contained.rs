//! Tasks with their own world.

use std::sync::Arc;

use robogate_core::{Environment, Fault, Policy, TaskSpec};
use robogate_physics::EngineBuild;

/// A built-in task with its own world and engine. The user chooses neither robot nor engine.
pub trait SelfContained: Sync {
    /// The name on the command line, as in the declaration.
    fn name(&self) -> &'static str;

    /// A short description.
    fn summary(&self) -> &'static str;

    /// The task specification.
    fn task(&self) -> Arc<TaskSpec>;

    /// The parameter space, as TOML.
    fn space(&self) -> &'static str;

    /// The physics engine.
    fn engine(&self) -> EngineBuild;

    /// Creates an environment.
    ///
    /// # Errors
    /// A fault if the world cannot be set up.
    fn environment(&self) -> Result<Box<dyn Environment>, Fault>;

    /// The scripted controller.
    fn controller(&self) -> Box<dyn Policy>;
}
