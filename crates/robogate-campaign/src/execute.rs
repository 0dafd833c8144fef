//! Runs episodes on all cores.
//!
//! Each thread has a station of its own and takes the next index from a shared counter; finished
//! episodes go over a bounded channel to the calling thread. So the order of
//! results is free, and nothing else is: an episode sees its scenario and a station that was reset.

use std::any::Any;
use std::fmt;
use std::io;
use std::num::NonZeroUsize;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::mpsc::{SyncSender, sync_channel};
use std::thread;

use robogate_core::{Assignment, Episode, Fault, FaultKind, Measures, Outcome, Policy, Scenario, Simulator, rollout};

/// What runs episodes: a simulator and a policy of one thread's own. It never leaves its thread.
pub struct Station {
    /// The world.
    pub simulator: Box<dyn Simulator>,
    /// What drives the robot.
    pub policy: Box<dyn Policy>,
}

impl fmt::Debug for Station {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Station").finish_non_exhaustive()
    }
}

/// Makes stations, each within the thread that uses it. All must behave alike: which one runs an
/// episode is left to chance.
pub trait Workshop: Sync {
    /// A new station, or why there can be none.
    fn station(&self) -> Result<Station, Fault>;
}

/// Who runs the episodes.
#[derive(Clone, Copy)]
pub struct Crew<'a> {
    /// Where stations come from.
    pub workshop: &'a dyn Workshop,
    /// How many threads run episodes; the calling thread records them.
    pub threads: NonZeroUsize,
    /// Once this is set (by Ctrl-C, say), no further episode begins; those in flight are finished.
    pub stop: &'a AtomicBool,
}

impl fmt::Debug for Crew<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Crew").field("threads", &self.threads).field("stop", self.stop).finish_non_exhaustive()
    }
}

/// Why not all episodes were run. Those that were are with the receiver already.
#[derive(Debug, thiserror::Error)]
pub enum ExecuteError<E> {
    /// A station could not be made, at the start or after its forerunner panicked.
    #[error("cannot set up simulator and policy: {0}")]
    Station(Fault),
    /// The operating system gives no thread.
    #[error("cannot start a thread: {0}\nhint: try fewer threads")]
    Thread(io::Error),
    /// The receiver had enough.
    #[error(transparent)]
    Receiver(E),
}

enum Message {
    Done(Box<Episode>),
    NoStation(Fault),
}

/// Runs `scenario(0)`, `scenario(1)`, ... up to the first `None`, and hands each episode to `receive`, on the
/// calling thread, in the order in which they finish. Returns early, without an error, once the crew
/// is told to stop.
///
/// A panic in a simulator or a policy costs the episode, which becomes [`Outcome::Invalid`], and
/// the station, which is made anew.
pub fn execute<E>(
    crew: &Crew<'_>,
    scenario: &(dyn Fn(usize) -> Option<Scenario> + Sync),
    receive: &mut dyn FnMut(Episode) -> Result<(), E>,
) -> Result<(), ExecuteError<E>> {
    let next = AtomicUsize::new(0);
    let halt = AtomicBool::new(false);
    let threads = crew.threads.get();
    let worker = Worker { crew, scenario, next: &next, halt: &halt };
    // Nobody waits while the receiver records another's episode; more room would only add to what a kill loses.
    let (sender, receiver) = sync_channel(threads);
    thread::scope(|scope| {
        let mut problem = None;
        for i in 0..threads {
            let sender = sender.clone();
            let spawned =
                thread::Builder::new().name(format!("episodes-{i}")).spawn_scoped(scope, || worker.run(sender));
            if let Err(error) = spawned {
                halt.store(true, Ordering::Relaxed);
                problem = Some(ExecuteError::Thread(error));
                break;
            }
        }
        drop(sender);
        // Ends once every worker has dropped its sender.
        while let Ok(message) = receiver.recv() {
            let received = match message {
                Message::Done(episode) => receive(*episode).map_err(ExecuteError::Receiver),
                Message::NoStation(fault) => Err(ExecuteError::Station(fault)),
            };
            if let Err(error) = received {
                halt.store(true, Ordering::Relaxed);
                let receiver_is_done = matches!(error, ExecuteError::Receiver(_));
                problem.get_or_insert(error);
                if receiver_is_done {
                    break;
                }
            }
        }
        // Whoever waits for room in the channel is let go.
        drop(receiver);
        problem.map_or(Ok(()), Err)
    })
}

struct Worker<'a> {
    crew: &'a Crew<'a>,
    scenario: &'a (dyn Fn(usize) -> Option<Scenario> + Sync),
    next: &'a AtomicUsize,
    halt: &'a AtomicBool,
}

impl Worker<'_> {
    fn run(&self, sender: SyncSender<Message>) {
        let mut station = None;
        while !self.crew.stop.load(Ordering::Relaxed) && !self.halt.load(Ordering::Relaxed) {
            let Some(scenario) = (self.scenario)(self.next.fetch_add(1, Ordering::Relaxed)) else {
                break;
            };
            let message = match self.episode(&mut station, scenario) {
                Ok(episode) => Message::Done(Box::new(episode)),
                Err(fault) => {
                    self.halt.store(true, Ordering::Relaxed);
                    Message::NoStation(fault)
                }
            };
            if sender.send(message).is_err() {
                break;
            }
        }
        discard(station);
    }

    fn episode(&self, station: &mut Option<Station>, scenario: Scenario) -> Result<Episode, Fault> {
        let mut ready = match station.take() {
            Some(ready) => ready,
            None => catch_unwind(AssertUnwindSafe(|| self.crew.workshop.station()))
                .unwrap_or_else(|panic| Err(panicked("the workshop", &*panic)))?,
        };
        // Unwind safe: after a panic nobody looks at the station again.
        let run = AssertUnwindSafe(|| rollout(&mut *ready.simulator, &mut *ready.policy, &scenario));
        match catch_unwind(run) {
            Ok(episode) => {
                *station = Some(ready);
                Ok(episode)
            }
            Err(panic) => {
                discard(Some(ready));
                Ok(lost(scenario, panicked("the simulator or the policy", &*panic)))
            }
        }
    }
}

/// Drops a station that may be in any state.
fn discard(station: Option<Station>) {
    // A second panic says nothing that the first did not.
    let _ = catch_unwind(AssertUnwindSafe(|| drop(station)));
}

fn panicked(who: &str, panic: &(dyn Any + Send)) -> Fault {
    let text = panic.downcast_ref::<String>().map(String::as_str).or_else(|| panic.downcast_ref::<&str>().copied());
    Fault::new(FaultKind::Unavailable, format!("{who} panicked: {}", text.unwrap_or("without a message")))
}

/// The record of an episode of which nothing is left.
fn lost(scenario: Scenario, fault: Fault) -> Episode {
    Episode {
        scenario,
        applied: Assignment::default(),
        outcome: Outcome::Invalid(fault),
        time_s: 0.0,
        phase: None,
        contact: None,
        measures: Measures::default(),
        ticks: 0,
        trajectory_hash: 0,
    }
}
