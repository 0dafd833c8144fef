//! Episodes in a server that has its own task and scores itself.

use std::collections::BTreeMap;

use robogate_core::{Action, ArmCommand, Assignment, Ending, Fault, FaultKind, Observation, Scenario, Start, Step};
use serde::de::IgnoredAny;

use super::connection::Connection;
use super::error::{RequestError, violation};
use super::message::{
    ActionSpace, Empty, Hello, ParameterValue, Period, ResetReply, ResetRequest, check_pose, from_wire,
};
use super::session::{Session, gripper_number, reset_request};

/// A session with a server that has its own task and reports how an episode ended.
#[derive(Debug, Clone, Copy, Default)]
pub struct ScoredSession;

impl Session for ScoredSession {
    fn accepts(&self, hello: &Hello) -> Result<(), String> {
        if hello.scores_itself {
            return Ok(());
        }
        Err("it does not score itself: it only computes physics for a task of RoboGate".to_owned())
    }

    fn reset(&mut self, connection: &mut Connection, scenario: &Scenario) -> Result<Start, RequestError> {
        let request = reset_request::<Empty>(connection.hello(), scenario, |_| false, None)?;
        let reply: ResetReply<Empty, Empty> = connection.begin(request)?;
        start(connection.hello(), reply, &scenario.requested)
    }

    fn step(&mut self, connection: &mut Connection, action: &Action) -> Result<Step, RequestError> {
        let (action_space, numbers) = encode_action(connection.hello(), action).map_err(RequestError::Local)?;
        let (period, observation) = connection.run::<Empty>(action_space, numbers)?;
        step(period, observation)
    }

    fn send_reset(
        &mut self,
        connection: &mut Connection,
        _: &Scenario,
        parameters: BTreeMap<String, ParameterValue>,
    ) -> Result<(), RequestError> {
        let request = ResetRequest::<Empty> { index: 0, seed: 0, parameters, cell: None };
        connection.begin::<IgnoredAny>(request).map(drop)
    }
}

/// An action as the server takes it: the action space, and one number for each of its dimensions.
fn encode_action(hello: &Hello, action: &Action) -> Result<(ActionSpace, Vec<f64>), Fault> {
    let bad = |detail: String| Fault::new(FaultKind::BadAction, detail);
    let (space, mut numbers) = match &action.arm {
        ArmCommand::JointPositions(joints) => {
            if joints.len() != hello.joints.len() || joints.iter().any(|q| !q.is_finite()) {
                let expected = hello.joints.len();
                return Err(bad(format!("expected {expected} finite joint positions, got {joints:?}")));
            }
            (ActionSpace::JointPosition, joints.clone())
        }
        ArmCommand::ToolDelta { translation_m, rotation_rad } => {
            let scale = hello.tool_delta.ok_or_else(|| bad("this simulator takes no tool deltas".to_owned()))?;
            let translation = translation_m.map(|x| x / scale.translation_m);
            let rotation = rotation_rad.map(|x| x / scale.rotation_rad);
            let numbers: Vec<f64> = translation.into_iter().chain(rotation).collect();
            // The server would clip it, and the action that was run would not be that of the policy.
            if numbers.iter().any(|x| !x.is_finite() || x.abs() > 1.0 + 1e-9) {
                return Err(bad(format!(
                    "the tool delta {translation_m:?} m, {rotation_rad:?} rad is out of range: this simulator takes \
                     up to {} m and {} rad per control period",
                    scale.translation_m, scale.rotation_rad
                )));
            }
            (ActionSpace::ToolDelta, numbers)
        }
    };
    if !hello.action_spaces.contains(&space) {
        return Err(bad("this simulator takes no joint positions".to_owned()));
    }
    numbers.push(gripper_number(action.gripper));
    Ok((space, numbers))
}

fn start(hello: &Hello, reply: ResetReply<Empty, Empty>, requested: &Assignment) -> Result<Start, RequestError> {
    let observation = reply.observation.checked(hello.joints.len(), 0.0).map_err(violation)?;
    let (Some(task), Some(applied)) = (reply.task, reply.applied) else {
        return Err(violation("the reply to reset has no `task` or no `applied`"));
    };
    if (task.control_period_s, task.time_limit_s) != (hello.control_period_s, hello.time_limit_s) {
        return Err(violation("the control period or time limit of the task differs from that in hello"));
    }
    check_pose("task.object_pose", &task.object_pose).map_err(violation)?;
    check_pose("task.target_pose", &task.target_pose).map_err(violation)?;
    Ok(Start { task, observation, applied: from_wire(&applied, requested) })
}

fn step(period: Period<Empty>, observation: Observation) -> Result<Step, RequestError> {
    let Some(measures) = period.measures else { return Err(violation("the step has no `measures`")) };
    let ending = period.ending.map(Ending::from);
    if let Some(ending) = &ending
        && !(0.0..=observation.time_s + 1e-6).contains(&ending.time_s)
    {
        let (end_s, now_s) = (ending.time_s, observation.time_s);
        return Err(violation(format!("the episode ended at {end_s} s, but the simulated time is {now_s} s")));
    }
    Ok(Step { observation, measures, ending, events: period.events.unwrap_or_default(), state_hash: period.state_hash })
}
