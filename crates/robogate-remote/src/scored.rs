//! Episodes in a server that has its own task and scores itself.

use std::collections::{BTreeMap, VecDeque};
use std::sync::Arc;

use robogate_core::{
    Action, ActionSpace, Command, Ending, Fault, FaultKind, Measures, Observation, Scenario, Start, Step, TaskInstance,
    TaskSpec, Trajectory,
};
use serde::de::IgnoredAny;

use super::connection::Connection;
use super::error::{RequestError, violation};
use super::limits::AHEAD;
use super::message::{ActionKind, Empty, Hello, ParameterValue, Period, Proposed, ResetReply, ResetRequest, from_wire};
use super::proposals::Proposals;
use super::session::{Session, gripper_number, reset_request};

/// A session with a server that has its own task and reports how an episode ended.
#[derive(Debug, Clone, Default)]
pub struct ScoredSession {
    /// The policy of the server that proposes the actions, if there is one.
    pub(crate) proposals: Option<Proposals>,
    /// The ending of the running episode that the server reports as certain.
    pub(crate) foregone: Option<Ending>,
    /// The hidden draws of the running episode.
    pub(crate) draws: Measures,
    /// Whether each action is sent on its own, because it may differ from the one that the policy proposed.
    pub(crate) in_step: bool,
    /// Whether the episode is filmed. Other states of it, also the final one, will be rendered too, so the server must not run
    /// ahead.
    pub(crate) filmed: bool,
    /// The time between two recorded frames, in seconds. `None`: no motion is recorded.
    record_s: Option<f64>,
    /// Whether the motion of the episode is recorded and was not requested yet.
    motion_due: bool,
    /// The recorded motion of the last episode.
    pub(crate) motion: Option<Trajectory>,
    /// Control periods that the server has already run, each with its action.
    ran: VecDeque<(Proposed, Period<Empty>)>,
}

impl ScoredSession {
    /// A session whose actions are those of a policy in the server.
    pub(crate) fn with_policy(proposals: Proposals) -> Self {
        Self { proposals: Some(proposals), ..Self::default() }
    }

    /// Number of control periods that the server is ahead of this process.
    pub(crate) fn periods_ahead(&self) -> usize {
        self.ran.len()
    }

    /// The result of the next control period: from the server, or from those that it has already run.
    fn next_period(
        &mut self,
        connection: &mut Connection,
        kind: ActionKind,
        numbers: Vec<f64>,
    ) -> Result<Period<Empty>, RequestError> {
        if let Some((proposed, period)) = self.ran.pop_front() {
            if (proposed.action_space, &proposed.action) != (kind, &numbers) {
                let detail = "the server has already run another action: only its own policy can act in this episode";
                return Err(RequestError::Local(Fault::new(FaultKind::Setup, detail)));
            }
            return Ok(period);
        }
        let runs_ahead = self.proposals.is_some() && !self.in_step && !self.filmed;
        let ahead = if runs_ahead { periods_ahead(&connection.hello().task) } else { 0 };
        let (first, others) = connection.run_ahead::<Empty>(kind, numbers, ahead)?;
        let mut proposed = first.proposed.clone();
        for period in others {
            let Some(action) = proposed else { return Err(violation("the server ran ahead without an action")) };
            proposed = period.proposed.clone();
            self.ran.push_back((action, period));
        }
        Ok(first)
    }
}

/// The number of control periods that a server may run ahead with the actions of its own policy. 0 if an action is
/// converted on its way through this process, which might round it.
fn periods_ahead(task: &TaskSpec) -> u32 {
    let exact = matches!(&task.action.spaces[..], [ActionSpace::Vector { .. }]) && task.action.gripper.is_none();
    if exact { AHEAD } else { 0 }
}

impl Session for ScoredSession {
    fn accepts(&self, hello: &Hello) -> Result<(), String> {
        if hello.scores_itself {
            return Ok(());
        }
        Err("the server does not score itself: it only computes physics for a task of RoboGate".to_owned())
    }

    fn task(&self, hello: &Hello) -> Arc<TaskSpec> {
        Arc::new(hello.task.clone())
    }

    fn reset(&mut self, connection: &mut Connection, scenario: &Scenario) -> Result<Start, RequestError> {
        self.foregone = None;
        check_parameters(&connection.hello().task, scenario).map_err(RequestError::Local)?;
        self.ran.clear();
        let mut request = reset_request::<Empty>(scenario, &scenario.requested, None)?;
        (self.motion, self.filmed) = (None, false);
        request.record_s = self.record_s.filter(|_| connection.hello().records_motion);
        self.motion_due = request.record_s.is_some();
        request.policy = self.proposals.as_ref().map(|proposals| proposals.policy().to_owned());
        let reply: ResetReply<Empty, Empty> = connection.begin(request)?;
        self.draws = read_draws(connection, reply.draws.unwrap_or_default());
        let task = &connection.hello().task;
        let observation = reply.observation.checked(task, 0.0).map_err(violation)?;
        let Some(applied) = reply.applied else { return Err(violation("the reply to reset has no `applied`")) };
        let general = || TaskInstance { instruction: task.instruction.clone(), ..TaskInstance::default() };
        let instance = reply.instance.unwrap_or_else(general);
        if let Some(proposals) = &self.proposals {
            proposals.put(task, reply.proposed)?;
        }
        Ok(Start { instance, observation, applied: from_wire(&applied, &scenario.requested) })
    }

    fn step(&mut self, connection: &mut Connection, action: &Action) -> Result<Step, RequestError> {
        let (kind, numbers) = encode_action(&connection.hello().task, action).map_err(RequestError::Local)?;
        let mut period = self.next_period(connection, kind, numbers)?;
        let observation = connection.advance(&mut period)?;
        if let Some(proposals) = &self.proposals {
            proposals.put(&connection.hello().task, period.proposed.take())?;
        }
        self.foregone = period.foregone.take().map(Ending::from);
        if let Some(ending) = &self.foregone {
            let limit_s = connection.hello().task.time_limit_s;
            if !(observation.time_s - 1e-6..=limit_s + 1e-6).contains(&ending.time_s) {
                let (end_s, now_s) = (ending.time_s, observation.time_s);
                return Err(violation(format!(
                    "`foregone` ends the episode at {end_s} s; expected a time from {now_s} s to the limit of {limit_s} s"
                )));
            }
        }
        read_step(connection, period, observation)
    }

    fn record(&mut self, period_s: Option<f64>) {
        self.record_s = period_s;
    }

    fn keeps_server(&self) -> bool {
        self.filmed
    }

    fn ended(&mut self, connection: &mut Connection) {
        if !std::mem::take(&mut self.motion_due) {
            return;
        }
        match connection.motion() {
            Ok(motion) => self.motion = Some(motion).filter(|motion| !motion.frames.is_empty()),
            // The record of the episode does not need it.
            Err(why) => connection.note(format!("the motion of an episode is not shown: {why}")),
        }
    }

    fn send_reset(
        &mut self,
        connection: &mut Connection,
        _: &Scenario,
        parameters: BTreeMap<String, ParameterValue>,
    ) -> Result<(), RequestError> {
        let request = ResetRequest::<Empty> { index: 0, seed: 0, parameters, cell: None, policy: None, record_s: None };
        connection.begin::<IgnoredAny>(request).map(drop)
    }
}

/// Check that the task declares each requested parameter and accepts its value.
fn check_parameters(task: &TaskSpec, scenario: &Scenario) -> Result<(), Fault> {
    for (name, value) in scenario.requested.iter() {
        match task.parameter(name) {
            None => {
                let detail = format!("the task `{}` declares no parameter `{name}`", task.name);
                return Err(Fault::new(FaultKind::NotApplied, detail));
            }
            Some(spec) => spec.accepts(value).map_err(|why| Fault::new(FaultKind::Setup, why))?,
        }
    }
    Ok(())
}

/// An action as the server expects it: its kind, and one number for each of its dimensions.
fn encode_action(task: &TaskSpec, action: &Action) -> Result<(ActionKind, Vec<f64>), Fault> {
    let bad = |detail: String| Fault::new(FaultKind::BadAction, detail);
    task.check_action(action).map_err(bad)?;
    let mut numbers = match (&action.command, task.action.tool_delta()) {
        (Command::ToolDelta { translation_m, rotation_rad }, Some((metres, radians))) => {
            let translation = translation_m.map(|x| x / metres);
            let numbers: Vec<f64> = translation.into_iter().chain(rotation_rad.map(|x| x / radians)).collect();
            // The server would clip it, and then run another action than that of the policy.
            if numbers.iter().any(|x| x.abs() > 1.0 + 1e-9) {
                return Err(bad(format!(
                    "the tool delta {translation_m:?} m, {rotation_rad:?} rad is out of range: this task takes up to \
                     {metres} m and {radians} rad per control period"
                )));
            }
            numbers
        }
        (Command::ToolDelta { .. }, None) => return Err(bad("this task takes no tool deltas".to_owned())),
        (Command::JointPosition(numbers) | Command::Vector(numbers), _) => numbers.clone(),
    };
    numbers.extend(gripper_number(task.action.gripper, action.gripper));
    Ok((ActionKind::of(&action.command), numbers))
}

fn read_draws(connection: &mut Connection, mut reported: BTreeMap<String, Option<f64>>) -> Measures {
    let declared = connection.hello().task.draws.iter();
    let draws = declared.map(|spec| (spec.name, reported.remove(spec.name.as_str()).flatten())).collect();
    for name in reported.into_keys() {
        connection.note(format!("the draw `{name}` is ignored: the task does not declare it"));
    }
    draws
}

fn read_step(
    connection: &mut Connection,
    period: Period<Empty>,
    observation: Observation,
) -> Result<Step, RequestError> {
    let Some(mut reported) = period.measures else { return Err(violation("the step has no `measures`")) };
    let declared = connection.hello().task.measures.iter();
    let measures: Measures = declared.map(|spec| (spec.name, reported.remove(spec.name.as_str()).flatten())).collect();
    for name in reported.into_keys() {
        connection.note(format!("the measure `{name}` is ignored: the task does not declare it"));
    }
    let ending = period.ending.map(Ending::from);
    if let Some(ending) = &ending {
        if !(0.0..=observation.time_s + 1e-6).contains(&ending.time_s) {
            let (end_s, now_s) = (ending.time_s, observation.time_s);
            return Err(violation(format!("the episode ended at {end_s} s, but the simulated time is {now_s} s")));
        }
        if let Some(mode) = ending.failure.filter(|mode| !connection.hello().task.declares(*mode)) {
            connection.note(format!("an episode ended with the failure `{mode}`, which the task does not declare"));
        }
    }
    Ok(Step { observation, measures, ending, events: period.events.unwrap_or_default(), state_hash: period.state_hash })
}
