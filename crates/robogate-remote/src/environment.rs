//! Simulators whose episodes run in the servers of a pool.

use std::collections::BTreeSet;
use std::sync::Arc;

use robogate_core::{
    Action, Assignment, Ending, Environment, Fault, FaultKind, Foresight, Image, Infeasibility, Measures, Scenario,
    Start, Step, TaskSpec, Trajectory,
};

use super::error::RequestError;
use super::message::Hello;
use super::physics::{PhysicsSession, RemoteTask};
use super::pool::{Lease, Pool};
use super::proposals::{Proposals, RemotePolicy};
use super::scored::ScoredSession;
use super::session::Session;

/// The servers of a pool do not support this use.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("the simulator cannot be used for this task: {0}")]
pub struct IncompatibleServer(String);

/// An environment in another process: a server with its own task, which scores itself.
///
/// Each episode runs in any free server of the pool.
pub struct RemoteEnvironment {
    episodes: Episodes<ScoredSession>,
    /// The cameras that are rendered. `None`: all.
    cameras: Option<Vec<String>>,
}

impl RemoteEnvironment {
    /// Create an environment in the servers of this pool, which must score themselves.
    pub fn new(pool: Arc<Pool>) -> Result<Self, IncompatibleServer> {
        Ok(Self { episodes: Episodes::new(pool, ScoredSession::default())?, cameras: None })
    }

    /// Create an environment like [`RemoteEnvironment::new`], and the declared policy of this name, which runs in the
    /// same server.
    pub fn with_policy(pool: Arc<Pool>, policy: &str) -> Result<(Self, RemotePolicy), IncompatibleServer> {
        let declared = &pool.hello().policies;
        if declared.iter().all(|known| known.name != policy) {
            let known: Vec<&str> = declared.iter().map(|policy| &*policy.name).collect();
            let known = if known.is_empty() { "none".to_owned() } else { known.join(", ") };
            return Err(IncompatibleServer(format!("it declares no policy `{policy}`; its policies: {known}")));
        }
        let proposals = Proposals::new(policy);
        let session = ScoredSession::with_policy(proposals.clone());
        Ok((Self { episodes: Episodes::new(pool, session)?, cameras: None }, RemotePolicy(proposals)))
    }

    /// Render these cameras only. An image that no policy uses costs as much time as any other.
    pub fn with_cameras(self, cameras: Vec<String>) -> Self {
        Self { cameras: Some(cameras), ..self }
    }

    /// Send each action on its own. The actions of a policy of the server may then be changed on their way.
    pub fn in_step(mut self) -> Self {
        self.episodes.session.in_step = true;
        self
    }

    /// Render these cameras, or all.
    fn render_cameras(&mut self, cameras: Option<&[String]>) -> Result<Vec<Image>, Fault> {
        if self.episodes.session.periods_ahead() > 0 {
            let detail = "no images of an episode whose actions come from a policy in the server: it runs ahead";
            return Err(Fault::new(FaultKind::Setup, detail));
        }
        let mut lease = self.episodes.lease.take().ok_or_else(no_episode)?;
        match lease.connection.as_mut().ok_or_else(no_episode)?.render_some(cameras) {
            Ok(images) => {
                self.episodes.lease = Some(lease);
                Ok(images)
            }
            Err(why) => Err(lease.end_with(&why)),
        }
    }

    /// The servers' reply to `hello`.
    pub fn hello(&self) -> &Hello {
        self.episodes.pool.hello()
    }
}

impl Environment for RemoteEnvironment {
    fn task(&self) -> &Arc<TaskSpec> {
        &self.episodes.task
    }

    fn reset(&mut self, scenario: &Scenario) -> Result<Start, Fault> {
        self.episodes.reset(scenario)
    }

    fn step(&mut self, action: &Action) -> Result<Step, Fault> {
        self.episodes.step(action)
    }

    fn draws(&self, _: &Scenario) -> Result<Measures, Fault> {
        Ok(self.episodes.session.draws.clone())
    }

    fn foregone_ending(&self) -> Option<Ending> {
        self.episodes.session.foregone.clone()
    }

    fn render(&mut self) -> Result<Vec<Image>, Fault> {
        let cameras = self.cameras.clone();
        self.render_cameras(cameras.as_deref())
    }

    fn render_only(&mut self, cameras: &[&str]) -> Result<Vec<Image>, Fault> {
        let cameras: Vec<String> = cameras.iter().map(|camera| (*camera).to_owned()).collect();
        let images = self.render_cameras(Some(&cameras))?;
        self.episodes.session.filmed = true;
        Ok(images)
    }

    fn record_trajectory(&mut self, period_s: Option<f64>) {
        self.episodes.session.record(period_s);
    }

    fn take_trajectory(&mut self) -> Option<Trajectory> {
        // A policy that gave up ended the episode before its server did.
        if let Some(connection) = self.episodes.lease.as_mut().and_then(|lease| lease.connection.as_mut()) {
            self.episodes.session.ended(connection);
        }
        self.episodes.session.motion.take()
    }
}

/// A task of this process whose physics is computed by a server.
///
/// Each episode runs in any free server of the pool.
pub struct RemotePhysics<T> {
    episodes: Episodes<PhysicsSession<T>>,
}

impl<T: RemoteTask> RemotePhysics<T> {
    /// Run this task in the servers of this pool, which must not score themselves.
    pub fn new(pool: Arc<Pool>, task: T) -> Result<Self, IncompatibleServer> {
        Ok(Self { episodes: Episodes::new(pool, PhysicsSession(task))? })
    }
}

impl<T: RemoteTask> Environment for RemotePhysics<T> {
    fn task(&self) -> &Arc<TaskSpec> {
        &self.episodes.task
    }

    fn foresight(&self) -> Option<Arc<dyn Foresight>> {
        self.episodes.session.0.foresight()
    }

    fn reset(&mut self, scenario: &Scenario) -> Result<Start, Fault> {
        self.episodes.reset(scenario)
    }

    fn step(&mut self, action: &Action) -> Result<Step, Fault> {
        self.episodes.step(action)
    }

    fn foregone_ending(&self) -> Option<Ending> {
        self.episodes.session.0.foregone_ending()
    }

    fn infeasibility(&self, requested: &Assignment) -> Option<Infeasibility> {
        self.episodes.session.0.infeasibility(requested)
    }

    fn render(&mut self) -> Result<Vec<Image>, Fault> {
        self.episodes.session.0.render()
    }
}

fn no_episode() -> Fault {
    Fault::new(FaultKind::Setup, "no episode is running")
}

/// Runs the episodes of one worker, each in a server that it holds until the episode ends.
struct Episodes<S> {
    pool: Arc<Pool>,
    session: S,
    lease: Option<Lease>,
    /// Whether the episode of the held server ran to its end.
    completed: bool,
    task: Arc<TaskSpec>,
    /// Number of control periods until the time limit.
    limit: u64,
}

impl<S: Session> Episodes<S> {
    fn new(pool: Arc<Pool>, session: S) -> Result<Self, IncompatibleServer> {
        session.accepts(pool.hello()).map_err(IncompatibleServer)?;
        let task = session.task(pool.hello());
        let limit = task.limit_ticks().map_err(|why| IncompatibleServer(why.to_string()))?;
        Ok(Self { pool, session, lease: None, completed: false, task, limit: u64::from(limit) })
    }

    fn reset(&mut self, scenario: &Scenario) -> Result<Start, Fault> {
        let completed = std::mem::take(&mut self.completed);
        if let Some(mut lease) = self.lease.take() {
            lease.release(completed);
        }
        let mut attempts = 1 + self.pool.len();
        // The other servers may be in use while the one that fails is free again and again.
        let mut failed = BTreeSet::new();
        loop {
            let mut lease = self.pool.lease()?;
            let Some(connection) = &mut lease.connection else { continue };
            let reply = self.session.reset(connection, scenario);
            attempts = attempts.saturating_sub(1);
            match reply {
                Ok(start) => {
                    self.lease = Some(lease);
                    return Ok(start);
                }
                Err(why) if why.is_server_failure() => {
                    failed.insert(lease.slot);
                    if attempts == 0 && !self.pool.has_others(&failed) {
                        return Err(lease.end_with(&why));
                    }
                    lease.fail(&why);
                }
                Err(why) => return Err(lease.end_with(&why)),
            }
        }
    }

    fn step(&mut self, action: &Action) -> Result<Step, Fault> {
        let mut lease = self.lease.take().ok_or_else(no_episode)?;
        let connection = lease.connection.as_mut().ok_or_else(no_episode)?;
        let reply = self.session.step(connection, action);
        let tick = connection.tick;
        let over = tick >= self.limit || reply.as_ref().is_ok_and(|step| step.ending.is_some());
        if over && reply.is_ok() {
            self.session.ended(connection);
        }
        let notes = connection.take_notes();
        self.pool.report(notes);
        let step = match reply {
            Ok(step) => step,
            Err(why) => return Err(lease.end_with(&why)),
        };
        // Another worker may be waiting for the server.
        if over && !self.session.keeps_server() {
            lease.release(true);
        } else {
            self.completed = over;
            self.lease = Some(lease);
        }
        Ok(step)
    }
}

impl Lease {
    /// End the use of the server after an error. Returns the fault of the episode.
    fn end_with(mut self, why: &RequestError) -> Fault {
        let fault = why.fault(&self.address);
        if why.is_server_failure() {
            self.fail(why);
        } else {
            self.release(true);
        }
        fault
    }
}
