//! Why the first episode failed, as far as a look at its actions and one more episode show it.

use std::sync::Arc;

use robogate_campaign::{Worker, WorkerFactory};
use robogate_core::{
    Action, ActionSpec, Command, Episode, Fault, FaultKind, Outcome, Scenario, TaskSpec, rollout, rollout_with,
};
use robogate_gate::CLIPPED_ACTIONS;
use robogate_stats::format::{number, percent};

use crate::pictures::picture_problems;
use crate::subject::Subject;

/// Share of the control periods in which all actions are at a bound, above which the scale is probably wrong.
const AT_BOUNDS: f64 = 0.9;
/// Share of the control periods in which the gripper changes between opening and closing, above which it is never at rest.
const RESTLESS: f64 = 0.25;

/// Runs an episode and says why it failed: one sentence for each finding, with what to do. Empty if it succeeds. `longer` is the same
/// subject with more time, if its environment can be told so.
///
/// # Errors
/// An environment or a policy that does not start.
pub fn diagnosis(subject: &Subject, longer: Option<&Subject>, scenario: &Scenario) -> Result<Vec<String>, Fault> {
    let Worker { mut environment, mut policy } = subject.worker()?;
    let mut trace = Vec::new();
    let episode = rollout_with(&mut *environment, &mut *policy, scenario, &mut |tick| trace.push(tick.action.clone()));
    let mode = match &episode.outcome {
        Outcome::Success => return Ok(Vec::new()),
        Outcome::Invalid(fault) => return Ok(vec![of_fault(fault)]),
        Outcome::Failure(mode) => mode,
    };
    let task = Arc::clone(environment.task());
    let mut found = of_actions(&trace, &episode, &task);
    if subject.policy_source().and_then(|policy| policy.profile()).is_some_and(|profile| !profile.cameras.is_empty()) {
        found.extend(picture_problems(&mut *environment, scenario)?);
    }
    found.extend(subject.missing_instruction());
    if mode.as_str() == "timeout" {
        let limit = number(task.time_limit_s);
        let again = longer.map(|longer| -> Result<Episode, Fault> {
            let Worker { mut environment, mut policy } = longer.worker()?;
            Ok(rollout(&mut *environment, &mut *policy, scenario))
        });
        match again.transpose()? {
            Some(Episode { outcome: Outcome::Success, time_s, .. }) => found.push(format!(
                "The time limit is too short: the same episode succeeds after {} s, and the limit is {limit} s. Set a longer limit in \
                 the task (`--set time_limit_s=...` in built-in tasks), or make the policy faster",
                number(time_s)
            )),
            Some(_) => {}
            None => found.push(format!(
                "The episode ended at its time limit of {limit} s. Raise `time_limit_s` in the Task of the environment to see whether \
                 the policy only needs longer"
            )),
        }
    }
    if found.is_empty() {
        found.push(format!(
            "The episode ended with {mode} after {} control periods, and its actions look plausible",
            episode.ticks
        ));
    }
    Ok(found)
}

/// What a fault means for the first episode.
fn of_fault(fault: &Fault) -> String {
    let hint = match fault.kind {
        FaultKind::BadAction => ". Check the units, the order and the normalisation of the policy's actions",
        FaultKind::Setup => ". Check what the environment offers with `robogate env inspect`",
        _ => "",
    };
    format!("No result, because of a fault ({}): {}{hint}", fault.kind, fault.detail)
}

/// What the actions of a failed episode show.
fn of_actions(trace: &[Action], episode: &Episode, task: &TaskSpec) -> Vec<String> {
    let mut found = Vec::new();
    let periods = trace.len().max(1) as f64;
    let share = |count: usize| count as f64 / periods;
    let clipped = episode.measures.get(CLIPPED_ACTIONS).unwrap_or(0.0);
    let at_bounds = share(trace.iter().filter(|action| is_at_bounds(action, &task.action)).count());
    if clipped > 0.5 {
        found.push(format!(
            "Actions out of range: {} of them were outside of their range and were clipped. Check the units and the normalisation of \
             the policy's actions",
            percent(clipped)
        ));
    } else if at_bounds > AT_BOUNDS {
        found.push(format!(
            "Actions out of range: in {} of the control periods every number of the action is at a bound. Check the scale of the \
             actions: the network may return other units than the environment takes",
            percent(at_bounds)
        ));
    } else if trace.len() > 1 && trace.windows(2).all(|pair| pair[0].command == pair[1].command) {
        found.push(format!(
            "The policy returns the same action in all {} control periods. Check that it gets the observation that it was trained on",
            trace.len()
        ));
    }
    let grip: Vec<bool> = trace.iter().filter_map(|action| closes(action, &task.action)).collect();
    let changes = grip.windows(2).filter(|pair| pair[0] != pair[1]).count();
    if share(changes) > RESTLESS {
        found.push(format!(
            "The gripper is never at rest: it changes between opening and closing {changes} times in {} control periods. Check the \
             gripper's threshold and scale",
            trace.len()
        ));
    }
    found
}

/// The bounds of a vector of numbers, if the action is one.
fn bounds<'a>(action: &'a Action, spec: &'a ActionSpec) -> Option<impl Iterator<Item = (f64, f64, f64)> + 'a> {
    let (Command::Vector(numbers), Some((low, high))) = (&action.command, spec.vector()) else { return None };
    Some(numbers.iter().zip(low.iter().zip(high)).map(|(number, (low, high))| (*number, *low, *high)))
}

fn is_at_bounds(action: &Action, spec: &ActionSpec) -> bool {
    bounds(action, spec).is_some_and(|mut numbers| numbers.all(|(number, low, high)| number <= low || number >= high))
}

/// Whether the action closes the gripper: its own command, or the number of a vector whose name says so.
fn closes(action: &Action, spec: &ActionSpec) -> Option<bool> {
    if let Some(gripper) = action.gripper {
        return Some(gripper > 0.0);
    }
    let at = spec.vector_names()?.iter().position(|name| name.contains("grip") || name.contains("finger"))?;
    let (number, low, high) = bounds(action, spec)?.nth(at)?;
    Some(number > 0.5 * (low + high))
}

#[cfg(test)]
mod tests {
    use robogate_core::{ActionSpace, FailureMode};

    use super::*;

    fn found(numbers: impl Fn(usize) -> [f64; 2]) -> String {
        let names = ["x".to_owned(), "gripper".to_owned()].to_vec();
        let space = ActionSpace::Vector { names, low: vec![-1.0, -1.0], high: vec![1.0, 1.0] };
        let mut task = (*crate::registry::task("pendulum").unwrap().task()).clone();
        task.action = ActionSpec { spaces: vec![space], gripper: None };
        let action = |at| Action { command: Command::Vector(numbers(at).to_vec()), gripper: None, phase: None };
        let trace: Vec<Action> = (0..100).map(action).collect();
        let scenario = crate::cell::nominal();
        let mut rollout = robogate_core::Rollout::begin(Arc::new(task.clone()), scenario);
        rollout.started(Err(Fault::new(FaultKind::Setup, "not run")));
        let episode = Episode { outcome: Outcome::Failure(FailureMode::TIMEOUT), ..rollout.finish() };
        of_actions(&trace, &episode, &task).join("\n")
    }

    /// The scripted controller of the cell needs about 4 s.
    #[cfg(feature = "mujoco")]
    #[test]
    fn a_short_time_limit_is_found_by_a_longer_episode() {
        let with = |limit: f64| {
            let set = vec![format!("time_limit_s={limit}")];
            let environment = crate::EnvironmentChoice { set, ..crate::EnvironmentChoice::default() };
            Subject::of(&environment, &crate::PolicyChoice::default()).unwrap()
        };
        let of = |limit: f64| diagnosis(&with(limit), Some(&with(15.0)), &crate::cell::nominal()).unwrap().join("\n");
        assert!(of(2.0).contains("The time limit is too short: the same episode succeeds after"), "{}", of(2.0));
        assert_eq!(of(15.0), "");
    }

    #[test]
    fn actions_show_what_is_wrong() {
        let wave = |at: usize| (0.1 * at as f64).sin() * 0.5;
        assert_eq!(found(|at| [wave(at), -0.9]), "");
        assert!(found(|_| [1.0, -1.0]).contains("every number of the action is at a bound"));
        assert!(found(|_| [0.3, 0.2]).contains("the same action in all 100 control periods"));
        let restless = found(|at| [wave(at), if at % 2 == 0 { 0.9 } else { -0.9 }]);
        assert!(restless.contains("never at rest: it changes between opening and closing 99 times"), "{restless}");
    }
}
