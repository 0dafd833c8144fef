//! Policies that act through a map.

use std::fmt;
use std::sync::Arc;

use robogate_core::{
    Action, Assignment, Fault, FaultKind, Observation, Policy, PredictedStep, Prediction, Seed, TaskInstance, TaskSpec,
};

use super::{BoundMap, TaskMap};
use crate::profile::Profile;

/// A policy that acts through a profile, in an environment that a map translates for it.
pub struct Mapped {
    policy: Box<dyn Policy>,
    profile: Arc<Profile>,
    map: Arc<TaskMap>,
    bound: Option<BoundMap>,
}

impl fmt::Debug for Mapped {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Mapped").field("profile", &self.profile.name).field("map", &self.map).finish_non_exhaustive()
    }
}

impl Mapped {
    /// A policy that acts through `profile` and sees the environment as `map` translates it.
    pub fn new(policy: Box<dyn Policy>, profile: Arc<Profile>, map: Arc<TaskMap>) -> Self {
        Self { policy, profile, map, bound: None }
    }

    fn bound(&self) -> Result<&BoundMap, Fault> {
        self.bound.as_ref().ok_or_else(|| Fault::new(FaultKind::Setup, "no episode is running"))
    }
}

impl Policy for Mapped {
    fn check(&self, task: &TaskSpec) -> Result<(), String> {
        let bound =
            BoundMap::new(&self.map, &self.profile, task).map_err(|why| format!("the map does not fit: {why}"))?;
        self.policy.check(bound.task())
    }

    fn note_applied(&mut self, applied: &Assignment) {
        self.policy.note_applied(applied);
    }

    fn reset(&mut self, task: &TaskSpec, instance: &TaskInstance, seed: Seed) -> Result<(), Fault> {
        let bound = BoundMap::new(&self.map, &self.profile, task).map_err(|why| Fault::new(FaultKind::Setup, why))?;
        self.policy.reset(bound.task(), instance, seed)?;
        self.bound = Some(bound);
        Ok(())
    }

    fn wants_images(&self) -> bool {
        self.policy.wants_images()
    }

    fn act(&mut self, observation: &Observation) -> Result<Action, Fault> {
        let seen = self.bound()?.observation(observation)?;
        let action = self.policy.act(&seen)?;
        Ok(self.bound()?.action(action))
    }

    fn gave_up(&self) -> bool {
        self.policy.gave_up()
    }

    fn observe(&mut self, observation: &Observation) -> Result<(), Fault> {
        let seen = self.bound()?.observation(observation)?;
        self.policy.observe(&seen)
    }

    fn observes_images(&self) -> bool {
        self.policy.observes_images()
    }

    fn predict(&mut self, observation: &Observation) -> Result<Prediction, Fault> {
        let seen = self.bound()?.observation(observation)?;
        let mut prediction = self.policy.predict(&seen)?;
        let bound = self.bound()?;
        for step in &mut prediction.steps {
            if let PredictedStep::Action(action) = step {
                *action = bound.action(action.clone());
            }
        }
        Ok(prediction)
    }

    fn perform(&mut self, step: Option<&[f64]>, observation: &Observation) -> Result<Action, Fault> {
        let seen = self.bound()?.observation(observation)?;
        let action = self.policy.perform(step, &seen)?;
        Ok(self.bound()?.action(action))
    }
}

/// An expert of the environment, whose actions are those that a profile would send: the inverse of [`Mapped`], for the
/// positive control of a gate.
pub struct Unmapped {
    expert: Box<dyn Policy>,
    task: TaskSpec,
    bound: BoundMap,
}

impl fmt::Debug for Unmapped {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Unmapped").field("bound", &self.bound).finish_non_exhaustive()
    }
}

impl Unmapped {
    /// The expert of this task, behind this map. Vectors that the map replaces are hidden from it.
    ///
    /// # Errors
    /// If the map does not fit.
    pub fn new(expert: Box<dyn Policy>, profile: &Profile, map: &TaskMap, task: &TaskSpec) -> Result<Self, String> {
        Ok(Self { expert, task: task.clone(), bound: BoundMap::new(map, profile, task)? })
    }
}

impl Policy for Unmapped {
    fn check(&self, _: &TaskSpec) -> Result<(), String> {
        self.expert.check(&self.task)
    }

    fn note_applied(&mut self, applied: &Assignment) {
        self.expert.note_applied(applied);
    }

    fn reset(&mut self, _: &TaskSpec, instance: &TaskInstance, seed: Seed) -> Result<(), Fault> {
        self.expert.reset(&self.task, instance, seed)
    }

    fn act(&mut self, observation: &Observation) -> Result<Action, Fault> {
        Ok(self.bound.inverse(self.expert.act(observation)?))
    }
}
