//! A thread pool that runs episodes.
//!
//! Each thread has one worker and takes the next index from a shared counter. Finished episodes pass through a bounded
//! channel to the calling thread. Only the order of the results depends on timing: an episode depends on its scenario
//! and on a worker that was reset.

use std::fmt;
use std::num::NonZeroUsize;
use std::ops::ControlFlow;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::mpsc::{SyncSender, sync_channel};
use std::thread;

use robogate_core::guard::guarded;
use robogate_core::{Assignment, Episode, Fault, FaultKind, Foresight, Measures, Outcome, Scenario, rollout};

use crate::{ExecuteError, Executor, Worker, WorkerFactory};

/// An executor with threads of this process.
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

enum Message {
    Done(Box<Episode>),
    NoWorker(Fault),
}

/// After a panic in an environment or a policy, the episode becomes [`Outcome::Invalid`], and a new worker replaces the
/// old one.
impl Executor for ThreadPool<'_> {
    fn parallelism(&self) -> usize {
        self.threads.get()
    }

    fn foresight(&self) -> Result<Option<Arc<dyn Foresight>>, ExecuteError> {
        Ok(self.factory.worker().map_err(ExecuteError::Worker)?.environment.foresight())
    }

    fn execute(
        &self,
        scenario: &(dyn Fn(usize) -> Option<Scenario> + Sync),
        receive: &mut dyn FnMut(Episode) -> ControlFlow<()>,
    ) -> Result<(), ExecuteError> {
        let next = AtomicUsize::new(0);
        let halt = AtomicBool::new(false);
        let threads = self.threads.get();
        let thread = EpisodeThread { pool: self, scenario, next: &next, halt: &halt };
        // The channel has room for one episode per thread, so no thread waits while the receiver records another
        // episode. More room would only increase the loss when the process is killed.
        let (sender, receiver) = sync_channel(threads);
        thread::scope(|scope| {
            let mut problem = None;
            for i in 0..threads {
                let sender = sender.clone();
                let spawned =
                    thread::Builder::new().name(format!("episodes-{i}")).spawn_scoped(scope, || thread.run(sender));
                if let Err(error) = spawned {
                    halt.store(true, Ordering::Relaxed);
                    problem = Some(ExecuteError::Thread(error));
                    break;
                }
            }
            drop(sender);
            // The loop ends when every thread has dropped its sender.
            while let Ok(message) = receiver.recv() {
                match message {
                    Message::Done(episode) => {
                        if receive(*episode).is_break() {
                            halt.store(true, Ordering::Relaxed);
                            break;
                        }
                    }
                    Message::NoWorker(fault) => {
                        halt.store(true, Ordering::Relaxed);
                        problem.get_or_insert(ExecuteError::Worker(fault));
                    }
                }
            }
            // This releases threads that wait for room in the channel.
            drop(receiver);
            problem.map_or(Ok(()), Err)
        })
    }
}

struct EpisodeThread<'a> {
    pool: &'a ThreadPool<'a>,
    scenario: &'a (dyn Fn(usize) -> Option<Scenario> + Sync),
    next: &'a AtomicUsize,
    halt: &'a AtomicBool,
}

impl EpisodeThread<'_> {
    fn run(&self, sender: SyncSender<Message>) {
        let mut worker = None;
        while !self.pool.stop.load(Ordering::Relaxed) && !self.halt.load(Ordering::Relaxed) {
            let Some(scenario) = (self.scenario)(self.next.fetch_add(1, Ordering::Relaxed)) else {
                break;
            };
            let message = match self.episode(&mut worker, scenario) {
                Ok(episode) => Message::Done(Box::new(episode)),
                Err(fault) => {
                    self.halt.store(true, Ordering::Relaxed);
                    Message::NoWorker(fault)
                }
            };
            if sender.send(message).is_err() {
                break;
            }
        }
        discard(worker);
    }

    fn episode(&self, worker: &mut Option<Worker>, scenario: Scenario) -> Result<Episode, Fault> {
        let mut ready = match worker.take() {
            Some(ready) => ready,
            None => guarded(|| self.pool.factory.worker())
                .unwrap_or_else(|why| Err(panicked("the worker factory", &why)))?,
        };
        // The worker is not used again after a panic.
        match guarded(|| rollout(&mut *ready.environment, &mut *ready.policy, &scenario)) {
            Ok(episode) => {
                *worker = Some(ready);
                Ok(episode)
            }
            Err(why) => {
                discard(Some(ready));
                Ok(lost(scenario, panicked("the environment or the policy", &why)))
            }
        }
    }
}

/// Drops a worker that may be in any state.
fn discard(worker: Option<Worker>) {
    // A panic while dropping is ignored, because the first one is already reported.
    let _ = guarded(|| drop(worker));
}

fn panicked(who: &str, why: &str) -> Fault {
    Fault::new(FaultKind::Unavailable, format!("{who} panicked: {why}"))
}

/// The record of an episode whose worker panicked.
fn lost(scenario: Scenario, fault: Fault) -> Episode {
    Episode {
        scenario,
        applied: Assignment::default(),
        outcome: Outcome::Invalid(fault),
        time_s: 0.0,
        phase: None,
        contact: None,
        measures: Measures::default(),
        draws: Default::default(),
        ticks: 0,
        trajectory_hash: 0,
    }
}
