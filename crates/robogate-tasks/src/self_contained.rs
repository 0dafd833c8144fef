//! Tasks that bring their own world.

use std::sync::Arc;

use robogate_core::{Environment, Fault, Policy, TaskSpec};
use robogate_physics::EngineBuild;

/// A built-in task with a world and an engine of its own: no robot and no engine has to be chosen.
pub trait SelfContained: Sync {
    /// Its name on the command line: that of its declaration.
    fn name(&self) -> &'static str;

    /// What it is, in a few words.
    fn summary(&self) -> &'static str;

    /// Its declaration.
    fn task(&self) -> Arc<TaskSpec>;

    /// Its parameter space, as TOML.
    fn space(&self) -> &'static str;

    /// Identifies the engine that steps its physics.
    ///
    /// # Errors
    /// A fault if the engine cannot be loaded.
    fn engine(&self) -> Result<EngineBuild, Fault>;

    /// A new environment.
    ///
    /// # Errors
    /// A fault where the world cannot be set up.
    fn environment(&self) -> Result<Box<dyn Environment>, Fault>;

    /// Its scripted controller.
    fn controller(&self) -> Box<dyn Policy>;
}
