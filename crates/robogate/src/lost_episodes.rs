//! Runs the episodes of a shard again that were lost to an unavailable policy server or simulator.

use std::cell::RefCell;
use std::ops::ControlFlow;
use std::sync::Arc;

use robogate_campaign::{ExecuteError, Executor};
use robogate_core::{Episode, Fault, FaultKind, Foresight, Outcome, Scenario};

use crate::terminal::note;

/// The lost episodes of an attempt with their faults, and whether the receiver has stopped the execution.
type Attempt = (Vec<(Episode, Fault)>, ControlFlow<()>);

/// An executor that runs an episode a second time if the first attempt ended with [`FaultKind::Unavailable`].
///
/// An episode that is lost twice is recorded as invalid if another episode still runs after that, because then this
/// episode itself breaks the server or the worker. Otherwise the servers are unavailable ([`Self::outage`]). A shard
/// whose last episodes were lost must not be committed: no later episode would show that the server has failed.
pub(crate) struct RunsLostAgain<'a> {
    executor: &'a dyn Executor,
    outage: &'a RefCell<Option<Fault>>,
}

impl<'a> RunsLostAgain<'a> {
    /// Runs episodes with `executor`. `outage` receives the fault if the servers stay unavailable.
    pub(crate) fn new(executor: &'a dyn Executor, outage: &'a RefCell<Option<Fault>>) -> Self {
        Self { executor, outage }
    }

    /// Runs episodes. Returns the lost ones, and whether the receiver has stopped the execution.
    fn attempt(
        &self,
        scenario: &(dyn Fn(usize) -> Option<Scenario> + Sync),
        receive: &mut dyn FnMut(Episode) -> ControlFlow<()>,
    ) -> Result<Attempt, ExecuteError> {
        let (mut lost, mut flow) = (Vec::new(), ControlFlow::Continue(()));
        self.executor.execute(scenario, &mut |episode| {
            match &episode.outcome {
                Outcome::Invalid(fault) if fault.kind == FaultKind::Unavailable => {
                    let fault = fault.clone();
                    lost.push((episode, fault));
                }
                _ => flow = receive(episode),
            }
            flow
        })?;
        Ok((lost, flow))
    }
}

impl Executor for RunsLostAgain<'_> {
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
        let mut completed = None;
        let (lost, flow) = self.attempt(scenario, &mut |episode| {
            completed.get_or_insert_with(|| episode.scenario.clone());
            receive(episode)
        })?;
        let Some((_, fault)) = lost.first().filter(|_| flow.is_continue()) else {
            return Ok(());
        };
        note(format_args!("{} episodes were lost and run again, the first because of {fault}", lost.len()));
        let again: Vec<Scenario> = lost.into_iter().map(|(episode, _)| episode.scenario).collect();
        let (lost, flow) = self.attempt(&|i| again.get(i).cloned(), &mut |episode| {
            completed.get_or_insert_with(|| episode.scenario.clone());
            receive(episode)
        })?;
        let Some((_, fault)) = lost.last().filter(|_| flow.is_continue()) else {
            return Ok(());
        };
        if self.runs(completed)? {
            let _ = lost.into_iter().try_for_each(|(episode, _)| receive(episode));
        } else {
            *self.outage.borrow_mut() = Some(fault.clone());
        }
        Ok(())
    }
}

impl RunsLostAgain<'_> {
    /// Whether an episode that was completed before can still be completed.
    fn runs(&self, completed: Option<Scenario>) -> Result<bool, ExecuteError> {
        let mut ran = false;
        let (_, _) = self.attempt(&|i| completed.clone().filter(|_| i == 0), &mut |_| {
            ran = true;
            ControlFlow::Continue(())
        })?;
        Ok(ran)
    }
}

#[cfg(test)]
mod tests {
    use robogate_core::{Assignment, Measures, Seed};

    use super::*;

    /// Runs episodes in order. `available(attempt, index)` says whether the server answers.
    struct Scripted<F> {
        available: F,
        attempts: RefCell<Vec<u64>>,
    }

    impl<F: Fn(usize, u64) -> bool> Executor for Scripted<F> {
        fn parallelism(&self) -> usize {
            1
        }

        fn execute(
            &self,
            scenario: &(dyn Fn(usize) -> Option<Scenario> + Sync),
            receive: &mut dyn FnMut(Episode) -> ControlFlow<()>,
        ) -> Result<(), ExecuteError> {
            for scenario in (0..).map_while(scenario) {
                let number = self.attempts.borrow().iter().filter(|index| **index == scenario.index).count();
                self.attempts.borrow_mut().push(scenario.index);
                let fault = Fault::new(FaultKind::Unavailable, "gone");
                let answers = (self.available)(number, scenario.index);
                let episode = Episode {
                    scenario,
                    applied: Assignment::default(),
                    outcome: if answers { Outcome::Success } else { Outcome::Invalid(fault) },
                    time_s: 0.0,
                    phase: None,
                    contact: None,
                    measures: Measures::default(),
                    draws: Default::default(),
                    ticks: 0,
                    trajectory_hash: 0,
                };
                if receive(episode).is_break() {
                    break;
                }
            }
            Ok(())
        }
    }

    /// The recorded episodes (index, valid), the number of attempts, and whether there was an outage.
    fn run(available: impl Fn(usize, u64) -> bool) -> (Vec<(u64, bool)>, usize, bool) {
        let scripted = Scripted { available, attempts: RefCell::default() };
        let outage = RefCell::default();
        let mut recorded = Vec::new();
        let seed = Seed::campaign(1);
        let scenario = |i: usize| {
            let index = i as u64;
            (i < 6).then(|| Scenario { index, seed: seed.episode(index), requested: Assignment::default() })
        };
        RunsLostAgain::new(&scripted, &outage)
            .execute(&scenario, &mut |episode| {
                recorded.push((episode.scenario.index, matches!(episode.outcome, Outcome::Success)));
                ControlFlow::Continue(())
            })
            .unwrap();
        recorded.sort_unstable();
        (recorded, scripted.attempts.into_inner().len(), outage.into_inner().is_some())
    }

    #[test]
    fn short_outage_leaves_no_trace() {
        let (recorded, attempts, outage) = run(|attempt, index| attempt > 0 || index < 4);
        assert_eq!((recorded.len(), attempts, outage), (6, 8, false));
        assert!(recorded.iter().all(|(_, valid)| *valid));
    }

    #[test]
    fn lasting_outage_records_nothing_invalid() {
        // The server dies before the last two episodes, and stays down.
        let (recorded, attempts, outage) = run(|attempt, index| attempt == 0 && index < 4);
        assert_eq!((recorded, attempts, outage), ((0..4).map(|i| (i, true)).collect(), 9, true));
        assert_eq!(run(|_, _| false), (Vec::new(), 12, true));
    }

    #[test]
    fn breaking_episode_is_invalid() {
        let (recorded, attempts, outage) = run(|_, index| index != 5);
        assert_eq!(recorded, (0..6).map(|i| (i, i != 5)).collect::<Vec<_>>());
        assert_eq!((attempts, outage), (8, false));
    }
}
