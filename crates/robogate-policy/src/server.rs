//! A policy that lives behind a socket.

use std::collections::VecDeque;
use std::sync::Arc;
use std::time::Duration;

use robogate_core::{Action, Command, Fault, Observation, Policy, Seed, TaskInstance, TaskSpec};
use serde_json::Value as Json;

use super::error::ServerError;
use super::exchange::{Chunk, Query};
use super::link::{self, Link};
use super::profile::Profile;
use super::spare::Spare;
use super::suits;
use super::websocket::Deadline;

/// A model behind its own inference server, seen as a [`Policy`].
///
/// What breaks while an episode runs makes that episode invalid, never a failure, and ends the connection: an answer
/// that comes too late must not be taken for the next one. The next episode begins with a new connection, tried
/// [`Patience::attempts`](super::Patience::attempts) times. What the server says of itself must then be what it said
/// at first.
pub struct ServerPolicy {
    url: String,
    profile: Arc<Profile>,
    link: Option<Box<dyn Link>>,
    declared: Json,
    /// Whether this connection has given an answer.
    warm: bool,
    instruction: String,
    episode: u64,
    step: u64,
    /// Raw actions of the chunk that are still to be executed.
    queue: VecDeque<Vec<f64>>,
    /// Smallest and largest value of each number of a vector action, where the task takes one.
    bounds: Vec<(f64, f64)>,
    /// Where the next question's pictures go.
    spare: Spare,
}

impl std::fmt::Debug for ServerPolicy {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("ServerPolicy")
            .field("url", &self.url)
            .field("profile", &self.profile.name)
            .finish_non_exhaustive()
    }
}

impl ServerPolicy {
    /// Connects, once, and holds what the server says of itself against the profile.
    pub fn connect(url: &str, profile: Arc<Profile>) -> Result<Self, ServerError> {
        let link = link::connect(url, &profile)?;
        let declared = link.declared().clone();
        Ok(Self {
            url: url.to_owned(),
            profile,
            link: Some(link),
            declared,
            warm: false,
            instruction: String::new(),
            episode: 0,
            step: 0,
            queue: VecDeque::new(),
            bounds: Vec::new(),
            spare: Spare::default(),
        })
    }

    /// What the server says of itself.
    pub fn declared(&self) -> &Json {
        &self.declared
    }

    /// Begins an episode with this instruction, on a new connection where there is none.
    pub fn begin(&mut self, instruction: &str) -> Result<(), ServerError> {
        self.queue.clear();
        self.step = 0;
        self.instruction = self.profile.instruction.clone().unwrap_or_else(|| instruction.to_owned());
        let mut attempt = 0;
        loop {
            match self.try_to_begin() {
                Ok(()) => break,
                Err(error) => {
                    self.link = None;
                    attempt += 1;
                    if !error.is_passing() || attempt >= self.profile.server.attempts {
                        return Err(error);
                    }
                    std::thread::sleep(Duration::from_secs(1 << (attempt - 1)));
                }
            }
        }
        self.episode += 1;
        Ok(())
    }

    fn try_to_begin(&mut self) -> Result<(), ServerError> {
        if self.link.is_none() {
            let link = link::connect(&self.url, &self.profile)?;
            if *link.declared() != self.declared {
                return Err(ServerError::Mismatch(format!(
                    "after a reconnect the server says other things of itself: {} in place of {}",
                    link.declared(),
                    self.declared
                )));
            }
            self.link = Some(link);
            self.warm = false;
        }
        let deadline = self.deadline();
        self.link.as_mut().map_or(Ok(()), |link| link.begin(&self.instruction, self.episode, deadline))
    }

    /// Asks for a chunk of actions, which are checked against the profile and not executed.
    pub fn ask(&mut self, observation: &Observation) -> Result<Chunk, ServerError> {
        let query = Query::drawn(&self.profile, observation, &self.instruction, self.step, &mut self.spare)?;
        let deadline = self.deadline();
        let Some(link) = self.link.as_mut() else {
            return Err(ServerError::Closed { when: "before the episode began".to_owned(), reason: String::new() });
        };
        let answer = link.ask(&query, deadline).and_then(|chunk| chunk.check(&self.profile).map(|()| chunk));
        query.give_back(&mut self.spare);
        match &answer {
            Ok(_) => self.warm = true,
            Err(_) => self.link = None,
        }
        self.step += 1;
        answer
    }

    fn deadline(&self) -> Deadline {
        let patience = &self.profile.server;
        Deadline::within(if self.warm { patience.answer_s } else { patience.first_answer_s })
    }
}

impl Policy for ServerPolicy {
    fn check(&self, task: &TaskSpec) -> Result<(), String> {
        suits::check(&self.profile, task)
    }

    fn reset(&mut self, task: &TaskSpec, instance: &TaskInstance, _: Seed) -> Result<(), Fault> {
        let bounds = task.action.vector().map(|(low, high)| low.iter().copied().zip(high.iter().copied()).collect());
        self.bounds = bounds.unwrap_or_default();
        Ok(self.begin(&instance.instruction)?)
    }

    fn wants_images(&self) -> bool {
        self.queue.is_empty() && !self.profile.cameras.is_empty()
    }

    fn act(&mut self, observation: &Observation) -> Result<Action, Fault> {
        if self.queue.is_empty() {
            let chunk = self.ask(observation)?;
            self.queue.extend(chunk.into_rows().into_iter().take(self.profile.chunk.execute));
        }
        let raw = self.queue.pop_front().unwrap_or_default();
        let mut action = self.profile.action.action(&raw, observation.joint_positions())?;
        if let Command::Vector(numbers) = &mut action.command {
            // Networks overshoot a little; the task would reject such an action.
            numbers.iter_mut().zip(&self.bounds).for_each(|(n, (low, high))| *n = n.clamp(*low, *high));
        }
        Ok(action)
    }
}
