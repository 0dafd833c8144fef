//! Single environments and policies as a batch: one for each slot, one after the other.

use std::num::NonZeroUsize;
use std::sync::Arc;

use super::{BatchEnvironment, BatchPolicy, Ending, Environment, Policy, Start, Step};
use crate::{
    Action, Assignment, Fault, Foresight, Image, Measures, Observation, Scenario, Seed, TaskInstance, TaskSpec,
    Trajectory,
};

/// One environment per slot. All must behave the same.
pub struct SingleEnvironments(Vec<Box<dyn Environment>>);

impl SingleEnvironments {
    /// A batch of these environments. `None` if there is no environment.
    #[must_use]
    pub fn new(environments: Vec<Box<dyn Environment>>) -> Option<Self> {
        (!environments.is_empty()).then_some(Self(environments))
    }
}

impl std::fmt::Debug for SingleEnvironments {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("SingleEnvironments").field("slots", &self.0.len()).finish()
    }
}

impl BatchEnvironment for SingleEnvironments {
    fn task(&self) -> &Arc<TaskSpec> {
        self.0[0].task()
    }

    fn slots(&self) -> NonZeroUsize {
        NonZeroUsize::new(self.0.len()).unwrap_or(NonZeroUsize::MIN)
    }

    fn foresight(&self) -> Option<Arc<dyn Foresight>> {
        self.0[0].foresight()
    }

    fn draws(&self, slot: usize, scenario: &Scenario) -> Result<Measures, Fault> {
        self.0[slot].draws(scenario)
    }

    fn reset(&mut self, scenarios: &[(usize, &Scenario)]) -> Vec<Result<Start, Fault>> {
        scenarios.iter().map(|(slot, scenario)| self.0[*slot].reset(scenario)).collect()
    }

    fn step(&mut self, actions: &[(usize, &Action)]) -> Vec<Result<Step, Fault>> {
        actions.iter().map(|(slot, action)| self.0[*slot].step(action)).collect()
    }

    fn foregone_ending(&self, slot: usize) -> Option<Ending> {
        self.0[slot].foregone_ending()
    }

    fn render(&mut self, slots: &[usize]) -> Vec<Result<Vec<Image>, Fault>> {
        slots.iter().map(|slot| self.0[*slot].render()).collect()
    }

    fn record_trajectory(&mut self, period_s: Option<f64>) {
        self.0.iter_mut().for_each(|environment| environment.record_trajectory(period_s));
    }

    fn take_trajectory(&mut self, slot: usize) -> Option<Trajectory> {
        self.0[slot].take_trajectory()
    }
}

/// One policy per slot. All must behave the same, and there must be at least as many as the environment has slots.
pub struct SinglePolicies(Vec<Box<dyn Policy>>);

impl SinglePolicies {
    /// A batch of these policies.
    #[must_use]
    pub fn new(policies: Vec<Box<dyn Policy>>) -> Self {
        Self(policies)
    }
}

impl std::fmt::Debug for SinglePolicies {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("SinglePolicies").field("slots", &self.0.len()).finish()
    }
}

impl BatchPolicy for SinglePolicies {
    fn check(&self, task: &TaskSpec) -> Result<(), String> {
        self.0.iter().try_for_each(|policy| policy.check(task))
    }

    fn note_applied(&mut self, slot: usize, applied: &Assignment) {
        self.0[slot].note_applied(applied);
    }

    fn reset(&mut self, slot: usize, task: &TaskSpec, instance: &TaskInstance, seed: Seed) -> Result<(), Fault> {
        self.0[slot].reset(task, instance, seed)
    }

    fn wants_images(&self, slot: usize) -> bool {
        self.0[slot].wants_images()
    }

    fn act(&mut self, observations: &[(usize, &Observation)]) -> Vec<Result<Action, Fault>> {
        observations.iter().map(|(slot, observation)| self.0[*slot].act(observation)).collect()
    }

    fn gave_up(&self, slot: usize) -> bool {
        self.0[slot].gave_up()
    }
}
