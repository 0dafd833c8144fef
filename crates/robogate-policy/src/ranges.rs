//! Counts states outside of the published range of a checkpoint, and records them as measures of each episode.

use std::collections::BTreeSet;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use robogate_core::{
    Action, Environment, Fault, MeasureSpec, Measures, OUTSIDE_RANGE, Observation, Scenario, Start, Step, TaskSpec,
    Word, outside_any_range, outside_range_measure,
};

use super::error::PolicyError;
use super::profile::Profile;
use super::query;

/// The counts of the running episode. The policy counts, and its environment records.
#[derive(Debug, Clone)]
pub struct RangeCounts(Arc<Mutex<Counts>>);

#[derive(Debug)]
struct Counts {
    /// The measure of each number with a range: state, position in it, and name.
    numbers: Vec<(usize, usize, Word)>,
    /// How often each was outside.
    outside: Vec<u32>,
    /// Requests with a number outside, and all requests.
    any: u32,
    requests: u32,
}

/// The measures of a profile with ranges, each with its state and position. Empty for one without.
fn measures(profile: &Profile) -> Vec<(usize, usize, MeasureSpec)> {
    let mut names = BTreeSet::new();
    let states = profile.states.iter().enumerate();
    let numbers = states.flat_map(|(at, state)| {
        let ranges = state.low.iter().zip(&state.high).enumerate();
        ranges.filter_map(move |(position, (low, high))| {
            outside_range_measure(&state.key, position, *low, *high).map(|measure| (at, position, measure))
        })
    });
    numbers.filter(|(_, _, measure)| names.insert(measure.name)).collect()
}

/// The task with the measures of a policy's states, if the profile has the ranges of a checkpoint.
pub fn with_range_measures(task: &Arc<TaskSpec>, profile: &Profile) -> Arc<TaskSpec> {
    let found = measures(profile);
    if found.is_empty() || task.measure(OUTSIDE_RANGE.as_str()).is_some() {
        return Arc::clone(task);
    }
    let mut task = (**task).clone();
    task.measures.push(outside_any_range());
    task.measures.extend(found.into_iter().map(|(_, _, measure)| measure));
    Arc::new(task)
}

impl RangeCounts {
    /// Counts for a policy with this profile. `None` if it has no ranges.
    pub fn of(profile: &Profile) -> Option<Self> {
        let numbers: Vec<_> =
            measures(profile).into_iter().map(|(state, position, measure)| (state, position, measure.name)).collect();
        let outside = vec![0; numbers.len()];
        (!numbers.is_empty()).then(|| Self(Arc::new(Mutex::new(Counts { numbers, outside, any: 0, requests: 0 }))))
    }

    fn counts(&self) -> MutexGuard<'_, Counts> {
        // No code panics between two related writes.
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Begins an episode.
    pub(crate) fn clear(&self) {
        let mut counts = self.counts();
        counts.outside.fill(0);
        (counts.any, counts.requests) = (0, 0);
    }

    /// Counts what the model sees in a request.
    pub(crate) fn count(&self, profile: &Profile, observation: &Observation) -> Result<(), PolicyError> {
        let states = query::numbers(profile, observation)?;
        let counts = &mut *self.counts();
        let mut any = false;
        for ((state, position, _), outside) in counts.numbers.iter().zip(&mut counts.outside) {
            let (range, numbers) = (&profile.states[*state], &states[*state]);
            let Some(number) = numbers.get(*position) else {
                return Err(PolicyError::Observation(format!(
                    "the state `{}` has {} numbers, but the profile has ranges for {}",
                    range.key,
                    numbers.len(),
                    range.low.len()
                )));
            };
            let inside = (range.low[*position]..=range.high[*position]).contains(number);
            *outside += u32::from(!inside);
            any |= !inside;
        }
        counts.any += u32::from(any);
        counts.requests += 1;
        Ok(())
    }

    /// Sets the measures of the episode so far. Without a request there are none.
    fn record(&self, measures: &mut Measures) {
        let counts = self.counts();
        let share = |n: u32| (counts.requests > 0).then(|| f64::from(n) / f64::from(counts.requests));
        measures.set(OUTSIDE_RANGE, share(counts.any));
        for ((_, _, name), outside) in counts.numbers.iter().zip(&counts.outside) {
            measures.set(*name, share(*outside));
        }
    }
}

/// An environment whose episodes have the measures of the states that its policy sees.
pub struct RangeMeasures {
    environment: Box<dyn Environment>,
    task: Arc<TaskSpec>,
    counts: RangeCounts,
}

impl std::fmt::Debug for RangeMeasures {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("RangeMeasures").field("counts", &self.counts).finish_non_exhaustive()
    }
}

impl RangeMeasures {
    /// `counts` are those of a policy with this profile.
    pub fn new(environment: Box<dyn Environment>, profile: &Profile, counts: RangeCounts) -> Self {
        let task = with_range_measures(environment.task(), profile);
        Self { environment, task, counts }
    }
}

impl Environment for RangeMeasures {
    fn adapted(&self) -> Option<&dyn Environment> {
        Some(&*self.environment)
    }

    fn adapted_mut(&mut self) -> Option<&mut dyn Environment> {
        Some(&mut *self.environment)
    }

    fn task(&self) -> &Arc<TaskSpec> {
        &self.task
    }

    fn reset(&mut self, scenario: &Scenario) -> Result<Start, Fault> {
        self.environment.reset(scenario)
    }

    fn step(&mut self, action: &Action) -> Result<Step, Fault> {
        let mut step = self.environment.step(action)?;
        self.counts.record(&mut step.measures);
        Ok(step)
    }
}

#[cfg(test)]
mod tests {
    use robogate_core::vectors;

    use super::*;

    fn profile() -> Profile {
        let text = "name = \"two\"\nmodel = \"m\"\n[dialect]\nname = \"openpi\"\n[[state]]\nkey = \"a/b\"\nparts = [\"gripper_opening\", \"zero\"]\n\
                    low = [0.0, -1.0]\nhigh = [0.05, 1.0]\n[action]\nsize = 1\narm = \"vector\"\n[chunk]\nexecute = 1\n";
        Profile::from_toml(text).unwrap()
    }

    #[test]
    fn shares_are_of_the_requests() {
        let profile = profile();
        let counts = RangeCounts::of(&profile).unwrap();
        let seen = |opening_m: f64| Observation {
            time_s: 0.0,
            vectors: vec![(vectors::GRIPPER_OPENING, vec![opening_m])],
            images: Vec::new(),
        };
        let mut measures = Measures::default();
        counts.record(&mut measures);
        assert!(measures.is_empty());
        for opening_m in [0.02, 0.06, 0.05, 0.0] {
            counts.count(&profile, &seen(opening_m)).unwrap();
        }
        counts.record(&mut measures);
        let share = |name: &str| measures.get(name);
        assert_eq!(
            (share("outside_range"), share("outside_range.a_b.0"), share("outside_range.a_b.1")),
            (Some(0.25), Some(0.25), Some(0.0))
        );
        counts.clear();
        counts.count(&profile, &seen(0.01)).unwrap();
        counts.record(&mut measures);
        assert_eq!(measures.get("outside_range"), Some(0.0));
    }

    #[test]
    fn profiles_without_ranges_measure_nothing() {
        let profile = Profile::from_toml(Profile::built_in("pi0-libero").unwrap()).unwrap();
        assert!(RangeCounts::of(&profile).is_none() && measures(&profile).is_empty());
    }
}
