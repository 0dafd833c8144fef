//! External policies as [`Policy`].

use std::collections::VecDeque;
use std::sync::Arc;
use std::time::{Duration, Instant};

use robogate_core::{
    Action, Fault, Observation, Policy, PredictedStep, Prediction, Seed, Stream, TaskInstance, TaskSpec,
};
use serde_json::Value as Json;

use super::access::Access;
use super::buffers::Buffers;
use super::chunk::Chunk;
use super::connection::{self, Connection};
use super::deadline::Deadline;
use super::decoder::Decoder;
use super::error::PolicyError;
use super::fingerprint::Recorder;
use super::history::History;
use super::openpi;
use super::profile::{Dialect, Profile};
use super::query::Query;
use super::ranges::RangeCounts;
use super::servers::{Place, Servers};
use super::starvla;
use super::suits;

/// Largest time between two attempts to reach a server that is still loading.
const WAITING_PAUSE: Duration = Duration::from_secs(2);

/// A model behind an inference server, or in a file, as a [`Policy`].
///
/// An error during an episode makes the episode invalid and closes the connection, because a late reply must not be
/// used for the next request. The next episode opens a new connection, with up to
/// [`Timeouts::attempts`](super::Timeouts::attempts) attempts. The identity that the policy reports must not change
/// between connections.
pub struct ExternalPolicy {
    servers: Servers,
    profile: Arc<Profile>,
    access: Access,
    /// The connection, and the server that it is to.
    connection: Option<(Box<dyn Connection>, Place)>,
    declared: Json,
    /// Whether this connection has already returned actions.
    warm: bool,
    instruction: String,
    episode: u64,
    step: u64,
    /// Raw actions of the chunk that are not executed yet.
    queue: VecDeque<Vec<f64>>,
    decoder: Decoder,
    history: History,
    buffers: Buffers,
    /// Counts states outside of the range of the checkpoint.
    ranges: Option<RangeCounts>,
    /// Keeps some requests for a fingerprint, and their keys in this episode.
    recorder: Option<(Recorder, Option<Stream>)>,
}

impl std::fmt::Debug for ExternalPolicy {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("ExternalPolicy")
            .field("servers", &self.servers.urls())
            .field("profile", &self.profile.name)
            .finish_non_exhaustive()
    }
}

impl ExternalPolicy {
    /// Connect to the server at `url`, or load the file `url`, in one attempt. Checks the metadata of the policy
    /// against the profile.
    pub fn connect(url: &str, profile: Arc<Profile>) -> Result<Self, PolicyError> {
        Self::connect_with(url, profile, Access::from_environment(), &mut |_| {})
    }

    /// Connect like [`Self::connect`]. If the server does not answer yet, this function tries again until the time of
    /// [`Access::with_wait`] is over, and calls `waiting` before each pause.
    pub fn connect_with(
        url: &str,
        profile: Arc<Profile>,
        access: Access,
        waiting: &mut dyn FnMut(&PolicyError),
    ) -> Result<Self, PolicyError> {
        Self::connect_among(&Servers::of(url), profile, access, waiting)
    }

    /// Connect like [`Self::connect_with`] to the server that drives the fewest episodes.
    pub fn connect_among(
        servers: &Servers,
        profile: Arc<Profile>,
        access: Access,
        waiting: &mut dyn FnMut(&PolicyError),
    ) -> Result<Self, PolicyError> {
        let until = Instant::now() + access.wait();
        let mut limit_s = profile.server.connect_s;
        let connection = loop {
            match any_connection(servers, &profile, &access, limit_s) {
                Ok(connection) => break connection,
                Err(error) if error.is_transient() && Instant::now() < until => {
                    waiting(&error);
                    std::thread::sleep(WAITING_PAUSE.min(until.saturating_duration_since(Instant::now())));
                    limit_s = longer(limit_s, &profile, until);
                }
                Err(error) => return Err(error),
            }
        };
        let declared = connection.0.declared().clone();
        let profile = match profile.dialect {
            Dialect::Openpi { .. } => openpi::with_declared_length(profile, &declared, openpi::LENGTH)?,
            Dialect::StarVla { .. } => openpi::with_declared_length(profile, &declared, starvla::LENGTH)?,
            _ => profile,
        };
        let decoder = Decoder::new(&profile);
        let history = History::new(&profile);
        Ok(Self {
            servers: servers.clone(),
            profile,
            access,
            connection: Some(connection),
            declared,
            warm: false,
            instruction: String::new(),
            episode: 0,
            step: 0,
            queue: VecDeque::new(),
            decoder,
            history,
            buffers: Buffers::default(),
            ranges: None,
            recorder: None,
        })
    }

    /// Count what the model sees outside of the ranges of the profile.
    #[must_use]
    pub fn counting(self, ranges: Option<RangeCounts>) -> Self {
        Self { ranges, ..self }
    }

    /// Offer the requests of all episodes to a recorder.
    #[must_use]
    pub fn recording(self, recorder: Option<Recorder>) -> Self {
        Self { recorder: recorder.map(|recorder| (recorder, None)), ..self }
    }

    /// Send a request of an earlier episode as the first one of a new episode.
    pub fn ask(&mut self, query: &Query) -> Result<Chunk, PolicyError> {
        self.begin(&query.instruction)?;
        let deadline = self.deadline();
        let reply = self.reply(query, deadline);
        self.after(reply)
    }

    /// The answer to a request.
    fn reply(&mut self, query: &Query, deadline: Deadline) -> Result<Chunk, PolicyError> {
        let Some((connection, _)) = self.connection.as_mut() else {
            return Err(PolicyError::Closed { when: "before the episode began".to_owned(), reason: String::new() });
        };
        let _in_progress = self.servers.request();
        connection.infer(query, deadline)
    }

    /// Leaves a server that did not answer.
    fn after(&mut self, reply: Result<Chunk, PolicyError>) -> Result<Chunk, PolicyError> {
        self.warm = reply.is_ok();
        if reply.is_err()
            && let Some((_, place)) = self.connection.take()
        {
            place.failed();
        }
        reply.map_err(|error| self.access.without_key(error))
    }

    /// The metadata that the policy reports.
    pub fn declared(&self) -> &Json {
        &self.declared
    }

    /// Number of actions in a reply: that of the profile, or the one that the server declares. `None` for any number.
    pub fn chunk_length(&self) -> Option<usize> {
        self.profile.chunk.length
    }

    /// Begin an episode with this instruction. Connects again if the connection is closed.
    pub fn begin(&mut self, instruction: &str) -> Result<(), PolicyError> {
        self.queue.clear();
        self.history.clear();
        self.ranges.iter().for_each(RangeCounts::clear);
        self.step = 0;
        self.instruction = self.profile.instruction.clone().unwrap_or_else(|| instruction.to_owned());
        let mut attempt = 0;
        let mut limit_s = self.profile.server.connect_s;
        let until = Instant::now() + self.access.wait();
        loop {
            let reused = self.connection.is_some();
            match self.try_to_begin(limit_s) {
                Ok(()) => break,
                // The server has closed the connection since the last episode: nothing is lost.
                Err(PolicyError::Closed { .. }) if reused => self.connection = None,
                Err(error) => {
                    self.connection = None;
                    attempt += 1;
                    let waits = Instant::now() < until;
                    if !error.is_transient() || (attempt >= self.profile.server.attempts && !waits) {
                        return Err(self.access.without_key(error));
                    }
                    if waits {
                        limit_s = longer(limit_s, &self.profile, until);
                    }
                    let pause = Duration::from_secs(1 << (attempt - 1).min(16));
                    std::thread::sleep(if waits { pause.min(WAITING_PAUSE) } else { pause });
                }
            }
        }
        self.episode += 1;
        Ok(())
    }

    /// Connect within this time if necessary, and announce the episode.
    fn try_to_begin(&mut self, limit_s: f64) -> Result<(), PolicyError> {
        if self.connection.is_none() {
            let (connection, place) = any_connection(&self.servers, &self.profile, &self.access, limit_s)?;
            if *connection.declared() != self.declared {
                return Err(PolicyError::Mismatch(format!(
                    "the policy's metadata changed after a reconnect: now {}, before {}. Hint: if it is still the same \
                     policy, leave out of its metadata what differs between connections, such as a session or a time",
                    connection.declared(),
                    self.declared
                )));
            }
            self.connection = Some((connection, place));
            self.warm = false;
        }
        let deadline = self.deadline();
        self.connection
            .as_mut()
            .map_or(Ok(()), |(connection, _)| connection.begin(&self.instruction, self.episode, deadline))
    }

    /// Request a chunk of actions and check it against the profile.
    pub fn infer(&mut self, observation: &Observation) -> Result<Chunk, PolicyError> {
        if let Some(ranges) = &self.ranges {
            ranges.count(&self.profile, observation)?;
        }
        let query = Query::with_buffers(
            &self.profile,
            observation,
            &self.history,
            &self.instruction,
            self.step,
            &mut self.buffers,
        )?;
        let deadline = self.deadline();
        let reply = self.reply(&query, deadline).and_then(|chunk| chunk.check(&self.profile).map(|()| chunk));
        if let (Ok(_), Some((recorder, Some(keys)))) = (&reply, &mut self.recorder) {
            recorder.offer(keys.bits(), &query);
        }
        query.recycle(&mut self.buffers);
        self.step += 1;
        self.after(reply)
    }

    fn deadline(&self) -> Deadline {
        let timeouts = &self.profile.server;
        Deadline::within(if self.warm { timeouts.answer_s } else { timeouts.first_answer_s })
    }
}

/// A connection to the server that drives the fewest episodes. If it cannot be reached, each of the others is tried once.
fn any_connection(
    servers: &Servers,
    profile: &Profile,
    access: &Access,
    limit_s: f64,
) -> Result<(Box<dyn Connection>, Place), PolicyError> {
    let mut others = servers.urls().len() - 1;
    loop {
        let place = servers.place();
        match connection::connect(place.url(), profile, access, limit_s) {
            Ok(connection) => return Ok((connection, place)),
            Err(error) => {
                place.failed();
                if others == 0 {
                    return Err(error);
                }
                others -= 1;
            }
        }
    }
}

/// Time limit of the next attempt to connect, in seconds: twice the last one, because a server may load its model anew for
/// each connection, but not past the end of the waiting time.
fn longer(limit_s: f64, profile: &Profile, until: Instant) -> f64 {
    let left_s = until.saturating_duration_since(Instant::now()).as_secs_f64();
    (2.0 * limit_s).min(left_s).max(profile.server.connect_s)
}

impl Policy for ExternalPolicy {
    fn check(&self, task: &TaskSpec) -> Result<(), String> {
        suits::check_task(&self.profile, task)
    }

    fn reset(&mut self, task: &TaskSpec, instance: &TaskInstance, seed: Seed) -> Result<(), Fault> {
        if let Some((_, keys)) = &mut self.recorder {
            *keys = Some(seed.stream("fingerprint"));
        }
        self.decoder.begin(task)?;
        Ok(self.begin(&instance.instruction)?)
    }

    fn wants_images(&self) -> bool {
        self.decoder.is_empty()
            && ((self.queue.is_empty() && !self.profile.cameras.is_empty()) || self.history.has_images())
    }

    fn act(&mut self, observation: &Observation) -> Result<Action, Fault> {
        if self.decoder.is_empty() {
            self.history.push(&self.profile, observation)?;
            if self.queue.is_empty() {
                let chunk = self.infer(observation)?;
                self.queue.extend(chunk.into_rows().into_iter().take(self.profile.chunk.execute));
            }
            self.decoder.put(self.queue.pop_front().unwrap_or_default());
        }
        Ok(self.decoder.next(observation)?)
    }

    fn observe(&mut self, observation: &Observation) -> Result<(), Fault> {
        Ok(self.history.push_period(&self.profile, observation, self.decoder.periods)?)
    }

    fn observes_images(&self) -> bool {
        self.history.has_images()
    }

    fn predict(&mut self, observation: &Observation) -> Result<Prediction, Fault> {
        let steps = self.infer(observation)?.into_rows().into_iter().map(PredictedStep::Numbers).collect();
        Ok(Prediction { steps, execute: self.profile.chunk.execute, periods: self.decoder.periods })
    }

    fn perform(&mut self, step: Option<&[f64]>, observation: &Observation) -> Result<Action, Fault> {
        if let Some(numbers) = step {
            self.decoder.put(numbers.to_vec());
        }
        Ok(self.decoder.next(observation)?)
    }
}
