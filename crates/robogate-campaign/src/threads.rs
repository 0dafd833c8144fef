//! A thread pool that runs episodes, one at a time in each thread.

use std::fmt;
use std::num::NonZeroUsize;
use std::ops::ControlFlow;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use robogate_core::{Episode, Foresight, Scenario};

use crate::{BatchPool, ExecuteError, Executor, WorkerFactory};

/// An executor with threads of this process, each with one episode in progress: a [`BatchPool`] with one slot.
///
/// After a panic in an environment or a policy, the episode becomes [`Outcome::Invalid`](robogate_core::Outcome::Invalid), and
/// a new worker replaces the old one.
#[derive(Clone, Copy)]
pub struct ThreadPool<'a> {
    /// The source of workers.
    pub factory: &'a dyn WorkerFactory,
    /// The number of threads that run episodes. The calling thread records them.
    pub threads: NonZeroUsize,
    /// Stop flag, for example set by Ctrl-C. No further episode starts; running ones are finished.
    pub stop: &'a AtomicBool,
}

impl fmt::Debug for ThreadPool<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("ThreadPool").field("threads", &self.threads).field("stop", self.stop).finish_non_exhaustive()
    }
}

impl<'a> ThreadPool<'a> {
    fn batches(&self) -> BatchPool<'a> {
        let Self { factory, threads, stop } = *self;
        BatchPool { factory, threads, slots: NonZeroUsize::MIN, stop }
    }
}

impl Executor for ThreadPool<'_> {
    fn parallelism(&self) -> usize {
        self.batches().parallelism()
    }

    fn foresight(&self) -> Result<Option<Arc<dyn Foresight>>, ExecuteError> {
        self.batches().foresight()
    }

    fn execute(
        &self,
        scenario: &(dyn Fn(usize) -> Option<Scenario> + Sync),
        receive: &mut dyn FnMut(Episode) -> ControlFlow<()>,
    ) -> Result<(), ExecuteError> {
        self.batches().execute(scenario, receive)
    }
}
