//! Policies that run in the server.

use std::sync::{Arc, Mutex, PoisonError};

use robogate_core::{Action, Fault, FaultKind, Observation, Policy, Seed, TaskInstance, TaskSpec};

use super::error::{RequestError, violation};
use super::message::Proposed;
use super::server::decode_action;

/// The next action of a server's policy, shared between the environment that receives it and the policy that returns
/// it.
#[derive(Debug, Clone)]
pub(crate) struct Proposals {
    policy: Arc<str>,
    next: Arc<Mutex<Option<Action>>>,
}

impl Proposals {
    pub(crate) fn new(policy: &str) -> Self {
        Self { policy: policy.into(), next: Arc::default() }
    }

    /// Name of the policy.
    pub(crate) fn policy(&self) -> &str {
        &self.policy
    }

    /// Keep the action of a reply. A reply that ends the episode has none.
    pub(crate) fn put(&self, task: &TaskSpec, proposed: Option<Proposed>) -> Result<(), RequestError> {
        let action = proposed.map(|Proposed { action_space, action }| {
            let wrong =
                |why| violation(format!("the policy {} proposes an action that is not valid: {why}", self.policy));
            decode_action(task, action_space, &action).map_err(|error| wrong(error.detail))
        });
        *self.next.lock().unwrap_or_else(PoisonError::into_inner) = action.transpose()?;
        Ok(())
    }
}

/// A policy that runs in the server of the environment: each reply of the server proposes the next action.
#[derive(Debug)]
pub struct RemotePolicy(pub(crate) Proposals);

impl Policy for RemotePolicy {
    fn check(&self, _: &TaskSpec) -> Result<(), String> {
        Ok(())
    }

    fn reset(&mut self, _: &TaskSpec, _: &TaskInstance, _: Seed) -> Result<(), Fault> {
        // The server begins the episode of its policy with that of the environment.
        Ok(())
    }

    fn act(&mut self, _: &Observation) -> Result<Action, Fault> {
        let next = self.0.next.lock().unwrap_or_else(PoisonError::into_inner).take();
        next.ok_or_else(|| {
            let detail = format!("the server proposed no action of the policy {}", self.0.policy);
            Fault::new(FaultKind::Unavailable, detail)
        })
    }
}
