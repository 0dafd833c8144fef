//! A world in which a policy performs a task.

use std::sync::Arc;

use crate::{
    Action, Assignment, Contact, FailureMode, Fault, FaultKind, Foresight, Image, Infeasibility, Measures, Observation,
    Scenario, TaskInstance, TaskSpec, Trajectory,
};

/// The result of a reset.
#[derive(Debug, Clone, PartialEq)]
pub struct Start {
    /// Information about this episode that the policy may use.
    pub instance: TaskInstance,
    /// The first observation.
    pub observation: Observation,
    /// The parameters read back after they were set.
    pub applied: Assignment,
}

/// The result of one step.
#[derive(Debug, Clone, PartialEq)]
pub struct Step {
    /// The next observation.
    pub observation: Observation,
    /// Measurements up to now.
    pub measures: Measures,
    /// The decisive event, if there was one.
    pub ending: Option<Ending>,
    /// Events in this step, for the timeline of a replay.
    pub events: Vec<String>,
    /// Hash of the environment's full state.
    pub state_hash: u64,
}

/// The decisive event of an episode.
#[derive(Debug, Clone, PartialEq)]
pub struct Ending {
    /// The failure mode. `None` means success.
    pub failure: Option<FailureMode>,
    /// Simulated time of the event, in seconds.
    pub time_s: f64,
    /// The contact that decided the outcome, if there was one.
    pub contact: Option<Contact>,
}

/// A world in which a policy performs a task.
pub trait Environment {
    /// The task. It is the same for every episode.
    fn task(&self) -> &Arc<TaskSpec>;

    /// The environment that this one adapts, if it is an adapter. The methods that an adapter does not define are those of this
    /// environment. An adapter defines [`adapted_mut`](Self::adapted_mut) too.
    fn adapted(&self) -> Option<&dyn Environment> {
        None
    }

    /// As [`adapted`](Self::adapted).
    fn adapted_mut(&mut self) -> Option<&mut dyn Environment> {
        None
    }

    /// The knowledge of the task about an episode before it runs. `None` if the task has none.
    fn foresight(&self) -> Option<Arc<dyn Foresight>> {
        self.adapted()?.foresight()
    }

    /// The hidden draws of the episode of this scenario, after its reset. Empty where nothing is known about them.
    fn draws(&self, scenario: &Scenario) -> Result<Measures, Fault> {
        match self.adapted() {
            Some(adapted) => adapted.draws(scenario),
            None => self.foresight().map_or_else(|| Ok(Measures::default()), |foresight| foresight.draws(scenario)),
        }
    }

    /// Sets up a scenario. A second call starts over, independent of earlier episodes.
    fn reset(&mut self, scenario: &Scenario) -> Result<Start, Fault>;

    /// Runs one control period.
    fn step(&mut self, action: &Action) -> Result<Step, Fault>;

    /// The reason why no policy can complete a scenario with these requested parameters, if the task knows one. It must
    /// hold for every policy: a scenario that is only hard is feasible.
    fn infeasibility(&self, requested: &Assignment) -> Option<Infeasibility> {
        self.adapted()?.infeasibility(requested)
    }

    /// The ending that the episode will have if the policy repeats its last action until the time limit. `None` if this
    /// is still uncertain, for example because a body moves. The rollout ends an episode early only with this ending,
    /// and only if the policy gave up: the outcome is that of the whole episode.
    fn foregone_ending(&self) -> Option<Ending> {
        self.adapted()?.foregone_ending()
    }

    /// Renders the cameras in the current state. Rendering does not change the episode.
    fn render(&mut self) -> Result<Vec<Image>, Fault> {
        let none = || Fault::new(FaultKind::Setup, "this environment has no cameras");
        self.adapted_mut().ok_or_else(none)?.render()
    }

    /// Renders these cameras only, for a film of the episode: the final state may be rendered too. A remote environment
    /// renders nothing else, which may save much time.
    fn render_only(&mut self, cameras: &[&str]) -> Result<Vec<Image>, Fault> {
        if let Some(adapted) = self.adapted_mut() {
            return adapted.render_only(cameras);
        }
        let mut images = self.render()?;
        images.retain(|image| cameras.contains(&image.camera.as_str()));
        Ok(images)
    }

    /// Records the motion of all bodies in every later episode: one frame per `period_s` seconds of simulated time, at
    /// the start and at the end. `None` stops recording. Recording does not change the episode.
    fn record_trajectory(&mut self, period_s: Option<f64>) {
        if let Some(adapted) = self.adapted_mut() {
            adapted.record_trajectory(period_s);
        }
    }

    /// Takes the trajectory of the last episode. `None` if the environment has no geometry, or did not record it.
    fn take_trajectory(&mut self) -> Option<Trajectory> {
        self.adapted_mut()?.take_trajectory()
    }
}
