//! The one thread that owns the store and the monitor.

use std::sync::mpsc::{Receiver, SyncSender, TrySendError, sync_channel};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use tokio::sync::oneshot;

use super::fleet::Tallies;
use super::intake::{Intake, IntakeError, Taken};
use super::metrics::metrics;
use super::status::Status;

/// Requests that may wait.
const WAITING: usize = 1_024;
/// Requests, and bytes, that share one commit.
const TOGETHER: usize = 256;
const TOGETHER_BYTES: usize = 32 << 20;

/// What an answer may be: the value, or why there is none, in words. `full` tells a full disk from other trouble.
pub(super) type Answer<T> = Result<T, Trouble>;

/// Why the desk could not do what was asked.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Trouble {
    pub(super) full: bool,
    pub(super) because: String,
}

impl From<IntakeError> for Trouble {
    fn from(error: IntakeError) -> Self {
        let full = matches!(error, IntakeError::Store(super::StoreError::Full));
        Self { full, because: error.to_string() }
    }
}

impl From<super::StoreError> for Trouble {
    fn from(error: super::StoreError) -> Self {
        IntakeError::from(error).into()
    }
}

pub(super) enum Job {
    Cycles { batch: Vec<u8>, reply: oneshot::Sender<Answer<Taken>> },
    Status { reply: oneshot::Sender<Answer<Status>> },
    Fleet { reply: oneshot::Sender<Answer<Tallies>> },
    Metrics { reply: oneshot::Sender<Answer<String>> },
    Healthy { reply: oneshot::Sender<Answer<()>> },
    Restart { recipe: String, reply: oneshot::Sender<Answer<bool>> },
    Enrol { output: String, reply: oneshot::Sender<Answer<()>> },
    Undelivered { output: String, most: u32, reply: oneshot::Sender<Answer<Vec<(u64, String)>>> },
    Delivered { output: String, n: u64, reply: oneshot::Sender<Answer<()>> },
    Close { reply: oneshot::Sender<Answer<()>> },
}

/// The desk has more waiting than it can hold, or is closed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("the monitor is busy or closing; send again later")]
pub struct Busy;

/// The thread.
#[derive(Debug)]
pub struct Desk {
    thread: JoinHandle<()>,
    handle: Handle,
}

/// A way to the desk; as many as are wanted.
#[derive(Debug, Clone)]
pub struct Handle(SyncSender<Job>);

impl Desk {
    /// Starts the thread. `say` is told when cycles begin to be refused because the store failed, and when they are taken again.
    pub fn open(intake: Intake, say: impl Fn(&str) + Send + 'static) -> Self {
        let (sender, receiver) = sync_channel(WAITING);
        let mut health = Health { failed: None, probed: None, say: Box::new(say) };
        let thread = std::thread::spawn(move || work(intake, &receiver, &mut health));
        Self { thread, handle: Handle(sender) }
    }

    /// A way to it.
    pub fn handle(&self) -> Handle {
        self.handle.clone()
    }

    /// Does what waits, writes what is to be remembered, and ends the thread.
    ///
    /// # Errors
    /// The store failed, in words; acknowledged cycles are on disk all the same.
    pub fn close(self) -> Result<(), String> {
        let closed = self.handle.wait(|reply| Job::Close { reply });
        let ended = self.thread.join();
        match (closed, ended) {
            (Ok(Ok(())), Ok(())) => Ok(()),
            (Ok(Err(trouble)), _) => Err(trouble.because),
            _ => Err("the monitor's thread ended early".to_owned()),
        }
    }
}

impl Handle {
    /// Hands over a job without waiting.
    pub(super) fn ask<T>(&self, job: impl FnOnce(oneshot::Sender<T>) -> Job) -> Result<oneshot::Receiver<T>, Busy> {
        let (reply, answer) = oneshot::channel();
        match self.0.try_send(job(reply)) {
            Ok(()) => Ok(answer),
            Err(TrySendError::Full(_) | TrySendError::Disconnected(_)) => Err(Busy),
        }
    }

    /// Hands over a job, waiting for room and for the answer. Not for use inside an event loop.
    pub(super) fn wait<T>(&self, job: impl FnOnce(oneshot::Sender<T>) -> Job) -> Result<T, Busy> {
        let (reply, answer) = oneshot::channel();
        self.0.send(job(reply)).map_err(|_| Busy)?;
        answer.blocking_recv().map_err(|_| Busy)
    }

    /// Takes in a batch of lines; what is called accepted is on disk.
    ///
    /// # Errors
    /// Why nothing was taken, in words.
    pub fn take(&self, batch: Vec<u8>) -> Result<Taken, String> {
        match self.wait(|reply| Job::Cycles { batch, reply }) {
            Ok(Ok(taken)) => Ok(taken),
            Ok(Err(trouble)) => Err(trouble.because),
            Err(busy) => Err(busy.to_string()),
        }
    }

    /// Where everything stands.
    ///
    /// # Errors
    /// Why it cannot be said, in words.
    pub fn status(&self) -> Result<Status, String> {
        match self.wait(|reply| Job::Status { reply }) {
            Ok(Ok(status)) => Ok(status),
            Ok(Err(trouble)) => Err(trouble.because),
            Err(busy) => Err(busy.to_string()),
        }
    }
}

/// Time for which an answer about the disk holds: health is asked for by strangers, and asking the disk costs a write.
const PROBE_HOLDS: Duration = Duration::from_secs(1);
/// Time for which a failed batch tells more than the disk's answer to a single small write.
const FAILURE_HOLDS: Duration = Duration::from_secs(60);

/// What is known of the store's health.
struct Health {
    /// Since the last batch failed; nothing once one was written again.
    failed: Option<(Instant, Trouble)>,
    probed: Option<(Instant, Answer<()>)>,
    say: Box<dyn Fn(&str) + Send>,
}

impl Health {
    fn note(&mut self, written: Result<(), &Trouble>) {
        match written {
            Ok(()) if self.failed.take().is_some() => (self.say)("cycles are taken again"),
            Ok(()) => {}
            Err(trouble) => {
                if self.failed.is_none() {
                    (self.say)(&format!("cycles are refused: {}", trouble.because));
                }
                self.failed = Some((Instant::now(), trouble.clone()));
            }
        }
    }

    fn ask(&mut self, intake: &Intake) -> Answer<()> {
        if let Some((_, trouble)) = self.failed.as_ref().filter(|(since, _)| since.elapsed() < FAILURE_HOLDS) {
            return Err(trouble.clone());
        }
        let held = self.probed.take().filter(|(since, _)| since.elapsed() < PROBE_HOLDS);
        let (since, found) = held.unwrap_or_else(|| (Instant::now(), intake.healthy().map_err(Trouble::from)));
        self.probed = Some((since, found.clone()));
        found
    }
}

fn work(mut intake: Intake, jobs: &Receiver<Job>, health: &mut Health) {
    let mut next = jobs.recv().ok();
    while let Some(job) = next.take() {
        match job {
            Job::Cycles { batch, reply } => next = together(&mut intake, jobs, health, batch, reply),
            Job::Close { reply } => {
                answer(reply, intake.close().map_err(Trouble::from));
                return;
            }
            Job::Healthy { reply } => answer(reply, health.ask(&intake)),
            other => quick(&mut intake, other),
        }
        if next.is_none() {
            next = jobs.recv().ok();
        }
    }
}

/// Takes in a batch together with those that wait behind it; returns the first job that is none.
fn together(
    intake: &mut Intake,
    jobs: &Receiver<Job>,
    health: &mut Health,
    first: Vec<u8>,
    reply: oneshot::Sender<Answer<Taken>>,
) -> Option<Job> {
    let mut bytes = first.len();
    let (mut batches, mut replies) = (vec![first], vec![reply]);
    let mut next = None;
    while batches.len() < TOGETHER && bytes < TOGETHER_BYTES && next.is_none() {
        match jobs.try_recv() {
            Ok(Job::Cycles { batch, reply }) => {
                bytes += batch.len();
                batches.push(batch);
                replies.push(reply);
            }
            Ok(other) => next = Some(other),
            Err(_) => break,
        }
    }
    let slices: Vec<&[u8]> = batches.iter().map(Vec::as_slice).collect();
    match intake.take(&slices) {
        Ok(taken) => {
            health.note(Ok(()));
            replies.into_iter().zip(taken).for_each(|(reply, taken)| answer(reply, Ok(taken)));
        }
        Err(error) => {
            let trouble = Trouble::from(error);
            health.note(Err(&trouble));
            replies.into_iter().for_each(|reply| answer(reply, Err(trouble.clone())));
        }
    }
    next
}

fn quick(intake: &mut Intake, job: Job) {
    match job {
        Job::Status { reply } => answer(reply, Status::of(intake).map_err(Trouble::from)),
        Job::Fleet { reply } => answer(reply, Ok(Tallies::of(intake))),
        Job::Metrics { reply } => answer(reply, Ok(metrics(intake))),
        Job::Restart { recipe, reply } => answer(reply, intake.restart(&recipe).map_err(Trouble::from)),
        Job::Enrol { output, reply } => answer(reply, intake.store().enrol(&output).map_err(Trouble::from)),
        Job::Undelivered { output, most, reply } => {
            let store = intake.store();
            let found = store.delivered(&output).and_then(|n| store.alarms_after(n, most));
            answer(reply, found.map_err(Trouble::from));
        }
        Job::Delivered { output, n, reply } => {
            answer(reply, intake.store().set_delivered(&output, n).map_err(Trouble::from));
        }
        // The loop has taken these out.
        Job::Cycles { .. } | Job::Healthy { .. } | Job::Close { .. } => {}
    }
}

/// Whoever asked may have gone away.
fn answer<T>(reply: oneshot::Sender<T>, value: T) {
    let _ = reply.send(value);
}
