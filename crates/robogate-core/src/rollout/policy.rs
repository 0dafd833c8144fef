//! A policy that drives the robot.

use crate::{Action, Assignment, Fault, FaultKind, Observation, Seed, TaskInstance, TaskSpec};

/// A policy that drives the robot.
pub trait Policy {
    /// Checks that the policy can drive this task. The error names the missing capability. Called once, before any
    /// episode.
    fn check(&self, task: &TaskSpec) -> Result<(), String>;

    /// Starts an episode and clears all state of the previous one. `seed` is the source of the policy's randomness.
    fn reset(&mut self, task: &TaskSpec, instance: &TaskInstance, seed: Seed) -> Result<(), Fault>;

    /// Notes the applied parameters of the next episode. Called before [`Policy::reset`]. Only an adapter that applies a
    /// parameter itself uses them, such as a latency: a policy that acts on them knows what no robot can know. An adapter
    /// around another policy passes them on.
    fn note_applied(&mut self, _applied: &Assignment) {}

    /// Whether the next call of [`Policy::act`] uses images. Without images, or in the middle of a chunk of actions,
    /// the environment skips rendering.
    fn wants_images(&self) -> bool {
        false
    }

    /// Returns the next action.
    fn act(&mut self, observation: &Observation) -> Result<Action, Fault>;

    /// Whether the policy has given up: while its observations stay the same, it repeats the action of the last call of
    /// [`Policy::act`] until the time limit. A policy that may still act differently must return `false`.
    fn gave_up(&self) -> bool {
        false
    }

    /// Notes what is observed in a control period, for a policy that sees earlier observations. Called in each control
    /// period of an episode with latency, before [`Policy::predict`]. Without latency, [`Policy::act`] takes its place.
    fn observe(&mut self, _observation: &Observation) -> Result<(), Fault> {
        Ok(())
    }

    /// Whether [`Policy::observe`] needs the images of each control period.
    fn observes_images(&self) -> bool {
        false
    }

    /// Computes the next actions from one observation and executes none of them. A policy without chunks of actions
    /// computes one.
    fn predict(&mut self, observation: &Observation) -> Result<Prediction, Fault> {
        Ok(Prediction { steps: vec![PredictedStep::Action(self.act(observation)?)], execute: 1, periods: 1 })
    }

    /// Returns the command of the next control period for a step of a prediction: for a new one, or for the present one
    /// if `step` is `None` and a step takes several periods.
    fn perform(&mut self, step: Option<&[f64]>, _observation: &Observation) -> Result<Action, Fault> {
        let numbers = step.map_or(0, <[f64]>::len);
        Err(Fault::new(
            FaultKind::BadAction,
            format!("this policy predicts no vectors, but was given {numbers} numbers"),
        ))
    }
}

/// Actions that a policy computes from one observation.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Prediction {
    /// The steps, from the time of the observation on.
    pub steps: Vec<PredictedStep>,
    /// The number of steps that are executed if the robot waits for the policy.
    pub execute: usize,
    /// The number of control periods that a step takes.
    pub periods: u32,
}

/// A step of a prediction.
#[derive(Debug, Clone, PartialEq)]
pub enum PredictedStep {
    /// An action of the task.
    Action(Action),
    /// The numbers of a model. [`Policy::perform`] converts them when they are executed.
    Numbers(Vec<f64>),
}
