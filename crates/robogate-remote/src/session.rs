//! The two kinds of servers, seen from the client.

use std::collections::BTreeMap;

use robogate_core::{Action, Assignment, Fault, FaultKind, GripperCommand, Scenario, Seed, Start, Step};
use serde::Serialize;

use super::connection::Connection;
use super::error::RequestError;
use super::message::{Hello, ParameterValue, ResetRequest, to_wire};

/// How episodes are run over a connection.
///
/// A [`ScoredSession`](super::ScoredSession) is for servers that score themselves. A
/// [`PhysicsSession`](super::PhysicsSession) is for servers that compute physics for a task of this process.
pub trait Session {
    /// Check whether a server is of this kind, and whether it can run the task.
    fn accepts(&self, hello: &Hello) -> Result<(), String>;

    /// Begin the episode of a scenario.
    fn reset(&mut self, connection: &mut Connection, scenario: &Scenario) -> Result<Start, RequestError>;

    /// Run one control period.
    fn step(&mut self, connection: &mut Connection, action: &Action) -> Result<Step, RequestError>;

    /// Send a reset with these parameters, which the server may not know, and ignore the content of the reply.
    fn send_reset(
        &mut self,
        connection: &mut Connection,
        scenario: &Scenario,
        parameters: BTreeMap<String, ParameterValue>,
    ) -> Result<(), RequestError>;
}

/// The reset request of a scenario, without the parameters that are `local` to this process.
pub(crate) fn reset_request<C: Serialize>(
    hello: &Hello,
    scenario: &Scenario,
    local: impl Fn(&str) -> bool,
    cell: Option<C>,
) -> Result<ResetRequest<C>, RequestError> {
    let remote: Assignment = scenario
        .requested
        .iter()
        .filter(|(name, _)| !local(name))
        .map(|(name, value)| (name.into(), value.clone()))
        .collect();
    if let Some((name, _)) = remote.iter().find(|(name, _)| !hello.parameters.iter().any(|known| known == name)) {
        let detail = format!("this simulator cannot apply the parameter {name}");
        return Err(RequestError::Local(Fault::new(FaultKind::NotApplied, detail)));
    }
    let seed = scenario.seed.campaign_number();
    if scenario.seed != Seed::campaign(seed).episode(scenario.index) {
        let detail = "the seed of the scenario does not belong to its index";
        return Err(RequestError::Local(Fault::new(FaultKind::Setup, detail)));
    }
    Ok(ResetRequest { index: scenario.index, seed, parameters: to_wire(&remote), cell })
}

/// The last number of an action.
pub(crate) fn gripper_number(gripper: GripperCommand) -> f64 {
    match gripper {
        GripperCommand::Open => -1.0,
        GripperCommand::Close => 1.0,
    }
}
