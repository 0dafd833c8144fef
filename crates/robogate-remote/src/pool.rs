//! Several servers that act as one simulator for each worker.
//!
//! An episode runs in one server. A server failure is one of these: the server is unreachable, it does not answer in
//! the time, or its reply is invalid. A failure during an episode makes that episode invalid. A failure at a reset
//! sends the episode to another server, because no part of it has run yet. After a failure, a server is not used for 1
//! s; after further consecutive failures, for 2 s, 4 s and 8 s. After [`MAX_FAILURES`] failures without a completed
//! episode in between, it is not used again; a server that this process starts again counts its failures anew once it answers. When no server is left, each further episode is invalid immediately.

use std::collections::BTreeSet;
use std::fmt;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use robogate_core::{Fault, FaultKind};
use robogate_zmtp::Address;

use super::connection::{Connection, Timeouts};
use super::error::{RequestError, violation};
use super::message::Hello;

/// Number of consecutive failures after which a server is not used again.
pub const MAX_FAILURES: u32 = 5;
/// Maximum number of deviations that are reported.
const MAX_NOTES: usize = 100;
/// Longest time that a worker waits for a free server.
const MAX_WAIT: Duration = Duration::from_secs(600);

/// Receives one line of text for each server failure (address, cause and consequence), and one for each kind of
/// deviation from the declared task.
pub type Listener = Box<dyn Fn(&str) + Send + Sync>;

/// Starts a server again after a failure, and returns its new address or the reason why it cannot be started. The
/// argument is its position in the pool.
pub type Restart = Box<dyn Fn(usize) -> Result<Address, String> + Send + Sync>;

/// Connections to servers of the same simulator.
pub struct Pool {
    hello: Hello,
    timeouts: Timeouts,
    slots: Mutex<Vec<Slot>>,
    changed: Condvar,
    listener: Listener,
    /// Deviations that were reported.
    reported: Mutex<BTreeSet<String>>,
    /// Time for which a server is not used after its first failure.
    backoff: Duration,
    restart: Option<Restart>,
}

struct Slot {
    address: Address,
    state: State,
    /// The connection, while the server is not in use.
    connection: Option<Connection>,
    /// Failures since its last completed episode.
    failures: u32,
}

#[derive(Debug, Clone, PartialEq)]
enum State {
    Free,
    InUse,
    BackoffUntil(Instant),
    /// The server is not used again, for this reason.
    Disabled(String),
}

/// An error in creating a pool.
#[derive(Debug, thiserror::Error)]
pub enum PoolError {
    /// The list of addresses is empty.
    #[error("the list of simulators is empty. Expected at least one address")]
    NoServer,
    /// An address is listed twice.
    #[error("{0} is listed twice. A server runs one episode at a time: start one server for each address")]
    Duplicate(Address),
    /// A server does not answer, or its reply is invalid.
    #[error("{address}: {why}")]
    Request {
        /// Address of the server.
        address: Address,
        /// The problem.
        why: RequestError,
    },
    /// Two servers are different simulators.
    #[error("{first} and {other} are different simulators: {difference}")]
    Mismatch {
        /// First server of the pool.
        first: Address,
        /// The server that differs from it.
        other: Address,
        /// The difference.
        difference: String,
    },
}

impl Pool {
    /// Connect to all servers. Their replies to `hello` must be equal.
    pub fn connect(addresses: &[Address], timeouts: Timeouts, listener: Listener) -> Result<Self, PoolError> {
        let mut slots: Vec<Slot> = Vec::new();
        let mut hello: Option<Hello> = None;
        for address in addresses {
            if slots.iter().any(|slot| slot.address == *address) {
                return Err(PoolError::Duplicate(address.clone()));
            }
            let connection = Connection::open(address.clone(), timeouts)
                .map_err(|why| PoolError::Request { address: address.clone(), why })?;
            match &hello {
                None => hello = Some(connection.hello().clone()),
                Some(first) => {
                    if let Some(difference) = difference(first, connection.hello()) {
                        let (first, other) = (slots[0].address.clone(), address.clone());
                        return Err(PoolError::Mismatch { first, other, difference });
                    }
                }
            }
            let (address, connection) = (address.clone(), Some(connection));
            slots.push(Slot { address, state: State::Free, connection, failures: 0 });
        }
        let hello = hello.ok_or(PoolError::NoServer)?;
        let (slots, changed) = (Mutex::new(slots), Condvar::new());
        let (reported, backoff) = (Mutex::default(), Duration::from_secs(1));
        Ok(Self { hello, timeouts, slots, changed, listener, reported, backoff, restart: None })
    }

    /// Start a server again after each of its failures.
    #[must_use]
    pub fn with_restart(mut self, restart: Restart) -> Self {
        self.restart = Some(restart);
        self
    }

    /// Connect to a further server. Its reply to `hello` must equal that of the others.
    pub fn add(&self, address: Address) -> Result<(), PoolError> {
        let connection = Connection::open(address.clone(), self.timeouts)
            .map_err(|why| PoolError::Request { address: address.clone(), why })?;
        let mut slots = self.slots();
        if slots.iter().any(|slot| slot.address == address) {
            return Err(PoolError::Duplicate(address));
        }
        if let Some(difference) = difference(&self.hello, connection.hello()) {
            return Err(PoolError::Mismatch { first: slots[0].address.clone(), other: address, difference });
        }
        slots.push(Slot { address, state: State::Free, connection: Some(connection), failures: 0 });
        self.changed.notify_one();
        Ok(())
    }

    /// Set the time for which a server is not used after its first failure. Each further failure doubles it.
    #[must_use]
    pub fn with_backoff(mut self, first: Duration) -> Self {
        self.backoff = first;
        self
    }

    /// The servers' reply to `hello`.
    pub fn hello(&self) -> &Hello {
        &self.hello
    }

    /// Number of servers.
    pub fn len(&self) -> usize {
        self.slots().len()
    }

    /// Whether the pool has no servers. Always false, because [`Pool::connect`] requires one.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Report each deviation from the declared task once.
    pub(crate) fn report(&self, notes: BTreeSet<String>) {
        for note in notes {
            let mut reported = self.reported.lock().unwrap_or_else(PoisonError::into_inner);
            if reported.len() < MAX_NOTES && reported.insert(note.clone()) {
                (self.listener)(&format!("simulator {}: {note}", self.hello.server.name));
            }
        }
    }

    fn slots(&self) -> MutexGuard<'_, Vec<Slot>> {
        // No code panics between two related writes, so a poisoned lock still guards valid slots.
        self.slots.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Whether there is a usable server besides these.
    pub(crate) fn has_others(&self, than: &BTreeSet<usize>) -> bool {
        let slots = self.slots();
        (0..slots.len()).any(|i| !than.contains(&i) && !matches!(slots[i].state, State::Disabled(_)))
    }

    /// Wait for a free server and connect to it.
    pub(crate) fn lease(self: &Arc<Self>) -> Result<Lease, Fault> {
        let began = Instant::now();
        let mut slots = self.slots();
        loop {
            let now = Instant::now();
            let ready = |slot: &Slot| match slot.state {
                State::Free => true,
                State::BackoffUntil(end) => end <= now,
                State::InUse | State::Disabled(_) => false,
            };
            if let Some(i) = slots.iter().position(ready) {
                slots[i].state = State::InUse;
                let (address, connection) = (slots[i].address.clone(), slots[i].connection.take());
                drop(slots);
                let mut lease = Lease { pool: Arc::clone(self), slot: i, address, connection };
                match lease.connect() {
                    Ok(()) => return Ok(lease),
                    Err(why) => lease.fail(&why),
                }
                slots = self.slots();
                continue;
            }
            let backoffs = slots.iter().filter_map(|slot| match slot.state {
                State::BackoffUntil(end) => Some(end.saturating_duration_since(now)),
                _ => None,
            });
            let in_use = slots.iter().any(|slot| slot.state == State::InUse);
            let wait = match (backoffs.min(), in_use) {
                (Some(backoff), _) => backoff,
                (None, true) => MAX_WAIT,
                (None, false) => {
                    let reasons: Vec<String> = slots.iter().map(ToString::to_string).collect();
                    let detail = format!("no simulator is left: {}", reasons.join("; "));
                    return Err(Fault::new(FaultKind::Unavailable, detail));
                }
            };
            if began.elapsed() >= MAX_WAIT {
                return Err(Fault::new(FaultKind::Unavailable, "all simulators were in use for 10 minutes"));
            }
            slots = self.changed.wait_timeout(slots, wait).unwrap_or_else(PoisonError::into_inner).0;
        }
    }
}

impl fmt::Display for Slot {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match &self.state {
            State::Disabled(why) => write!(f, "{}: {why}", self.address),
            _ => self.address.fmt(f),
        }
    }
}

/// The difference between two servers, or `None`. Their programs may differ.
fn difference(a: &Hello, b: &Hello) -> Option<String> {
    let a = Hello { server: b.server.clone(), ..a.clone() };
    if a == *b {
        return None;
    }
    Some(if a.engine != b.engine {
        format!("the engines are {:?} and {:?}", a.engine, b.engine)
    } else if a.robot != b.robot {
        format!("the robots are {:?} and {:?}", a.robot, b.robot)
    } else if a.task.name != b.task.name || a.task.version != b.task.version {
        let name = |hello: &Hello| format!("`{}` version {}", hello.task.name, hello.task.version);
        format!("the tasks are {} and {}", name(&a), name(b))
    } else if a.task != b.task {
        format!("their declarations of the task `{}` differ", a.task.name)
    } else {
        "their replies to hello differ".to_owned()
    })
}

/// The use of a server for one episode.
pub(crate) struct Lease {
    pool: Arc<Pool>,
    /// Its position in the pool.
    pub(crate) slot: usize,
    pub(crate) address: Address,
    /// `None` after the server was released.
    pub(crate) connection: Option<Connection>,
}

impl Lease {
    /// Connect if there is no connection, and check that the server is still the same simulator.
    fn connect(&mut self) -> Result<(), RequestError> {
        if self.connection.is_none() {
            if let Some(restart) = &self.pool.restart {
                let address = restart(self.slot).map_err(RequestError::NotStarted)?;
                self.pool.slots()[self.slot].address = address.clone();
                self.address = address;
            }
            let connection = Connection::open(self.address.clone(), self.pool.timeouts)?;
            if let Some(difference) = difference(&self.pool.hello, connection.hello()) {
                return Err(violation(format!("the simulator has changed since the start: {difference}")));
            }
            if self.pool.restart.is_some() {
                // It starts and answers: what ended it is an episode, and the next one may run.
                self.pool.slots()[self.slot].failures = 0;
            }
            self.connection = Some(connection);
        }
        Ok(())
    }

    /// Release the server. `completed` says whether its episode ran to the end.
    pub(crate) fn release(&mut self, completed: bool) {
        let connection = self.connection.take();
        let mut slots = self.pool.slots();
        let slot = &mut slots[self.slot];
        if slot.state == State::InUse {
            slot.state = State::Free;
            slot.connection = connection;
            slot.failures = if completed { 0 } else { slot.failures };
            self.pool.changed.notify_one();
        }
    }

    /// Release the server after a failure.
    pub(crate) fn fail(&mut self, why: &RequestError) {
        self.connection = None;
        let mut slots = self.pool.slots();
        let slot = &mut slots[self.slot];
        slot.failures += 1;
        slot.connection = None;
        let consequence = if slot.failures >= MAX_FAILURES {
            slot.state = State::Disabled(why.to_string());
            format!("not used again after {MAX_FAILURES} consecutive failures")
        } else {
            let backoff = self.pool.backoff * 2_u32.pow(slot.failures - 1);
            slot.state = State::BackoffUntil(Instant::now() + backoff);
            format!("next attempt in {} s", backoff.as_secs_f64())
        };
        drop(slots);
        // Wake all workers: one may now use the server, and all must notice when none is left.
        self.pool.changed.notify_all();
        (self.pool.listener)(&format!("simulator {}: {why}; {consequence}", self.address));
    }
}

impl Drop for Lease {
    fn drop(&mut self) {
        if let Some(connection) = &mut self.connection {
            // The episode was abandoned. The next reset ends it in the server.
            connection.disconnect();
            self.release(false);
        }
    }
}
