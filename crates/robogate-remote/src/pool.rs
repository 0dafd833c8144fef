//! Several servers as one simulator for each worker.
//!
//! An episode runs in one server. A server fails when it cannot be reached, does not answer in time, or answers what
//! cannot be right. A failure in the middle of an episode makes that episode Invalid; one at its reset, when
//! nothing has happened yet, sends the episode to another server. After a failure a server rests for 1 s, after the
//! next in a row for 2 s, then 4 s and 8 s; after [`GIVE_UP`] failures without a whole episode between them it is not asked
//! again. When none is left every further episode is Invalid at once.

use std::fmt;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use robogate_core::{Action, Fault, FaultKind, Image, Scenario, Simulator, Start, Step};

use super::client::World;
use super::link::{AskError, Link, Patience};
use super::message::Hello;
use robogate_zmtp::Address;

/// Failures in a row after which a server is not asked again.
pub const GIVE_UP: u32 = 5;
/// How long a worker waits for a server that others use.
const WAIT: Duration = Duration::from_secs(600);

/// Hears of every failure of a server: its address, what happened, what follows.
pub type Listener = Box<dyn Fn(&str) + Send + Sync>;

/// Servers that are the same simulator.
pub struct Pool {
    hello: Hello,
    patience: Patience,
    slots: Mutex<Vec<Slot>>,
    freed: Condvar,
    listener: Listener,
    /// How long a server rests after its first failure.
    rest: Duration,
}

struct Slot {
    address: Address,
    state: State,
    /// Its connection, while nobody uses it.
    link: Option<Link>,
    /// Failures since its last whole episode.
    failures: u32,
}

#[derive(Debug, Clone, PartialEq)]
enum State {
    Free,
    Used,
    RestsUntil(Instant),
    GivenUp(String),
}

/// Why there is no pool.
#[derive(Debug, thiserror::Error)]
pub enum PoolError {
    /// No server was named, or one twice.
    #[error("{0}")]
    Servers(String),
    /// One does not answer as it should.
    #[error("{address}: {why}")]
    Ask {
        /// Its address.
        address: Address,
        /// What is wrong.
        why: AskError,
    },
    /// Two are not the same simulator.
    #[error("{first} and {other} are not the same simulator: {what}")]
    Differ {
        /// The first of the pool.
        first: Address,
        /// The other.
        other: Address,
        /// In what they differ.
        what: String,
    },
}

impl Pool {
    /// Connects to every server. All must say the same of themselves.
    pub fn connect(addresses: &[Address], patience: Patience, listener: Listener) -> Result<Self, PoolError> {
        let mut slots: Vec<Slot> = Vec::new();
        let mut hello: Option<Hello> = None;
        for address in addresses {
            if slots.iter().any(|slot| slot.address == *address) {
                return Err(PoolError::Servers(format!(
                    "{address} is named twice: a server runs one episode at a time"
                )));
            }
            let link = Link::connect(address.clone(), patience)
                .map_err(|why| PoolError::Ask { address: address.clone(), why })?;
            match &hello {
                None => hello = Some(link.hello().clone()),
                Some(first) => {
                    if let Some(what) = difference(first, link.hello()) {
                        let (first, other) = (slots[0].address.clone(), address.clone());
                        return Err(PoolError::Differ { first, other, what });
                    }
                }
            }
            slots.push(Slot { address: address.clone(), state: State::Free, link: Some(link), failures: 0 });
        }
        let hello = hello.ok_or_else(|| PoolError::Servers("no simulator is named".to_owned()))?;
        Ok(Self {
            hello,
            patience,
            slots: Mutex::new(slots),
            freed: Condvar::new(),
            listener,
            rest: Duration::from_secs(1),
        })
    }

    /// The same pool, a server resting so long after its first failure, and twice as long after each further one.
    #[must_use]
    pub fn resting(mut self, first: Duration) -> Self {
        self.rest = first;
        self
    }

    /// What the servers say of themselves.
    pub fn hello(&self) -> &Hello {
        &self.hello
    }

    /// How many servers there are.
    pub fn len(&self) -> usize {
        self.slots().len()
    }

    /// Whether there are none; there always are.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    fn slots(&self) -> MutexGuard<'_, Vec<Slot>> {
        // A worker that panicked left no slot half written.
        self.slots.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// A server that nobody uses, as soon as there is one.
    fn lease(self: &Arc<Self>) -> Result<Lease, Fault> {
        let began = Instant::now();
        let mut slots = self.slots();
        loop {
            let now = Instant::now();
            let ready = |slot: &Slot| match slot.state {
                State::Free => true,
                State::RestsUntil(when) => when <= now,
                State::Used | State::GivenUp(_) => false,
            };
            if let Some(i) = slots.iter().position(ready) {
                slots[i].state = State::Used;
                let (address, link) = (slots[i].address.clone(), slots[i].link.take());
                drop(slots);
                let mut lease = Lease { pool: Arc::clone(self), slot: i, address, link };
                match lease.connect() {
                    Ok(()) => return Ok(lease),
                    Err(why) => lease.failed(&why),
                }
                slots = self.slots();
                continue;
            }
            let wakes = slots.iter().filter_map(|slot| match slot.state {
                State::RestsUntil(when) => Some(when.saturating_duration_since(now)),
                _ => None,
            });
            let used = slots.iter().any(|slot| slot.state == State::Used);
            let patience = match (wakes.min(), used) {
                (Some(rest), _) => rest,
                (None, true) => WAIT,
                (None, false) => {
                    let why: Vec<String> = slots.iter().map(ToString::to_string).collect();
                    let detail = format!("no simulator is left: {}", why.join("; "));
                    return Err(Fault::new(FaultKind::Unavailable, detail));
                }
            };
            if began.elapsed() >= WAIT {
                return Err(Fault::new(FaultKind::Unavailable, "every simulator has been in use for ten minutes"));
            }
            slots = self.freed.wait_timeout(slots, patience).unwrap_or_else(PoisonError::into_inner).0;
        }
    }
}

impl fmt::Display for Slot {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match &self.state {
            State::GivenUp(why) => write!(f, "{}: {why}", self.address),
            _ => self.address.fmt(f),
        }
    }
}

/// In what two servers differ, if they do. Their programs may.
fn difference(a: &Hello, b: &Hello) -> Option<String> {
    let a = Hello { server: b.server.clone(), ..a.clone() };
    if a == *b {
        return None;
    }
    Some(if a.engine != b.engine {
        format!("their engines are {:?} and {:?}", a.engine, b.engine)
    } else if a.robot != b.robot {
        format!("their robots are {:?} and {:?}", a.robot, b.robot)
    } else {
        "they say different things of themselves in hello".to_owned()
    })
}

/// The use of a server for one episode.
struct Lease {
    pool: Arc<Pool>,
    slot: usize,
    address: Address,
    /// Gone once the server is given back.
    link: Option<Link>,
}

impl Lease {
    /// Connects where there is no connection, and makes sure that it is still the same simulator.
    fn connect(&mut self) -> Result<(), AskError> {
        if self.link.is_none() {
            let link = Link::connect(self.address.clone(), self.pool.patience)?;
            if let Some(what) = difference(&self.pool.hello, link.hello()) {
                return Err(AskError::Lie(format!("it is not the simulator that it was: {what}")));
            }
            self.link = Some(link);
        }
        Ok(())
    }

    /// Gives the server back; `whole` after an episode that ran to its end.
    fn done(&mut self, whole: bool) {
        let link = self.link.take();
        let mut slots = self.pool.slots();
        let slot = &mut slots[self.slot];
        if slot.state == State::Used {
            slot.state = State::Free;
            slot.link = link;
            slot.failures = if whole { 0 } else { slot.failures };
            self.pool.freed.notify_one();
        }
    }

    /// Gives it back after a failure.
    fn failed(&mut self, why: &AskError) {
        self.link = None;
        let mut slots = self.pool.slots();
        let slot = &mut slots[self.slot];
        slot.failures += 1;
        slot.link = None;
        let follows = if slot.failures >= GIVE_UP {
            slot.state = State::GivenUp(why.to_string());
            format!("it is not asked again after {GIVE_UP} failures in a row")
        } else {
            let rest = self.pool.rest * 2_u32.pow(slot.failures - 1);
            slot.state = State::RestsUntil(Instant::now() + rest);
            format!("it is asked again in {} s", rest.as_secs_f64())
        };
        drop(slots);
        // All: one may take it when it has rested, or all may have to know that it is gone.
        self.pool.freed.notify_all();
        (self.pool.listener)(&format!("simulator {}: {why}; {follows}", self.address));
    }
}

impl Drop for Lease {
    fn drop(&mut self) {
        if let Some(link) = &mut self.link {
            // In the middle of something: the server learns by the next reset.
            link.disconnect();
            self.done(false);
        }
    }
}

/// A simulator in whichever server of a pool is free.
pub struct Remote<W> {
    pool: Arc<Pool>,
    /// Where the servers do not judge.
    world: Option<W>,
    lease: Option<Lease>,
    /// Control periods until the time limit.
    limit: u64,
}

impl<W: World> Remote<W> {
    /// A simulator in this pool; `world` is there exactly where its servers do not judge.
    pub fn new(pool: Arc<Pool>, world: Option<W>) -> Result<Self, String> {
        let hello = pool.hello();
        match &world {
            Some(_) if hello.judges => return Err("this simulator judges its own world".to_owned()),
            None if !hello.judges => return Err("this simulator does not judge: it needs a world".to_owned()),
            Some(world) => world.accepts(hello)?,
            None => {}
        }
        Ok(Self { pool, world, lease: None, limit: 0 })
    }

    /// Ends the use of the server after an answer.
    fn settle<T>(&mut self, mut lease: Lease, answer: Result<T, AskError>) -> Result<T, Fault> {
        answer.map_err(|why| {
            let fault = why.fault(&lease.address);
            if why.blames_server() {
                lease.failed(&why)
            } else {
                lease.done(true)
            }
            fault
        })
    }
}

impl<W: World> Simulator for Remote<W> {
    fn reset(&mut self, scenario: &Scenario) -> Result<Start, Fault> {
        if let Some(mut lease) = self.lease.take() {
            lease.done(false);
        }
        let mut tries = 1 + self.pool.len();
        loop {
            let mut lease = self.pool.lease()?;
            let Some(link) = &mut lease.link else { continue };
            let answer = link.reset(scenario, self.world.as_mut());
            tries -= 1;
            match answer {
                Ok(start) => {
                    self.limit = (start.task.time_limit_s / start.task.control_period_s).round() as u64;
                    self.lease = Some(lease);
                    return Ok(start);
                }
                Err(why) if why.blames_server() && tries > 0 => lease.failed(&why),
                Err(why) => return self.settle(lease, Err(why)),
            }
        }
    }

    fn step(&mut self, action: &Action) -> Result<Step, Fault> {
        let no_episode = || Fault::new(FaultKind::Setup, "no episode is under way");
        let mut lease = self.lease.take().ok_or_else(no_episode)?;
        let link = lease.link.as_mut().ok_or_else(no_episode)?;
        let answer = link.step(action, self.world.as_mut());
        let tick = link.tick;
        let step = match answer {
            Ok(step) => step,
            Err(why) => return self.settle(lease, Err(why)),
        };
        // Another worker may be waiting for the server.
        if step.ending.is_some() || tick >= self.limit {
            lease.done(true);
        } else {
            self.lease = Some(lease);
        }
        Ok(step)
    }

    fn render(&mut self) -> Result<Vec<Image>, Fault> {
        if let Some(world) = &mut self.world {
            return world.render();
        }
        let no_episode = || Fault::new(FaultKind::Setup, "no episode is under way");
        let mut lease = self.lease.take().ok_or_else(no_episode)?;
        match lease.link.as_mut().ok_or_else(no_episode)?.render() {
            Ok(images) => {
                self.lease = Some(lease);
                Ok(images)
            }
            Err(why) => self.settle(lease, Err(why)),
        }
    }
}
