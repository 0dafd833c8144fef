//! Runs any number of episodes, as many at once as an environment has slots.

use std::ops::ControlFlow;
use std::sync::Arc;

use super::{BatchEnvironment, BatchPolicy, Request, Rollout, Tick};
use crate::{Episode, Fault, FaultKind, Scenario, TaskSpec};

/// The source of the episodes of [`rollout_many`], and the receiver of their records.
pub trait Workload {
    /// The scenario of the next episode, which starts in this slot. After `None`, no further episode starts.
    fn next(&mut self, slot: usize) -> Option<Scenario>;

    /// Observes the episode in this slot after every control period.
    fn observe(&mut self, _slot: usize, _tick: Tick<'_>) {}

    /// Receives a finished episode. The environment still has the trajectory of its slot. After a break, all other
    /// episodes in progress are abandoned.
    fn finished(&mut self, slot: usize, episode: Episode, environment: &mut dyn BatchEnvironment) -> ControlFlow<()>;
}

/// Runs these episodes in a batch. Returns their records in the order of the scenarios. A fault becomes
/// [`Outcome::Invalid`](crate::Outcome::Invalid).
pub fn rollout_all(
    environment: &mut dyn BatchEnvironment,
    policy: &mut dyn BatchPolicy,
    scenarios: &[Scenario],
) -> Vec<Episode> {
    let mut list = List { scenarios, next: 0, in_slots: Vec::new(), finished: Vec::new() };
    rollout_many(environment, policy, &mut list);
    list.finished.sort_by_key(|(at, _)| *at);
    list.finished.into_iter().map(|(_, episode)| episode).collect()
}

/// A list of scenarios as a workload.
struct List<'a> {
    scenarios: &'a [Scenario],
    next: usize,
    /// The place in the list of the episode in each slot.
    in_slots: Vec<usize>,
    /// Finished episodes with their places in the list.
    finished: Vec<(usize, Episode)>,
}

impl Workload for List<'_> {
    fn next(&mut self, slot: usize) -> Option<Scenario> {
        let scenario = self.scenarios.get(self.next)?.clone();
        self.in_slots.resize(self.in_slots.len().max(slot + 1), 0);
        self.in_slots[slot] = self.next;
        self.next += 1;
        Some(scenario)
    }

    fn finished(&mut self, slot: usize, episode: Episode, _: &mut dyn BatchEnvironment) -> ControlFlow<()> {
        self.finished.push((self.in_slots[slot], episode));
        ControlFlow::Continue(())
    }
}

/// Runs the episodes of a workload in a batch, until it has no more of them or breaks.
///
/// Each episode is the same, bit for bit, as that of [`rollout`](super::rollout) with a single environment and policy. A slot
/// whose episode ends gets the next one before the next control period. The order in which episodes finish follows from
/// their lengths alone.
pub fn rollout_many(environment: &mut dyn BatchEnvironment, policy: &mut dyn BatchPolicy, workload: &mut dyn Workload) {
    let task = Arc::clone(environment.task());
    let slots = (0..environment.slots().get()).map(|_| None).collect();
    let mut batch = Batch { environment, policy, workload, task, slots, exhausted: false };
    while batch.fill().is_continue() && batch.slots.iter().any(Option::is_some) {
        batch.act();
        batch.step();
        if batch.take_finished().is_break() {
            break;
        }
    }
}

/// Episodes in progress.
struct Batch<'a> {
    environment: &'a mut dyn BatchEnvironment,
    policy: &'a mut dyn BatchPolicy,
    workload: &'a mut dyn Workload,
    task: Arc<TaskSpec>,
    slots: Vec<Option<Rollout>>,
    /// Whether no further episode starts.
    exhausted: bool,
}

impl Batch<'_> {
    /// Starts an episode in each free slot. An episode that cannot start is finished at once, and its slot is free again.
    fn fill(&mut self) -> ControlFlow<()> {
        while !self.exhausted && self.slots.iter().any(Option::is_none) {
            for (slot, rollout) in self.slots.iter_mut().enumerate().filter(|(_, rollout)| rollout.is_none()) {
                let Some(scenario) = self.workload.next(slot) else {
                    self.exhausted = true;
                    break;
                };
                *rollout = Some(Rollout::begin(Arc::clone(&self.task), scenario));
            }
            self.start();
            self.take_finished()?;
        }
        ControlFlow::Continue(())
    }

    /// Resets environment and policy for the episodes that begin.
    fn start(&mut self) {
        let requests = open(&self.slots, |request| match request {
            Request::Reset(scenario) => Some(scenario),
            _ => None,
        });
        if requests.is_empty() {
            return;
        }
        let starts = self.environment.reset(&requests);
        let asked = slots_of(&requests);
        answer(&mut self.slots, &asked, starts, |_, rollout, start| rollout.started(start));
        for (slot, rollout) in in_progress(&mut self.slots) {
            if let Some(Request::Draws(scenario)) = rollout.request() {
                let draws = self.environment.draws(slot, scenario);
                rollout.drawn(draws);
            }
            if let Some(Request::Prepare(instance)) = rollout.request() {
                self.policy.note_applied(slot, &rollout.episode().applied);
                let prepared = self.policy.reset(slot, &self.task, instance, rollout.episode().scenario.seed);
                rollout.prepared(prepared);
            }
        }
    }

    /// Requests the actions of all episodes together, with images for those whose policy wants them.
    fn act(&mut self) {
        let with_images: Vec<usize> =
            in_progress(&mut self.slots).map(|(slot, _)| slot).filter(|slot| self.policy.wants_images(*slot)).collect();
        if !with_images.is_empty() {
            let images = self.environment.render(&with_images);
            answer(&mut self.slots, &with_images, images, |_, rollout, images| rollout.rendered(images));
        }
        let requests = open(&self.slots, |request| match request {
            Request::Act(observation) => Some(observation),
            _ => None,
        });
        if !requests.is_empty() {
            let actions = self.policy.act(&requests);
            let asked = slots_of(&requests);
            answer(&mut self.slots, &asked, actions, |_, rollout, action| rollout.acted(action));
        }
    }

    /// Runs one control period of all episodes.
    fn step(&mut self) {
        let requests = open(&self.slots, |request| match request {
            Request::Step(action) => Some(action),
            _ => None,
        });
        if requests.is_empty() {
            return;
        }
        let steps = self.environment.step(&requests);
        let asked = slots_of(&requests);
        let Self { environment, policy, workload, .. } = self;
        answer(&mut self.slots, &asked, steps, |slot, rollout, step| {
            let gave_up = step.is_ok() && (rollout.gave_up() || policy.gave_up(slot));
            let foregone = if gave_up { environment.foregone_ending(slot) } else { None };
            rollout.stepped(step, gave_up, foregone, &mut |tick| workload.observe(slot, tick));
        });
    }

    /// Passes on the episodes that have ended.
    fn take_finished(&mut self) -> ControlFlow<()> {
        for slot in 0..self.slots.len() {
            if let Some(rollout) = self.slots[slot].take_if(|rollout| rollout.request().is_none()) {
                self.workload.finished(slot, rollout.finish(), &mut *self.environment)?;
            }
        }
        ControlFlow::Continue(())
    }
}

/// The episodes in progress, with their slots.
fn in_progress(slots: &mut [Option<Rollout>]) -> impl Iterator<Item = (usize, &mut Rollout)> {
    slots.iter_mut().enumerate().filter_map(|(slot, rollout)| Some((slot, rollout.as_mut()?)))
}

/// The open requests of one kind, with their slots.
fn open<'a, T>(slots: &'a [Option<Rollout>], kind: impl Fn(Request<'a>) -> Option<&'a T>) -> Vec<(usize, &'a T)> {
    let of = |(slot, rollout): (usize, &'a Option<Rollout>)| Some((slot, kind(rollout.as_ref()?.request()?)?));
    slots.iter().enumerate().filter_map(of).collect()
}

fn slots_of<T>(requests: &[(usize, T)]) -> Vec<usize> {
    requests.iter().map(|(slot, _)| *slot).collect()
}

/// Gives each of these slots its reply. If there are too few or too many replies, it is unknown which slot each one
/// belongs to, and all of these episodes get a fault.
fn answer<T>(
    slots: &mut [Option<Rollout>],
    asked: &[usize],
    replies: Vec<Result<T, Fault>>,
    mut give: impl FnMut(usize, &mut Rollout, Result<T, Fault>),
) {
    let found = replies.len();
    let mut replies = replies.into_iter();
    for slot in asked {
        let reply = replies.next().filter(|_| found == asked.len()).unwrap_or_else(|| {
            let expected = asked.len();
            Err(Fault::new(FaultKind::Setup, format!("a batch returned {found} replies to {expected} requests")))
        });
        if let Some(rollout) = &mut slots[*slot] {
            give(*slot, rollout, reply);
        }
    }
}
