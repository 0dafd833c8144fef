//! Runs that cannot succeed: the first episodes all fail in the same way, or most actions are outside of their range.

use std::cell::{Cell, RefCell};
use std::ops::ControlFlow;
use std::sync::Arc;

use robogate_campaign::{ExecuteError, Executor};
use robogate_core::{Episode, FailureMode, Foresight, Outcome, Scenario};
use robogate_dictionary::LostEpisode;
use robogate_gate::CLIPPED_ACTIONS;
use robogate_stats::format::percent;

use crate::notice::warning;

/// Number of valid episodes after which a run without a success is looked at.
const FIRST: usize = 20;

/// What happens to such a run.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Reaction {
    /// It stops.
    Stop,
    /// It goes on with a warning.
    Warn,
}

/// An executor that looks at the first episodes.
pub struct Watched<'a> {
    executor: &'a dyn Executor,
    reaction: Reaction,
    first: RefCell<First>,
    diagnosis: RefCell<Option<String>>,
    ended: Cell<bool>,
}

/// The first valid episodes, as long as none succeeded.
#[derive(Debug, Default)]
struct First {
    endings: Vec<(FailureMode, u32, u64)>,
    /// Sum and number of the shares of clipped actions.
    clipped: (f64, u32),
}

impl<'a> Watched<'a> {
    /// Looks at the episodes of `executor`.
    pub fn new(executor: &'a dyn Executor, reaction: Reaction) -> Self {
        let (first, diagnosis, ended) = (RefCell::default(), RefCell::default(), Cell::default());
        Self { executor, reaction, first, diagnosis, ended }
    }

    /// Why the run was stopped, if it was.
    pub fn stopped(self) -> Option<String> {
        self.diagnosis.into_inner()
    }

    /// Looks at an episode. Breaks if the run is to stop.
    fn look(&self, episode: &Episode) -> ControlFlow<()> {
        if self.ended.get() {
            return ControlFlow::Continue(());
        }
        let mut first = self.first.borrow_mut();
        match &episode.outcome {
            Outcome::Invalid(_) => return ControlFlow::Continue(()),
            Outcome::Success => self.ended.set(true),
            Outcome::Failure(mode) => first.add(*mode, episode),
        }
        if self.ended.get() || first.endings.len() < FIRST {
            return ControlFlow::Continue(());
        }
        self.ended.set(true);
        match (first.diagnosis(), self.reaction) {
            (None, _) => ControlFlow::Continue(()),
            (Some(why), Reaction::Warn) => {
                warning(why);
                ControlFlow::Continue(())
            }
            (why, Reaction::Stop) => {
                *self.diagnosis.borrow_mut() = why;
                ControlFlow::Break(())
            }
        }
    }
}

impl First {
    fn add(&mut self, mode: FailureMode, episode: &Episode) {
        self.endings.push((mode, episode.ticks, episode.trajectory_hash));
        if let Some(share) = episode.measures.get(CLIPPED_ACTIONS) {
            self.clipped.0 += share;
            self.clipped.1 += 1;
        }
    }

    /// What is probably wrong. `None` if the episodes differ and most actions are inside of their range.
    fn diagnosis(&self) -> Option<String> {
        let &(mode, ticks, trajectory) = self.endings.first()?;
        let share = if self.clipped.1 > 0 { self.clipped.0 / f64::from(self.clipped.1) } else { 0.0 };
        let none = format!("the first {FIRST} episodes have no success");
        if share > 0.5 {
            return Some(format!(
                "{none}, and {} of the actions were outside of their range and were clipped: check the units and the normalisation \
                 of the policy's actions",
                percent(share)
            ));
        }
        let all = |same: &dyn Fn(&(FailureMode, u32, u64)) -> bool| self.endings.iter().all(same);
        if all(&|(_, _, other)| *other == trajectory) {
            return Some(format!(
                "{none}, and all have the same trajectory: neither seeds nor parameters nor the policy's observations have an effect"
            ));
        }
        let (least, most) = self
            .endings
            .iter()
            .fold((ticks, ticks), |(least, most), (_, ticks, _)| (least.min(*ticks), most.max(*ticks)));
        (all(&|(other, ..)| *other == mode) && most - least <= 1).then(|| {
            format!(
                "{none}, and all end in the same way: {mode} after {most} control periods. Watch one with `robogate replay`, and \
                 check the scale, the order and the signs of the policy's actions"
            )
        })
    }
}

impl Executor for Watched<'_> {
    fn parallelism(&self) -> usize {
        self.executor.parallelism()
    }

    fn foresight(&self) -> Result<Option<Arc<dyn Foresight>>, ExecuteError> {
        self.executor.foresight()
    }

    fn execute(
        &self,
        scenario: &(dyn Fn(usize) -> Option<Scenario> + Sync),
        receive: &mut dyn FnMut(Episode) -> ControlFlow<()>,
    ) -> Result<(), ExecuteError> {
        if self.diagnosis.borrow().is_some() {
            return Ok(());
        }
        self.executor.execute(scenario, &mut |episode| {
            let flow = self.look(&episode);
            if receive(episode).is_break() { ControlFlow::Break(()) } else { flow }
        })
    }

    fn take_lost(&self) -> Vec<LostEpisode> {
        self.executor.take_lost()
    }
}

#[cfg(test)]
mod tests {
    use robogate_core::{Assignment, Measures, Seed, Word};

    use super::*;

    /// Passes episodes to an executor until one stops it. Returns how many ran, and the diagnosis.
    fn run(reaction: Reaction, episode: impl Fn(u64) -> (Outcome, u32, u64, f64) + Sync) -> (usize, Option<String>) {
        struct Scripted<F>(F);
        impl<F: Fn(u64) -> (Outcome, u32, u64, f64)> Executor for Scripted<F> {
            fn parallelism(&self) -> usize {
                1
            }

            fn execute(
                &self,
                scenario: &(dyn Fn(usize) -> Option<Scenario> + Sync),
                receive: &mut dyn FnMut(Episode) -> ControlFlow<()>,
            ) -> Result<(), ExecuteError> {
                for scenario in (0..).map_while(scenario) {
                    let (outcome, ticks, trajectory_hash, clipped) = (self.0)(scenario.index);
                    let measures = [(Word::constant(CLIPPED_ACTIONS), Some(clipped))].into_iter().collect::<Measures>();
                    let (applied, time_s, phase, contact) = (Assignment::default(), 1.0, None, None);
                    let draws = Measures::default();
                    let episode = Episode {
                        scenario,
                        applied,
                        outcome,
                        time_s,
                        phase,
                        contact,
                        measures,
                        draws,
                        ticks,
                        trajectory_hash,
                    };
                    if receive(episode).is_break() {
                        break;
                    }
                }
                Ok(())
            }
        }
        let scripted = Scripted(episode);
        let watched = Watched::new(&scripted, reaction);
        let seed = Seed::campaign(1);
        let scenario = |i: usize| {
            let index = i as u64;
            (i < 50).then(|| Scenario { index, seed: seed.episode(index), requested: Assignment::default() })
        };
        let mut ran = 0;
        let counted = &mut |_| {
            ran += 1;
            ControlFlow::Continue(())
        };
        watched.execute(&scenario, counted).unwrap();
        (ran, watched.stopped())
    }

    const TIMEOUT: Outcome = Outcome::Failure(FailureMode::TIMEOUT);

    #[test]
    fn equal_failures_stop_a_run() {
        let (ran, why) = run(Reaction::Stop, |i| (TIMEOUT, 300 + (i % 2) as u32, i, 0.0));
        assert_eq!(ran, 20);
        assert!(why.is_some_and(|why| why.contains("timeout after 301 control periods")));
        let (ran, why) = run(Reaction::Stop, |i| (TIMEOUT, 300 + i as u32, 7, 0.0));
        assert!(ran == 20 && why.is_some_and(|why| why.contains("same trajectory")));
        let (ran, why) = run(Reaction::Stop, |i| (TIMEOUT, 300 + i as u32, i, 0.9));
        assert!(ran == 20 && why.is_some_and(|why| why.contains("90.0 % of the actions were outside")));
    }

    #[test]
    fn other_runs_go_on() {
        assert_eq!(run(Reaction::Stop, |i| (TIMEOUT, 300 + i as u32, i, 0.0)), (50, None));
        let late = |i: u64| if i == 19 { Outcome::Success } else { TIMEOUT };
        assert_eq!(run(Reaction::Stop, |i| (late(i), 300, i, 0.9)), (50, None));
        assert_eq!(run(Reaction::Warn, |i| (TIMEOUT, 300, i, 0.9)), (50, None));
    }
}
