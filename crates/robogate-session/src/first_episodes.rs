//! The first episodes of a gate, as its environment ran them. After the last episode they run again with the same actions.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use robogate_core::{Action, Environment, Fault, Scenario, Start, Step, TaskSpec};

use crate::repetition::Seen;

/// The number of episodes that run again, and the largest number if none of them succeeds: what prevents successes shows only there.
const FIRST: usize = 4;
const MOST: usize = 12;

/// The first episodes, for all workers of a campaign.
#[derive(Debug, Clone, Default)]
pub(crate) struct FirstEpisodes(Arc<Mutex<Vec<First>>>);

/// An episode. `None` if it ended with a fault.
type First = (Scenario, Option<Seen>);

impl FirstEpisodes {
    fn episodes(&self) -> MutexGuard<'_, Vec<First>> {
        // An episode is changed by one worker, so one that panicked leaves the others as they are.
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Takes the episodes in order of their index. Those with a fault are left out.
    pub(crate) fn take(&self) -> Vec<(Scenario, Seen)> {
        let mut episodes: Vec<(Scenario, Seen)> = std::mem::take(&mut *self.episodes())
            .into_iter()
            .filter_map(|(scenario, seen)| Some((scenario, seen?)))
            .collect();
        episodes.sort_by_key(|(scenario, _)| scenario.index);
        episodes
    }

    /// The same environment, whose first episodes are kept here.
    pub(crate) fn of(&self, environment: Box<dyn Environment>) -> Box<dyn Environment> {
        Box::new(Kept { environment, first: self.clone(), at: None })
    }
}

/// An environment whose first episodes are kept.
struct Kept {
    environment: Box<dyn Environment>,
    first: FirstEpisodes,
    /// The place of the episode in progress, if it is one of them.
    at: Option<usize>,
}

impl Environment for Kept {
    fn adapted(&self) -> Option<&dyn Environment> {
        Some(&*self.environment)
    }

    fn adapted_mut(&mut self) -> Option<&mut dyn Environment> {
        Some(&mut *self.environment)
    }

    fn task(&self) -> &Arc<TaskSpec> {
        self.environment.task()
    }

    fn reset(&mut self, scenario: &Scenario) -> Result<Start, Fault> {
        let start = self.environment.reset(scenario)?;
        let mut episodes = self.first.episodes();
        let succeeded = |(_, seen): &First| seen.as_ref().is_some_and(Seen::is_success);
        let wanted = episodes.len() < FIRST || (episodes.len() < MOST && !episodes.iter().any(succeeded));
        self.at = wanted.then_some(episodes.len());
        if self.at.is_some() {
            episodes.push((scenario.clone(), Some(Seen::start(&start))));
        }
        drop(episodes);
        Ok(start)
    }

    fn step(&mut self, action: &Action) -> Result<Step, Fault> {
        let step = self.environment.step(action);
        if let Some(at) = self.at
            && let Some((_, seen)) = self.first.episodes().get_mut(at)
        {
            match &step {
                Ok(step) => seen.iter_mut().for_each(|seen| seen.add(action, step)),
                Err(_) => *seen = None,
            }
        }
        step
    }
}
