//! Threads that run episodes, each with several episodes in progress.
//!
//! A thread has one batch worker. Each of its slots takes the next index from a counter that all threads share. Finished
//! episodes pass through a bounded channel to the calling thread. Only the order of the results depends on timing and on
//! the number of slots: an episode depends on its scenario and on a slot that was reset.

use std::collections::VecDeque;
use std::fmt;
use std::num::NonZeroUsize;
use std::ops::ControlFlow;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::mpsc::{SyncSender, sync_channel};
use std::thread;

use robogate_core::guard::guarded;
use robogate_core::{
    Assignment, BatchEnvironment, Episode, Fault, FaultKind, Foresight, Measures, Outcome, Scenario, Tick, Workload,
    rollout_many,
};

use crate::{EpisodeObserver, ExecuteError, Executor, WorkerFactory};

/// An executor with threads of this process, each with a batch of episodes in progress.
///
/// The files of a campaign are the same for any number of threads and slots. An environment that occupies something for the
/// whole episode, such as a server of a pool, needs one of it for each slot of each thread; with fewer, a thread would wait for
/// itself.
///
/// After a panic in an environment or a policy, it is unknown which episode caused it. The episodes in progress then run again,
/// each alone in a new worker. The one that panics again becomes [`Outcome::Invalid`].
#[derive(Clone, Copy)]
pub struct BatchPool<'a> {
    /// The source of workers ([`WorkerFactory::batch_worker`]).
    pub factory: &'a dyn WorkerFactory,
    /// The number of threads that run episodes. The calling thread records them.
    pub threads: NonZeroUsize,
    /// The number of episodes that each thread has in progress.
    pub slots: NonZeroUsize,
    /// Stop flag, for example set by Ctrl-C. No further episode starts; running ones are finished.
    pub stop: &'a AtomicBool,
}

impl fmt::Debug for BatchPool<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { threads, slots, stop, .. } = self;
        let mut shown = f.debug_struct("BatchPool");
        shown.field("threads", threads).field("slots", slots).field("stop", stop).finish_non_exhaustive()
    }
}

enum Message {
    Done(Box<Episode>),
    NoWorker(Fault),
}

impl Executor for BatchPool<'_> {
    fn parallelism(&self) -> usize {
        self.threads.get().saturating_mul(self.slots.get())
    }

    fn foresight(&self) -> Result<Option<Arc<dyn Foresight>>, ExecuteError> {
        let worker = self.factory.batch_worker(NonZeroUsize::MIN).map_err(ExecuteError::Worker)?;
        Ok(worker.environment.foresight())
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

/// What all threads share.
struct EpisodeThread<'a> {
    pool: &'a BatchPool<'a>,
    scenario: &'a (dyn Fn(usize) -> Option<Scenario> + Sync),
    next: &'a AtomicUsize,
    halt: &'a AtomicBool,
}

impl EpisodeThread<'_> {
    fn run(&self, sender: SyncSender<Message>) {
        let (due, running, observers) = (VecDeque::new(), Vec::new(), Vec::new());
        let mut episodes = Episodes { thread: self, sender, due, running, observers, only_due: false };
        self.batches(&mut episodes, self.pool.slots);
    }

    /// Runs episodes in batches of this many slots until no further episode starts. A panic ends a batch.
    fn batches(&self, episodes: &mut Episodes<'_>, slots: NonZeroUsize) {
        while episodes.any_due() {
            let worker = guarded(|| self.pool.factory.batch_worker(slots))
                .unwrap_or_else(|why| Err(panicked("the worker factory", &why)));
            let mut worker = match worker {
                Ok(worker) => worker,
                Err(fault) => return episodes.no_worker(fault),
            };
            let ran = guarded(|| rollout_many(&mut *worker.environment, &mut *worker.policy, episodes));
            // The worker may be in any state after a panic. A second panic is ignored, because the first one is reported.
            let _ = guarded(|| drop(worker));
            if let Err(why) = ran {
                self.after_panic(episodes, &why);
            }
        }
    }

    /// Runs the episodes that a panic has ended, each alone. A single one has caused the panic.
    fn after_panic(&self, episodes: &mut Episodes<'_>, why: &str) {
        let running = std::mem::take(&mut episodes.running);
        episodes.observers.clear();
        if running.len() > 1 {
            episodes.due.extend(running.into_iter().map(|(_, scenario)| scenario));
            episodes.only_due = true;
            self.batches(episodes, NonZeroUsize::MIN);
            episodes.only_due = false;
            return;
        }
        let cause = running.into_iter().map(|(_, scenario)| scenario).next();
        if let Some(scenario) = cause.or_else(|| episodes.due.pop_front()) {
            let fault = panicked("the environment or the policy", why);
            // Without a receiver, no further episode starts.
            let _ = episodes.send(Message::Done(Box::new(lost(scenario, fault))));
        }
    }
}

/// The episodes of one thread.
struct Episodes<'a> {
    thread: &'a EpisodeThread<'a>,
    sender: SyncSender<Message>,
    /// Scenarios that this thread has taken and not started.
    due: VecDeque<Scenario>,
    /// Episodes in progress, with their slots.
    running: Vec<(usize, Scenario)>,
    /// The observers of the episodes in progress that have one, with their slots.
    observers: Vec<(usize, Box<dyn EpisodeObserver>)>,
    /// Whether this thread takes no other scenarios than those that are due.
    only_due: bool,
}

impl Episodes<'_> {
    fn stopped(&self) -> bool {
        self.thread.pool.stop.load(Ordering::Relaxed) || self.thread.halt.load(Ordering::Relaxed)
    }

    /// Whether another episode starts. No worker is created without one.
    fn any_due(&mut self) -> bool {
        if self.stopped() {
            return false;
        }
        if self.due.is_empty() && !self.only_due {
            self.due.extend((self.thread.scenario)(self.thread.next.fetch_add(1, Ordering::Relaxed)));
        }
        !self.due.is_empty()
    }

    fn no_worker(&mut self, fault: Fault) {
        self.thread.halt.store(true, Ordering::Relaxed);
        // Without a receiver, another problem is reported.
        let _ = self.send(Message::NoWorker(fault));
    }

    /// Breaks if the receiver takes no further episodes.
    fn send(&mut self, message: Message) -> ControlFlow<()> {
        match self.sender.send(message) {
            Ok(()) => ControlFlow::Continue(()),
            Err(_) => {
                self.thread.halt.store(true, Ordering::Relaxed);
                ControlFlow::Break(())
            }
        }
    }
}

impl Workload for Episodes<'_> {
    fn next(&mut self, slot: usize) -> Option<Scenario> {
        if !self.any_due() {
            return None;
        }
        let scenario = self.due.pop_front()?;
        self.running.push((slot, scenario.clone()));
        self.observers.extend(self.thread.pool.factory.observer().map(|observer| (slot, observer)));
        Some(scenario)
    }

    fn observe(&mut self, slot: usize, tick: Tick<'_>) {
        if let Some((_, observer)) = self.observers.iter_mut().find(|(of, _)| *of == slot) {
            observer.observe(&tick);
        }
    }

    fn finished(&mut self, slot: usize, episode: Episode, _: &mut dyn BatchEnvironment) -> ControlFlow<()> {
        self.running.retain(|(running, _)| *running != slot);
        if let Some(at) = self.observers.iter().position(|(of, _)| *of == slot) {
            self.observers.swap_remove(at).1.finish(&episode);
        }
        self.send(Message::Done(Box::new(episode)))
    }
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
