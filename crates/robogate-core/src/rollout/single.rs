//! Runs one episode.

use std::sync::Arc;

use super::{Environment, Policy, Request, Rollout, Tick};
use crate::{Episode, Scenario};

/// Runs one episode. It always returns a record: a fault becomes [`Outcome::Invalid`](crate::Outcome::Invalid).
pub fn rollout(environment: &mut dyn Environment, policy: &mut dyn Policy, scenario: &Scenario) -> Episode {
    rollout_with(environment, policy, scenario, &mut |_| {})
}

/// Runs an episode like [`rollout`], with an observer that is called after every control period.
pub fn rollout_with(
    environment: &mut dyn Environment,
    policy: &mut dyn Policy,
    scenario: &Scenario,
    observer: &mut dyn FnMut(Tick<'_>),
) -> Episode {
    let task = Arc::clone(environment.task());
    let mut rollout = Rollout::begin(Arc::clone(&task), scenario.clone());
    while let Some(request) = rollout.request() {
        match request {
            Request::Reset(scenario) => {
                let start = environment.reset(scenario);
                rollout.started(start);
            }
            Request::Draws(scenario) => {
                let draws = environment.draws(scenario);
                rollout.drawn(draws);
            }
            Request::Prepare(instance) => {
                policy.note_applied(&rollout.episode().applied);
                let prepared = policy.reset(&task, instance, scenario.seed);
                rollout.prepared(prepared);
            }
            Request::Act(_) => {
                if policy.wants_images() {
                    rollout.rendered(environment.render());
                }
                // Without its images, the episode has ended.
                if let Some(Request::Act(observation)) = rollout.request() {
                    let action = policy.act(observation);
                    rollout.acted(action);
                }
            }
            Request::Step(action) => {
                let step = environment.step(action);
                let gave_up = step.is_ok() && (rollout.gave_up() || policy.gave_up());
                let foregone = if gave_up { environment.foregone_ending() } else { None };
                rollout.stepped(step, gave_up, foregone, observer);
            }
        }
    }
    rollout.finish()
}
