//! The thread that owns the store and the monitor.

use std::sync::mpsc::{Receiver, SyncSender, TrySendError, sync_channel};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use tokio::sync::oneshot;

use super::batch::Batch;
use super::fleet::Tallies;
use super::intake::{Intake, IntakeError, Taken};
use super::metrics::metrics;
use super::status::{Around, Status};
use super::warnings::{HeardPeriods, Periods};

/// The reply to control periods without a detector.
pub(super) const NO_DETECTOR: &str = "this monitor has no detector of warnings. Hint: start it with --warner FILE";
/// Maximum number of waiting requests.
const WAITING: usize = 1_024;
/// Maximum number of requests, and of their bytes, in one commit.
const TOGETHER: usize = 256;
const TOGETHER_BYTES: usize = 4 << 20;

/// The reply to a request: the value, or the problem.
pub(super) type Answer<T> = Result<T, Problem>;

/// A failed request. `full` means that the disk is full.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Problem {
    pub(super) full: bool,
    pub(super) because: String,
}

impl From<IntakeError> for Problem {
    fn from(error: IntakeError) -> Self {
        let full = matches!(error, IntakeError::Store(super::StoreError::Full));
        Self { full, because: error.to_string() }
    }
}

impl From<super::StoreError> for Problem {
    fn from(error: super::StoreError) -> Self {
        IntakeError::from(error).into()
    }
}

pub(super) enum Job {
    Cycles { batch: Batch, reply: oneshot::Sender<Answer<Taken>> },
    Periods { periods: Periods, reply: oneshot::Sender<Answer<Option<HeardPeriods>>> },
    Status { reply: oneshot::Sender<Answer<Status>> },
    Around { recipe: String, until: String, reply: oneshot::Sender<Answer<Around>> },
    Fleet { reply: oneshot::Sender<Answer<Tallies>> },
    Metrics { reply: oneshot::Sender<Answer<String>> },
    Healthy { reply: oneshot::Sender<Answer<()>> },
    Restart { recipe: String, reply: oneshot::Sender<Answer<bool>> },
    Register { output: String, reply: oneshot::Sender<Answer<()>> },
    Undelivered { output: String, most: u32, reply: oneshot::Sender<Answer<Vec<(u64, String)>>> },
    Delivered { output: String, n: u64, reply: oneshot::Sender<Answer<()>> },
    Close { reply: oneshot::Sender<Answer<()>> },
}

/// The error if too many requests wait, or if the engine is closed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("the monitor is busy or closing. Send the request again later")]
pub struct Busy;

/// The thread that owns the store and the monitor.
#[derive(Debug)]
pub struct ServiceEngine {
    thread: JoinHandle<()>,
    handle: Handle,
}

/// A handle to send requests to the engine. It can be cloned.
#[derive(Debug, Clone)]
pub struct Handle(SyncSender<Job>);

impl ServiceEngine {
    /// Starts the thread. `say` receives a message when cycles are refused because the store failed, and when they are
    /// accepted again.
    pub fn open(intake: Intake, say: impl Fn(&str) + Send + 'static) -> Self {
        let (sender, receiver) = sync_channel(WAITING);
        let mut health = Health { failed: None, probed: None, say: Box::new(say) };
        let thread = std::thread::spawn(move || work(intake, &receiver, &mut health));
        Self { thread, handle: Handle(sender) }
    }

    /// Returns a handle to the engine.
    pub fn handle(&self) -> Handle {
        self.handle.clone()
    }

    /// Processes waiting requests, writes the state, and ends the thread.
    ///
    /// # Errors
    /// If the store failed, as text. Acknowledged cycles are on disk in any case.
    pub fn close(self) -> Result<(), String> {
        let closed = self.handle.wait(|reply| Job::Close { reply });
        let ended = self.thread.join();
        match (closed, ended) {
            (Ok(Ok(())), Ok(())) => Ok(()),
            (Ok(Err(problem)), _) => Err(problem.because),
            _ => Err("the thread of the monitor ended early".to_owned()),
        }
    }
}

impl Handle {
    /// Sends a request without waiting.
    pub(super) fn ask<T>(&self, job: impl FnOnce(oneshot::Sender<T>) -> Job) -> Result<oneshot::Receiver<T>, Busy> {
        let (reply, answer) = oneshot::channel();
        match self.0.try_send(job(reply)) {
            Ok(()) => Ok(answer),
            Err(TrySendError::Full(_) | TrySendError::Disconnected(_)) => Err(Busy),
        }
    }

    /// Sends a request and waits for the reply. Do not call it inside an event loop.
    pub(super) fn wait<T>(&self, job: impl FnOnce(oneshot::Sender<T>) -> Job) -> Result<T, Busy> {
        let (reply, answer) = oneshot::channel();
        self.0.send(job(reply)).map_err(|_| Busy)?;
        answer.blocking_recv().map_err(|_| Busy)
    }

    /// Processes a batch of lines. Accepted cycles are on disk when this returns.
    ///
    /// # Errors
    /// The reason why no cycle was accepted, as text.
    pub fn take(&self, batch: Vec<u8>) -> Result<Taken, String> {
        self.take_parsed(Batch::parse(&batch).map_err(|error| error.to_string())?)
    }

    /// The same for the lines of a sender in a network.
    pub(super) fn take_from(&self, sender: &str, batch: &[u8]) -> Result<Taken, String> {
        self.take_parsed(Batch::parse(batch).map_err(|error| error.to_string())?.sent_by(sender))
    }

    /// The same for a parsed batch.
    ///
    /// # Errors
    /// As [`Self::take`].
    pub fn take_parsed(&self, batch: Batch) -> Result<Taken, String> {
        match self.wait(|reply| Job::Cycles { batch, reply }) {
            Ok(Ok(taken)) => Ok(taken),
            Ok(Err(problem)) => Err(problem.because),
            Err(busy) => Err(busy.to_string()),
        }
    }

    /// Processes control periods.
    ///
    /// # Errors
    /// The reason why they were not processed, as text.
    pub fn hear(&self, periods: Periods) -> Result<HeardPeriods, String> {
        match self.wait(|reply| Job::Periods { periods, reply }) {
            Ok(Ok(Some(heard))) => Ok(heard),
            Ok(Ok(None)) => Err(NO_DETECTOR.to_owned()),
            Ok(Err(problem)) => Err(problem.because),
            Err(busy) => Err(busy.to_string()),
        }
    }

    /// The status document.
    ///
    /// # Errors
    /// The reason why it is not available, as text.
    pub fn status(&self) -> Result<Status, String> {
        match self.wait(|reply| Job::Status { reply }) {
            Ok(Ok(status)) => Ok(status),
            Ok(Err(problem)) => Err(problem.because),
            Err(busy) => Err(busy.to_string()),
        }
    }
}

/// Time for which a health check is reused, because each check writes to the disk and needs no token.
const PROBE_HOLDS: Duration = Duration::from_secs(1);
/// Time for which a failed batch outweighs a successful small write.
const FAILURE_HOLDS: Duration = Duration::from_secs(60);

/// The health of the store.
struct Health {
    /// The time and cause of the last failed batch. `None` after a batch was written again.
    failed: Option<(Instant, Problem)>,
    probed: Option<(Instant, Answer<()>)>,
    say: Box<dyn Fn(&str) + Send>,
}

impl Health {
    fn note(&mut self, written: Result<(), &Problem>) {
        match written {
            Ok(()) if self.failed.take().is_some() => (self.say)("cycles are accepted again"),
            Ok(()) => {}
            Err(problem) => {
                if self.failed.is_none() {
                    (self.say)(&format!("cycles are refused: {}", problem.because));
                }
                self.failed = Some((Instant::now(), problem.clone()));
            }
        }
    }

    fn ask(&mut self, intake: &Intake) -> Answer<()> {
        if let Some((_, problem)) = self.failed.as_ref().filter(|(since, _)| since.elapsed() < FAILURE_HOLDS) {
            return Err(problem.clone());
        }
        let held = self.probed.take().filter(|(since, _)| since.elapsed() < PROBE_HOLDS);
        let (since, found) = held.unwrap_or_else(|| (Instant::now(), intake.healthy().map_err(Problem::from)));
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
                answer(reply, intake.close().map_err(Problem::from));
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

/// Processes a batch together with the batches waiting behind it. Returns the first other job.
fn together(
    intake: &mut Intake,
    jobs: &Receiver<Job>,
    health: &mut Health,
    first: Batch,
    reply: oneshot::Sender<Answer<Taken>>,
) -> Option<Job> {
    let mut bytes = first.bytes;
    let (mut batches, mut replies) = (vec![first], vec![reply]);
    let mut next = None;
    while batches.len() < TOGETHER && bytes < TOGETHER_BYTES && next.is_none() {
        match jobs.try_recv() {
            Ok(Job::Cycles { batch, reply }) => {
                bytes += batch.bytes;
                batches.push(batch);
                replies.push(reply);
            }
            Ok(other) => next = Some(other),
            Err(_) => break,
        }
    }
    match intake.take_parsed(batches) {
        Ok(taken) => {
            health.note(Ok(()));
            replies.into_iter().zip(taken).for_each(|(reply, taken)| answer(reply, Ok(taken)));
        }
        Err(error) => {
            let problem = Problem::from(error);
            health.note(Err(&problem));
            replies.into_iter().for_each(|reply| answer(reply, Err(problem.clone())));
        }
    }
    next
}

fn quick(intake: &mut Intake, job: Job) {
    match job {
        Job::Periods { periods, reply } => answer(reply, intake.hear_periods(periods).map_err(Problem::from)),
        Job::Status { reply } => answer(reply, Status::of(intake).map_err(Problem::from)),
        Job::Around { recipe, until, reply } => {
            answer(reply, Around::of(intake, &recipe, &until).map_err(Problem::from));
        }
        Job::Fleet { reply } => answer(reply, Ok(Tallies::of(intake))),
        Job::Metrics { reply } => answer(reply, Ok(metrics(intake))),
        Job::Restart { recipe, reply } => answer(reply, intake.restart(&recipe).map_err(Problem::from)),
        Job::Register { output, reply } => answer(reply, intake.store().register(&output).map_err(Problem::from)),
        Job::Undelivered { output, most, reply } => {
            let store = intake.store();
            let found = store.delivered(&output).and_then(|n| store.alarms_after(n, most));
            answer(reply, found.map_err(Problem::from));
        }
        Job::Delivered { output, n, reply } => {
            answer(reply, intake.store().set_delivered(&output, n).map_err(Problem::from));
        }
        // These are handled by the loop.
        Job::Cycles { .. } | Job::Healthy { .. } | Job::Close { .. } => {}
    }
}

/// Sends a reply. The receiver may have gone away.
fn answer<T>(reply: oneshot::Sender<T>, value: T) {
    let _ = reply.send(value);
}
