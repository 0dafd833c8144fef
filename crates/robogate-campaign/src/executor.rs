//! What runs episodes.

use std::fmt;
use std::io;
use std::ops::ControlFlow;

use robogate_core::{Environment, Episode, Fault, Policy, Scenario};

/// An environment and a policy. A worker stays in the thread that made it.
pub struct Worker {
    /// The world and its task.
    pub environment: Box<dyn Environment>,
    /// What drives the robot.
    pub policy: Box<dyn Policy>,
}

impl fmt::Debug for Worker {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Worker").finish_non_exhaustive()
    }
}

/// Makes workers, each within the thread that uses it. All must behave alike: which one runs an episode is arbitrary.
pub trait WorkerFactory: Sync {
    /// A new worker, or why there can be none.
    fn worker(&self) -> Result<Worker, Fault>;
}

/// Runs the episodes of a stage: in threads here ([`crate::ThreadPool`]), or anywhere else.
pub trait Executor {
    /// How many episodes run at once.
    fn parallelism(&self) -> usize;

    /// Runs `scenario(0)`, `scenario(1)`, ... up to the first `None`, and hands each episode to `receive`, on the calling
    /// thread, in the order in which they finish. Returns early, without an error, where `receive` breaks or the
    /// executor is told to stop.
    fn execute(
        &self,
        scenario: &(dyn Fn(usize) -> Option<Scenario> + Sync),
        receive: &mut dyn FnMut(Episode) -> ControlFlow<()>,
    ) -> Result<(), ExecuteError>;
}

/// Why not all episodes were run. The receiver has those that were.
#[derive(Debug, thiserror::Error)]
pub enum ExecuteError {
    /// A worker could not be made, at the start or after another one panicked.
    #[error("cannot set up environment and policy: {0}")]
    Worker(Fault),
    /// The operating system provides no thread.
    #[error("cannot start a thread: {0}\nhint: use fewer threads")]
    Thread(io::Error),
}
