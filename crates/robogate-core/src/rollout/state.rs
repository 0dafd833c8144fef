//! One episode as a state machine.
//!
//! A [`Rollout`] runs nothing itself. It says what it needs next ([`Rollout::request`]), and the caller gives it the
//! reply of the environment or of the policy:
//!
//! | request | the caller calls | the reply goes to |
//! |---|---|---|
//! | [`Request::Reset`] | [`Environment::reset`](crate::Environment::reset) | [`Rollout::started`] |
//! | [`Request::Draws`] | [`Environment::draws`](crate::Environment::draws) | [`Rollout::drawn`] |
//! | [`Request::Prepare`] | [`Policy::note_applied`](crate::Policy::note_applied), [`Policy::reset`](crate::Policy::reset) | [`Rollout::prepared`] |
//! | [`Request::Act`] | [`Environment::render`](crate::Environment::render) if the policy wants images, then [`Policy::act`](crate::Policy::act) | [`Rollout::rendered`], [`Rollout::acted`] |
//! | [`Request::Step`] | [`Environment::step`](crate::Environment::step) | [`Rollout::stepped`] |
//! | none | | [`Rollout::finish`] returns the episode |
//!
//! The first three requests come once. Then the last two alternate until an ending, a fault or the time limit.

use std::sync::Arc;

use crate::{
    Action, Assignment, Ending, Episode, FailureMode, Fault, FaultKind, Image, Measures, Observation, Outcome,
    Scenario, Start, Step, TaskInstance, TaskSpec, Word, check_applied,
};

/// The measure with the simulated time at which the policy gave up ([`crate::Policy::gave_up`]), in seconds. The rollout records
/// it for tasks that declare it.
pub const GAVE_UP: Word = Word::constant("gave_up_s");

/// One control period, as an observer sees it.
#[derive(Debug)]
pub struct Tick<'a> {
    /// The observation that the policy received.
    pub observation: &'a Observation,
    /// The action that the policy returned.
    pub action: &'a Action,
    /// The resulting step.
    pub step: &'a Step,
}

/// What an episode needs next.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Request<'a> {
    /// A reset of the environment to this scenario.
    Reset(&'a Scenario),
    /// The hidden draws of this scenario.
    Draws(&'a Scenario),
    /// A reset of the policy for this episode.
    Prepare(&'a TaskInstance),
    /// An action of the policy for this observation.
    Act(&'a Observation),
    /// One control period of the environment with this action.
    Step(&'a Action),
}

/// An episode in progress. See the table at the top of its module for the order of calls.
///
/// A fault in a reply ends the episode as [`Outcome::Invalid`]. So does a reply that was not requested, which is an error of
/// the caller. An episode that has ended ignores replies.
#[derive(Debug)]
pub struct Rollout {
    task: Arc<TaskSpec>,
    /// The record up to now.
    episode: Episode,
    next: Next,
    /// The last observation.
    observation: Observation,
    /// Number of control periods until the time limit.
    limit: u32,
    records_giving_up: bool,
    /// Simulated time at which the policy gave up, in seconds.
    gave_up_s: Option<f64>,
}

/// The request that is open.
#[derive(Debug)]
enum Next {
    Reset,
    Draws(TaskInstance),
    Prepare(TaskInstance),
    Act,
    Step(Action),
    Nothing,
}

impl Rollout {
    /// Begins an episode of a task.
    #[must_use]
    pub fn begin(task: Arc<TaskSpec>, scenario: Scenario) -> Self {
        let episode = Episode {
            scenario,
            applied: Assignment::default(),
            outcome: Outcome::Failure(FailureMode::TIMEOUT),
            time_s: 0.0,
            phase: None,
            contact: None,
            measures: Measures::default(),
            draws: Measures::default(),
            ticks: 0,
            trajectory_hash: HASH_START,
        };
        let records_giving_up = task.measure(GAVE_UP.as_str()).is_some();
        let observation = Observation::default();
        Self { task, episode, next: Next::Reset, observation, limit: 0, records_giving_up, gave_up_s: None }
    }

    /// What the episode needs next. `None` if it has ended.
    #[must_use]
    pub fn request(&self) -> Option<Request<'_>> {
        Some(match &self.next {
            Next::Reset => Request::Reset(&self.episode.scenario),
            Next::Draws(_) => Request::Draws(&self.episode.scenario),
            Next::Prepare(instance) => Request::Prepare(instance),
            Next::Act => Request::Act(&self.observation),
            Next::Step(action) => Request::Step(action),
            Next::Nothing => return None,
        })
    }

    /// The record of the episode up to now. Its outcome is a timeout until another one is decided.
    #[must_use]
    pub fn episode(&self) -> &Episode {
        &self.episode
    }

    /// Whether the policy has given up. It is then not asked again.
    #[must_use]
    pub fn gave_up(&self) -> bool {
        self.gave_up_s.is_some()
    }

    /// Answers [`Request::Reset`]. A requested parameter that was not applied is a fault.
    pub fn started(&mut self, start: Result<Start, Fault>) {
        self.answer(|this, next| {
            let Next::Reset = next else { return Err(not_requested("a start")) };
            let Start { instance, observation, applied } = start?;
            this.episode.applied = applied;
            check_applied(&this.episode.scenario.requested, &this.episode.applied)?;
            this.observation = observation;
            this.next = Next::Draws(instance);
            Ok(())
        });
    }

    /// Answers [`Request::Draws`].
    pub fn drawn(&mut self, draws: Result<Measures, Fault>) {
        self.answer(|this, next| {
            let Next::Draws(instance) = next else { return Err(not_requested("hidden draws")) };
            this.episode.draws = draws?;
            this.next = Next::Prepare(instance);
            Ok(())
        });
    }

    /// Answers [`Request::Prepare`]. A task without a valid time limit is a fault.
    pub fn prepared(&mut self, prepared: Result<(), Fault>) {
        self.answer(|this, next| {
            let Next::Prepare(_) = next else { return Err(not_requested("a policy's reset")) };
            prepared?;
            this.limit = this.task.limit_ticks().map_err(|why| Fault::new(FaultKind::Setup, why.to_string()))?;
            this.await_action();
            Ok(())
        });
    }

    /// Adds the images that the policy wants to the observation of [`Request::Act`], which stays open.
    pub fn rendered(&mut self, images: Result<Vec<Image>, Fault>) {
        self.answer(|this, next| {
            let Next::Act = next else { return Err(not_requested("images")) };
            this.observation.images = images?;
            this.next = Next::Act;
            Ok(())
        });
    }

    /// Answers [`Request::Act`]. An action outside of the task's action space is a fault.
    pub fn acted(&mut self, action: Result<Action, Fault>) {
        self.answer(|this, next| {
            let Next::Act = next else { return Err(not_requested("an action")) };
            let action = action?;
            this.task.check_action(&action).map_err(|why| Fault::new(FaultKind::BadAction, why))?;
            this.next = Next::Step(action);
            Ok(())
        });
    }

    /// Answers [`Request::Step`].
    ///
    /// `gave_up` says whether the policy has given up ([`Policy::gave_up`](crate::Policy::gave_up)). It then stays so until
    /// the end. `foregone` is then the ending at the time limit, if the environment knows it
    /// ([`Environment::foregone_ending`](crate::Environment::foregone_ending)). The observer sees the control period.
    pub fn stepped(
        &mut self,
        step: Result<Step, Fault>,
        gave_up: bool,
        foregone: Option<Ending>,
        observer: &mut dyn FnMut(Tick<'_>),
    ) {
        self.answer(|this, next| {
            let Next::Step(action) = next else { return Err(not_requested("a step")) };
            let mut step = step?;
            if gave_up && this.gave_up_s.is_none() {
                this.gave_up_s = Some(this.observation.time_s);
                step.events.push("policy gave up".to_owned());
            }
            if this.records_giving_up {
                step.measures.set(GAVE_UP, this.gave_up_s);
            }
            observer(Tick { observation: &this.observation, action: &action, step: &step });
            this.record(&action, step, foregone.filter(|_| this.gave_up_s.is_some()));
            Ok(())
        });
    }

    /// The record of the episode. An episode that has not ended has the fault that it was abandoned.
    #[must_use]
    pub fn finish(mut self) -> Episode {
        if !matches!(self.next, Next::Nothing) {
            self.episode.outcome = Outcome::Invalid(Fault::new(FaultKind::Unavailable, "the episode was abandoned"));
        }
        self.episode
    }

    /// Adds a control period to the record.
    fn record(&mut self, action: &Action, step: Step, foregone: Option<Ending>) {
        let episode = &mut self.episode;
        episode.ticks += 1;
        episode.time_s = step.observation.time_s;
        episode.phase = action.phase;
        episode.measures = step.measures;
        episode.trajectory_hash = chain(episode.trajectory_hash, step.state_hash);
        if let Some(ending) = step.ending.or(foregone) {
            episode.outcome = ending.failure.map_or(Outcome::Success, Outcome::Failure);
            episode.time_s = ending.time_s;
            episode.contact = ending.contact;
            return;
        }
        self.observation = step.observation;
        self.await_action();
    }

    /// Requests the next action, unless the time limit is reached.
    fn await_action(&mut self) {
        if self.episode.ticks < self.limit {
            self.next = Next::Act;
        }
    }

    /// Takes the open request, and ends the episode if `reply` is a fault. An episode that has ended ignores replies.
    fn answer(&mut self, reply: impl FnOnce(&mut Self, Next) -> Result<(), Fault>) {
        let next = std::mem::replace(&mut self.next, Next::Nothing);
        if matches!(next, Next::Nothing) {
            return;
        }
        if let Err(fault) = reply(self, next) {
            self.next = Next::Nothing;
            self.episode.outcome = Outcome::Invalid(fault);
        }
    }
}

fn not_requested(what: &str) -> Fault {
    Fault::new(FaultKind::Setup, format!("the episode was given {what} that it did not request"))
}

const HASH_START: u64 = 0x9e37_79b9_7f4a_7c15;

/// Combines two hashes in an order-dependent way (the finaliser of SplitMix64 over their sum).
fn chain(hash: u64, next: u64) -> u64 {
    let mut z = hash.rotate_left(23).wrapping_add(next).wrapping_add(HASH_START);
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}
