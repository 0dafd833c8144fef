//! Environments and policies with several episodes in progress at once.
//!
//! A slot is the place of one episode, counted from 0. When an episode ends, the next one takes its slot. An episode must
//! not depend on its slot, on the number of slots, or on the episodes beside it.

use std::num::NonZeroUsize;
use std::sync::Arc;

use super::{Ending, Start, Step};
use crate::{
    Action, Assignment, Fault, FaultKind, Foresight, Image, Measures, Observation, Scenario, Seed, TaskInstance,
    TaskSpec, Trajectory,
};

/// Worlds that are stepped together, each with an episode of its own: a simulator of many worlds, or single environments
/// ([`SingleEnvironments`](super::SingleEnvironments)).
///
/// The methods are those of [`Environment`](super::Environment) for each slot. A method for several slots returns one reply
/// per entry, in the same order. A fault in one of them must not disturb the others.
pub trait BatchEnvironment {
    /// The task. It is the same for every episode.
    fn task(&self) -> &Arc<TaskSpec>;

    /// The number of slots. It never changes.
    fn slots(&self) -> NonZeroUsize;

    /// The knowledge of the task about an episode before it runs. `None` if the task has none.
    fn foresight(&self) -> Option<Arc<dyn Foresight>> {
        None
    }

    /// The hidden draws of the episode in this slot, after its reset. Empty where nothing is known about them.
    ///
    /// # Errors
    /// If the draws cannot be computed for this scenario.
    fn draws(&self, _slot: usize, scenario: &Scenario) -> Result<Measures, Fault> {
        self.foresight().map_or_else(|| Ok(Measures::default()), |foresight| foresight.draws(scenario))
    }

    /// Sets up a scenario in each of these slots, independent of earlier episodes.
    fn reset(&mut self, scenarios: &[(usize, &Scenario)]) -> Vec<Result<Start, Fault>>;

    /// Runs one control period in each of these slots. The other slots stay as they are.
    fn step(&mut self, actions: &[(usize, &Action)]) -> Vec<Result<Step, Fault>>;

    /// The ending that the episode in this slot will have if its policy repeats its last action until the time limit.
    /// `None` if this is still uncertain.
    fn foregone_ending(&self, _slot: usize) -> Option<Ending> {
        None
    }

    /// Renders the cameras of these slots in their current state. Rendering does not change the episodes.
    fn render(&mut self, slots: &[usize]) -> Vec<Result<Vec<Image>, Fault>> {
        let fault = Fault::new(FaultKind::Setup, "this environment has no cameras");
        slots.iter().map(|_| Err(fault.clone())).collect()
    }

    /// Records the motion of all bodies in every later episode: one frame per `period_s` seconds of simulated time, at
    /// the start and at the end. `None` stops recording. Recording does not change the episodes.
    fn record_trajectory(&mut self, _period_s: Option<f64>) {}

    /// Takes the trajectory of the last episode in this slot. `None` if the environment has no geometry, or did not
    /// record it.
    fn take_trajectory(&mut self, _slot: usize) -> Option<Trajectory> {
        None
    }
}

/// A policy that drives several robots at once: a model that answers many observations together, or single policies
/// ([`SinglePolicies`](super::SinglePolicies)).
///
/// The methods are those of [`Policy`](super::Policy) for each slot. What a policy remembers of an episode (a memory, a
/// history, a chunk of actions) belongs to its slot.
pub trait BatchPolicy {
    /// Checks that the policy can drive this task.
    ///
    /// # Errors
    /// Names the missing capability.
    fn check(&self, task: &TaskSpec) -> Result<(), String>;

    /// Notes the applied parameters of the next episode in this slot. See
    /// [`Policy::note_applied`](super::Policy::note_applied).
    fn note_applied(&mut self, _slot: usize, _applied: &Assignment) {}

    /// Starts an episode in this slot and clears all state of the previous one. `seed` is the source of its randomness.
    ///
    /// # Errors
    /// If the policy cannot start the episode.
    fn reset(&mut self, slot: usize, task: &TaskSpec, instance: &TaskInstance, seed: Seed) -> Result<(), Fault>;

    /// Whether the next action in this slot uses images. Images are rendered for such slots only.
    fn wants_images(&self, _slot: usize) -> bool {
        false
    }

    /// Returns the next action of each of these slots: one reply per entry, in the same order. A fault in one of them must
    /// not disturb the others.
    fn act(&mut self, observations: &[(usize, &Observation)]) -> Vec<Result<Action, Fault>>;

    /// Whether the policy has given up in this slot. See [`Policy::gave_up`](super::Policy::gave_up).
    fn gave_up(&self, _slot: usize) -> bool {
        false
    }
}
