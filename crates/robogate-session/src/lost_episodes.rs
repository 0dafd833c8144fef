//! Runs episodes again that were lost to an unavailable policy server, simulator or worker.

use std::cell::RefCell;
use std::collections::BTreeSet;
use std::fmt;
use std::ops::ControlFlow;
use std::sync::Arc;

use robogate_campaign::{ExecuteError, Executor};
use robogate_core::{Episode, Fault, FaultKind, Foresight, Outcome, Scenario};
use robogate_dictionary::LostEpisode;

use crate::notice::note;
use crate::text::foreign;

/// Smallest number of consecutive lost episodes that stops a run.
const LOST_IN_A_ROW: u32 = 10;

/// Words of faults after which no policy has seen an observation: nothing listened, or nothing could be started.
const NOT_BEGUN: [&str; 4] = ["unreachable: ", "not ready: ", "cannot be started again", "all simulators were in use"];

/// The lost episodes of an attempt with their faults, and whether the receiver has stopped the execution.
type Attempt = (Vec<(Episode, Fault)>, ControlFlow<()>);

/// An executor that runs an episode a second time if the first attempt ended with [`FaultKind::Unavailable`].
///
/// A lost episode is not recorded. It runs again once all other episodes of the execution are done, or when the run is
/// resumed. An episode that is lost twice is recorded as invalid if another episode still runs after that, because then
/// this episode itself breaks the server or the worker. Otherwise the servers are unavailable. A number of consecutive
/// lost episodes, in the order in which they finish, shows the same earlier, unless a completed episode still runs. After such an [`Outage`] nothing runs.
pub struct RunsLostAgain<'a> {
    executor: &'a dyn Executor,
    limit: u32,
    state: RefCell<State>,
}

#[derive(Default)]
struct State {
    in_a_row: u32,
    outage: Option<Outage>,
    /// Kinds of faults of which an invalid episode was printed.
    shown: BTreeSet<FaultKind>,
    /// Losses that the campaign has not recorded yet.
    lost: Vec<LostEpisode>,
    /// A completed episode of any execution, which shows later whether the servers still answer.
    completed: Option<Scenario>,
}

/// The reason why a run was stopped: the policy server or the simulator is unavailable.
#[derive(Debug, Clone, PartialEq)]
pub enum Outage {
    /// Consecutive episodes were lost.
    InARow {
        /// Their number.
        episodes: u32,
        /// The fault of the last one.
        last: Fault,
    },
    /// Episodes were lost twice, and no episode ran after that.
    Twice {
        /// The fault of the last one.
        last: Fault,
    },
}

impl fmt::Display for Outage {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::InARow { episodes, last } => {
                write!(f, "{episodes} episodes in a row were lost, the last because of {last}")
            }
            Self::Twice { last } => write!(f, "episodes were lost twice, the last because of {last}"),
        }
    }
}

impl<'a> RunsLostAgain<'a> {
    /// Runs at most `episodes` episodes with `executor`.
    pub fn new(executor: &'a dyn Executor, episodes: u64) -> Self {
        // A server that restarts loses one episode of each thread, which is not yet an outage.
        let threads = u32::try_from(executor.parallelism()).unwrap_or(u32::MAX);
        let limit = LOST_IN_A_ROW.max(threads.saturating_mul(2));
        let limit = limit.min(u32::try_from(episodes).unwrap_or(u32::MAX)).max(1);
        Self { executor, limit, state: RefCell::default() }
    }

    /// The outage that has stopped the execution, if there was one.
    pub fn outage(self) -> Option<Outage> {
        self.state.into_inner().outage
    }

    /// Runs episodes. Returns the lost ones, and whether the receiver or an outage has stopped the execution.
    fn attempt(
        &self,
        scenario: &(dyn Fn(usize) -> Option<Scenario> + Sync),
        receive: &mut dyn FnMut(Episode) -> ControlFlow<()>,
    ) -> Result<Attempt, ExecuteError> {
        let (mut lost, mut flow) = (Vec::new(), ControlFlow::Continue(()));
        self.executor.execute(scenario, &mut |episode| {
            flow = match &episode.outcome {
                Outcome::Invalid(fault) if fault.kind == FaultKind::Unavailable => {
                    let fault = fault.clone();
                    let counted = self.count(&episode, &fault);
                    lost.push((episode, fault));
                    counted
                }
                outcome => {
                    if let Outcome::Invalid(fault) = outcome {
                        self.show_first(&episode, fault);
                    }
                    self.state.borrow_mut().in_a_row = 0;
                    receive(episode)
                }
            };
            flow
        })?;
        Ok((lost, flow))
    }

    /// Prints the first invalid episode of each kind of fault, because the summary of a run only counts them.
    fn show_first(&self, episode: &Episode, fault: &Fault) {
        if self.state.borrow_mut().shown.insert(fault.kind) {
            note(format_args!("episode {} is invalid: {}", episode.scenario.index, foreign(fault)));
        }
    }

    /// Counts a lost episode. Breaks if it shows an outage.
    fn count(&self, episode: &Episode, fault: &Fault) -> ControlFlow<()> {
        let mut state = self.state.borrow_mut();
        let began = episode.ticks > 0 || !NOT_BEGUN.iter().any(|words| fault.detail.contains(words));
        state.lost.push(LostEpisode { index: episode.scenario.index, fault: fault.to_string(), began });
        state.in_a_row += 1;
        if state.in_a_row < self.limit {
            return ControlFlow::Continue(());
        }
        state.outage = Some(Outage::InARow { episodes: state.in_a_row, last: fault.clone() });
        ControlFlow::Break(())
    }

    /// Continues after lost episodes, because others run.
    fn continues(&self) {
        let mut state = self.state.borrow_mut();
        (state.in_a_row, state.outage) = (0, None);
    }

    /// Whether an episode that was completed before can still be completed.
    fn runs(&self) -> Result<bool, ExecuteError> {
        let completed = self.state.borrow().completed.clone();
        let mut ran = false;
        let executed = self.executor.execute(&|i| completed.clone().filter(|_| i == 0), &mut |episode| {
            ran = !matches!(&episode.outcome, Outcome::Invalid(fault) if fault.kind == FaultKind::Unavailable);
            ControlFlow::Continue(())
        });
        match executed {
            // A new worker does not reach the server either.
            Err(ExecuteError::Worker(fault)) if fault.kind == FaultKind::Unavailable => Ok(false),
            other => other.map(|()| ran),
        }
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
        if self.state.borrow().outage.is_some() {
            return Ok(());
        }
        let (mut done, mut lost) = (BTreeSet::new(), Vec::new());
        let mut rest: Option<Vec<Scenario>> = None;
        let flow = loop {
            let next = |i: usize| rest.as_ref().map_or_else(|| scenario(i), |rest| rest.get(i).cloned());
            let (more, flow) = self.attempt(&next, &mut |episode| {
                self.state.borrow_mut().completed.get_or_insert_with(|| episode.scenario.clone());
                done.insert(episode.scenario.index);
                receive(episode)
            })?;
            done.extend(more.iter().map(|(episode, _)| episode.scenario.index));
            lost.extend(more);
            // Many episodes may be lost in a row because they break the server themselves.
            if self.state.borrow().outage.is_none() || !self.runs()? {
                break flow;
            }
            self.continues();
            rest = Some((0..).map_while(scenario).filter(|scenario| !done.contains(&scenario.index)).collect());
        };
        let Some((_, fault)) = lost.first().filter(|_| flow.is_continue()) else {
            return Ok(());
        };
        match lost.len() {
            1 => note(format_args!("1 episode was lost and runs again: {fault}")),
            n => note(format_args!("{n} episodes were lost and run again, the first because of {fault}")),
        }
        self.continues();
        let mut again: Vec<Scenario> = lost.into_iter().map(|(episode, _)| episode.scenario).collect();
        loop {
            let mut done = BTreeSet::new();
            let attempted = self.attempt(&|i| again.get(i).cloned(), &mut |episode| {
                self.state.borrow_mut().completed.get_or_insert_with(|| episode.scenario.clone());
                done.insert(episode.scenario.index);
                receive(episode)
            });
            let (lost, flow) = match attempted {
                // A new worker does not reach the server.
                Err(ExecuteError::Worker(last)) if last.kind == FaultKind::Unavailable => {
                    self.state.borrow_mut().outage = Some(Outage::Twice { last });
                    return Ok(());
                }
                other => other?,
            };
            let stopped = self.state.borrow().outage.is_some();
            let Some((_, fault)) = lost.last().filter(|_| flow.is_continue() || stopped) else {
                return Ok(());
            };
            if !self.runs()? {
                let twice = Outage::Twice { last: fault.clone() };
                self.state.borrow_mut().outage.get_or_insert(twice);
                return Ok(());
            }
            self.continues();
            done.extend(lost.iter().map(|(episode, _)| episode.scenario.index));
            let received = lost.into_iter().try_for_each(|(episode, _)| receive(episode));
            again.retain(|scenario| !done.contains(&scenario.index));
            if !stopped || received.is_break() {
                return Ok(());
            }
        }
    }

    fn take_lost(&self) -> Vec<LostEpisode> {
        std::mem::take(&mut self.state.borrow_mut().lost)
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
        let executor = RunsLostAgain::new(&scripted, 6);
        let mut recorded = Vec::new();
        let seed = Seed::campaign(1);
        let scenario = |i: usize| {
            let index = i as u64;
            (i < 6).then(|| Scenario { index, seed: seed.episode(index), requested: Assignment::default() })
        };
        executor
            .execute(&scenario, &mut |episode| {
                recorded.push((episode.scenario.index, matches!(episode.outcome, Outcome::Success)));
                ControlFlow::Continue(())
            })
            .unwrap();
        recorded.sort_unstable();
        let outage = executor.outage().is_some();
        (recorded, scripted.attempts.into_inner().len(), outage)
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
        // As many consecutive losses as the limit, which is the number of episodes here.
        assert_eq!(run(|_, _| false), (Vec::new(), 6, true));
    }

    #[test]
    fn many_breaking_episodes_are_no_outage() {
        // With one thread the limit is six here, the number of episodes: five of them break the server in a row.
        let (recorded, _, outage) = run(|_, index| index == 0);
        assert_eq!((recorded, outage), ((0..6).map(|i| (i, i == 0)).collect(), false));
        let scripted = Scripted { available: |_: usize, index: u64| index < 2, attempts: RefCell::default() };
        let executor = RunsLostAgain { limit: 2, ..RunsLostAgain::new(&scripted, 6) };
        let mut recorded = 0;
        let seed = Seed::campaign(1);
        let scenario = |i: usize| {
            let index = i as u64;
            (i < 9).then(|| Scenario { index, seed: seed.episode(index), requested: Assignment::default() })
        };
        let mut count = |_: Episode| {
            recorded += 1;
            ControlFlow::Continue(())
        };
        executor.execute(&scenario, &mut count).unwrap();
        assert_eq!((recorded, executor.outage()), (9, None));
    }

    #[test]
    fn breaking_episode_is_invalid() {
        let (recorded, attempts, outage) = run(|_, index| index != 5);
        assert_eq!(recorded, (0..6).map(|i| (i, i != 5)).collect::<Vec<_>>());
        assert_eq!((attempts, outage), (8, false));
    }
}
