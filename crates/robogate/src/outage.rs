//! Stops a campaign whose policy server is unavailable.

use std::cell::RefCell;
use std::ops::ControlFlow;
use std::sync::Arc;

use robogate_campaign::{ExecuteError, Executor};
use robogate_core::{Episode, Fault, FaultKind, Foresight, Outcome, Scenario};

/// Number of consecutive episodes that may be lost to an unavailable policy server before the campaign stops.
pub(crate) const UNAVAILABLE_IN_A_ROW: u32 = 10;

/// An executor that stops after a number of consecutive episodes, in the order in which they finish, ended with
/// [`FaultKind::Unavailable`], and runs nothing after that. Episodes that finish later are not recorded, so that a
/// resumed campaign runs them.
pub(crate) struct OutageGuard<'a> {
    executor: &'a dyn Executor,
    state: RefCell<State>,
}

struct State {
    limit: u32,
    in_a_row: u32,
    outage: Option<Fault>,
}

impl<'a> OutageGuard<'a> {
    /// Guards `executor`, and stops it after `limit` lost episodes in a row.
    pub(crate) fn new(executor: &'a dyn Executor, limit: u32) -> Self {
        Self { executor, state: RefCell::new(State { limit, in_a_row: 0, outage: None }) }
    }

    /// The fault of the last lost episode, if the guard stopped the campaign.
    pub(crate) fn outage(self) -> Option<Fault> {
        self.state.into_inner().outage
    }
}

impl State {
    fn count(&mut self, outcome: &Outcome) -> ControlFlow<()> {
        match outcome {
            Outcome::Invalid(fault) if fault.kind == FaultKind::Unavailable => {
                self.in_a_row += 1;
                if self.in_a_row >= self.limit {
                    self.outage = Some(fault.clone());
                    return ControlFlow::Break(());
                }
            }
            _ => self.in_a_row = 0,
        }
        ControlFlow::Continue(())
    }
}

impl Executor for OutageGuard<'_> {
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
        self.executor.execute(scenario, &mut |episode| {
            let counted = self.state.borrow_mut().count(&episode.outcome);
            receive(episode)?;
            counted
        })
    }
}
