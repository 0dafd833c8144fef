//! Executors and the workers that run episodes.

use std::fmt;
use std::io;
use std::num::NonZeroUsize;
use std::ops::ControlFlow;
use std::sync::Arc;

use robogate_core::{
    BatchEnvironment, BatchPolicy, Environment, Episode, Fault, FaultKind, Foresight, Policy, Scenario,
    SingleEnvironments, SinglePolicies, Tick,
};

use robogate_dictionary::LostEpisode;

/// An environment with a policy. A worker stays in the thread that created it.
pub struct Worker {
    /// The environment with its task.
    pub environment: Box<dyn Environment>,
    /// The policy that drives the robot.
    pub policy: Box<dyn Policy>,
}

impl fmt::Debug for Worker {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Worker").finish_non_exhaustive()
    }
}

/// A batch environment with a policy for all of its slots. A batch worker stays in the thread that created it.
pub struct BatchWorker {
    /// The environment with its task.
    pub environment: Box<dyn BatchEnvironment>,
    /// The policy that drives the robots.
    pub policy: Box<dyn BatchPolicy>,
}

impl fmt::Debug for BatchWorker {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("BatchWorker").finish_non_exhaustive()
    }
}

/// Watches one episode of a campaign while it runs. It cannot change the episode.
pub trait EpisodeObserver {
    /// Sees a control period.
    fn observe(&mut self, tick: &Tick<'_>);

    /// Sees the record of the episode.
    fn finish(self: Box<Self>, episode: &Episode);
}

/// Creates workers, each in the thread that uses it. All workers must behave the same, because any of them may run an
/// episode.
pub trait WorkerFactory: Sync {
    /// Creates a worker. Returns a fault if that is impossible.
    fn worker(&self) -> Result<Worker, Fault>;

    /// Creates a worker with this many slots. By default each slot has a worker of its own. A simulator that steps many
    /// worlds at once, or a policy that answers many observations together, replaces them. A simulator may have fewer slots
    /// than requested. Returns a fault if no such worker can be created.
    fn batch_worker(&self, slots: NonZeroUsize) -> Result<BatchWorker, Fault> {
        single_workers(self, slots)
    }

    /// The observer of an episode that is about to start. `None` by default.
    fn observer(&self) -> Option<Box<dyn EpisodeObserver>> {
        None
    }
}

/// A worker with this many slots, each with a worker of its own.
///
/// # Errors
/// If a worker cannot be created.
pub fn single_workers(factory: &(impl WorkerFactory + ?Sized), slots: NonZeroUsize) -> Result<BatchWorker, Fault> {
    let (mut environments, mut policies) = (Vec::new(), Vec::new());
    for _ in 0..slots.get() {
        let Worker { environment, policy } = factory.worker()?;
        environments.push(environment);
        policies.push(policy);
    }
    let environment = SingleEnvironments::new(environments)
        .ok_or_else(|| Fault::new(FaultKind::Setup, "a worker needs at least one slot"))?;
    Ok(BatchWorker { environment: Box::new(environment), policy: Box::new(SinglePolicies::new(policies)) })
}

/// Runs the episodes of a stage: in threads of this process, each with one episode in progress ([`crate::ThreadPool`]) or
/// with several ([`crate::BatchPool`]), or elsewhere.
pub trait Executor {
    /// The number of episodes that run at once.
    fn parallelism(&self) -> usize;

    /// The knowledge of the task about episodes before they run, for the active stage. `None` if the task has none.
    ///
    /// # Errors
    /// If no worker can be created to ask.
    fn foresight(&self) -> Result<Option<Arc<dyn Foresight>>, ExecuteError> {
        Ok(None)
    }

    /// Runs `scenario(0)`, `scenario(1)`, ... up to the first `None`. Passes each episode to `receive` on the calling
    /// thread, in the order in which episodes finish. Returns early without an error if `receive` breaks or the
    /// executor is stopped.
    fn execute(
        &self,
        scenario: &(dyn Fn(usize) -> Option<Scenario> + Sync),
        receive: &mut dyn FnMut(Episode) -> ControlFlow<()>,
    ) -> Result<(), ExecuteError>;

    /// Takes the attempts since the last call that an infrastructure fault lost. The executor runs these episodes again,
    /// or leaves them to a resumed run. Empty for an executor that runs each episode once.
    fn take_lost(&self) -> Vec<LostEpisode> {
        Vec::new()
    }
}

/// The reason why not all episodes ran. The receiver has the finished ones.
#[derive(Debug, thiserror::Error)]
pub enum ExecuteError {
    /// A worker could not be created, at the start or after another one panicked.
    #[error("cannot set up environment and policy: {0}")]
    Worker(Fault),
    /// The operating system could not start a thread.
    #[error("cannot start a thread: {0}\nHint: use fewer threads")]
    Thread(io::Error),
}
