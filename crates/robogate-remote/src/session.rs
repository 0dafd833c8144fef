//! The two kinds of sessions with servers.

use std::collections::BTreeMap;
use std::sync::Arc;

use robogate_core::{Action, Assignment, Fault, FaultKind, GripperKind, Scenario, Seed, Start, Step, TaskSpec};
use serde::Serialize;

use super::connection::Connection;
use super::error::RequestError;
use super::message::{Hello, ParameterValue, ResetRequest, to_wire};

/// The way in which episodes run over a connection.
///
/// A [`ScoredSession`](super::ScoredSession) is for servers that score themselves. A
/// [`PhysicsSession`](super::PhysicsSession) is for servers that compute physics for a task of this process.
pub trait Session {
    /// Check whether a server is of this kind and can run the task.
    fn accepts(&self, hello: &Hello) -> Result<(), String>;

    /// The task of the episodes: that of the server, or that of this process.
    fn task(&self, hello: &Hello) -> Arc<TaskSpec>;

    /// Begin the episode of a scenario.
    fn reset(&mut self, connection: &mut Connection, scenario: &Scenario) -> Result<Start, RequestError>;

    /// Run one control period.
    fn step(&mut self, connection: &mut Connection, action: &Action) -> Result<Step, RequestError>;

    /// Record the motion of all bodies in later episodes, if the server can: at most one frame in this time, in seconds.
    fn record(&mut self, _period_s: Option<f64>) {}

    /// Whether the final state of an episode may still be rendered, so that the server is held until the next episode.
    fn keeps_server(&self) -> bool {
        false
    }

    /// Called when the episode has ended, while the server is still held.
    fn ended(&mut self, _connection: &mut Connection) {}

    /// Send a reset with these parameters, which the server may not know. The content of the reply is ignored.
    fn send_reset(
        &mut self,
        connection: &mut Connection,
        scenario: &Scenario,
        parameters: BTreeMap<String, ParameterValue>,
    ) -> Result<(), RequestError>;
}

/// The reset request of a scenario, with only these of its parameters.
pub(crate) fn reset_request<C: Serialize>(
    scenario: &Scenario,
    parameters: &Assignment,
    cell: Option<C>,
) -> Result<ResetRequest<C>, RequestError> {
    let seed = scenario.seed.campaign_number();
    if scenario.seed != Seed::campaign(seed).episode(scenario.index) {
        let detail = "the seed of the scenario does not belong to its index";
        return Err(RequestError::Local(Fault::new(FaultKind::Setup, detail)));
    }
    Ok(ResetRequest {
        index: scenario.index,
        seed,
        parameters: to_wire(parameters),
        cell,
        policy: None,
        record_s: None,
    })
}

/// The last number of an action, if the task declares a gripper.
pub(crate) fn gripper_number(kind: Option<GripperKind>, command: Option<f64>) -> Option<f64> {
    let command = command.unwrap_or(Action::OPEN);
    kind.map(|kind| match kind {
        GripperKind::Binary if command > 0.0 => Action::CLOSE,
        GripperKind::Binary => Action::OPEN,
        GripperKind::Continuous => command,
    })
}
