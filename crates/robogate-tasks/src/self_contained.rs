//! Tasks with their own world.

use std::sync::Arc;

use robogate_core::{Assignment, Environment, Fault, Policy, SettingSpec, TaskSpec};
use robogate_physics::EngineBuild;

/// A built-in task with its own world and engine. The user chooses neither robot nor engine.
pub trait SelfContained: Send + Sync {
    /// The name on the command line, as in the declaration.
    fn name(&self) -> &'static str;

    /// A short description.
    fn summary(&self) -> &'static str;

    /// The task specification.
    fn task(&self) -> Arc<TaskSpec>;

    /// The settings, with the values of this task.
    fn settings(&self) -> Vec<SettingSpec>;

    /// The same task with these values of its settings.
    ///
    /// # Errors
    /// A setting that the task does not have, or a value that it does not accept. The error names what is accepted.
    fn with(&self, settings: &Assignment) -> Result<Arc<dyn SelfContained>, String>;

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
