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

    /// Identifies the engine that steps its physics.
    ///
    /// # Errors
    /// A fault if the engine cannot be loaded.
    fn engine(&self) -> Result<EngineBuild, Fault>;

    /// Creates an environment.
    ///
    /// # Errors
    /// A fault if the world cannot be set up.
    fn environment(&self) -> Result<Box<dyn Environment>, Fault>;

    /// The scripted controller.
    fn controller(&self) -> Box<dyn Policy>;
}
