//! Checks whether a task provides what a profile requires.

use robogate_core::TaskSpec;

use super::decoder::is_robosuite;
use super::profile::{Arm, Part, Profile};

/// Check that the task provides what the profile requires.
///
/// # Errors
/// If something is missing. The message names it, and what the task has.
pub fn check_task(profile: &Profile, task: &TaskSpec) -> Result<(), String> {
    check_observation(profile, task)?;
    check_action(profile, task)
}

fn check_observation(profile: &Profile, task: &TaskSpec) -> Result<(), String> {
    let (name, observed) = (&profile.name, &task.observation);
    for camera in &profile.cameras {
        if !camera.sources().any(|name| observed.cameras.iter().any(|known| known.name == name)) {
            let known = list(observed.cameras.iter().map(|camera| camera.name.as_str()));
            return Err(format!("profile `{name}` uses the camera `{}`; the task has {known}", camera.from));
        }
    }
    let has = |name: &str| observed.vectors.iter().any(|known| known.name == name);
    let replaced = |part: &&Part| !part.robosuite().is_empty() && part.robosuite().iter().all(|name| has(name));
    let parts = profile.states.iter().flat_map(|state| &state.parts).filter(|part| !replaced(part));
    let parts = parts.filter_map(|part| part.vector());
    let joints = (profile.action.arm == Arm::JointDeltas).then_some(robogate_core::vectors::JOINT_POSITIONS);
    let named = profile.states.iter().flat_map(|state| state.vectors.iter().copied());
    for vector in parts.chain(named).chain(joints) {
        if !has(vector.as_str()) {
            let sizes: Vec<String> = observed.vectors.iter().map(|v| format!("{} ({})", v.name, v.length)).collect();
            let known = list(sizes.iter().map(String::as_str));
            return Err(format!("profile `{name}` uses the vector `{vector}`; the task observes {known}"));
        }
    }
    Ok(())
}

fn check_action(profile: &Profile, task: &TaskSpec) -> Result<(), String> {
    let (name, form, spec) = (&profile.name, &profile.action, &task.action);
    form.periods(task.control_period_s).map_err(|why| format!("profile `{name}`: {why}"))?;
    // The task has the controller that the profile describes, so it takes the numbers of the model.
    if form.arm == Arm::OscPose && is_robosuite(task) {
        return Ok(());
    }
    let (kind, numbers) = match form.arm {
        Arm::ToolDelta | Arm::OscPose | Arm::ToolPose => {
            ("tool_delta", spec.tool_delta().map(|_| 4 + form.rotation.size()))
        }
        Arm::JointPositions | Arm::JointDeltas => ("joint_position", spec.joints().map(|joints| joints.len() + 1)),
        Arm::Vector => ("vector", spec.vector().map(|(low, _)| low.len())),
    };
    match numbers {
        None => return Err(format!("profile `{name}` commands {kind}; the task takes {}", spec.kinds())),
        Some(expected) if expected != form.used() => {
            let size = form.used();
            return Err(format!(
                "profile `{name}` has actions of {size} numbers; the task takes {expected} for {kind}"
            ));
        }
        Some(_) => {}
    }
    match (form.arm == Arm::Vector, spec.gripper.is_some()) {
        (false, false) => Err(format!("profile `{name}` commands a gripper; the task has none")),
        (true, true) => Err(format!("profile `{name}` commands no gripper; the task requires a gripper command")),
        _ => Ok(()),
    }
}

fn list<'a>(names: impl Iterator<Item = &'a str>) -> String {
    let names: Vec<&str> = names.collect();
    if names.is_empty() { "none".to_owned() } else { names.join(", ") }
}
