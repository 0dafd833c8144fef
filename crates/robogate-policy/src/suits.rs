//! Checks whether a task provides what a profile requires.

use robogate_core::TaskSpec;

use super::profile::{Arm, Profile};

/// Check that the task provides what the profile requires. The error names what is missing.
pub(crate) fn check(profile: &Profile, task: &TaskSpec) -> Result<(), String> {
    check_observation(profile, task)?;
    check_action(profile, task)
}

fn check_observation(profile: &Profile, task: &TaskSpec) -> Result<(), String> {
    let (name, observed) = (&profile.name, &task.observation);
    for camera in &profile.cameras {
        if !observed.cameras.iter().any(|known| known.name == camera.from) {
            let known = list(observed.cameras.iter().map(|camera| camera.name.as_str()));
            return Err(format!("profile `{name}` uses the camera `{}`; the task has {known}", camera.from));
        }
    }
    let parts = profile.states.iter().flat_map(|state| &state.parts).filter_map(|part| part.vector());
    let joints = (profile.action.arm == Arm::JointDeltas).then_some(robogate_core::vectors::JOINT_POSITIONS);
    let named = profile.states.iter().flat_map(|state| state.vectors.iter().copied());
    for vector in parts.chain(named).chain(joints) {
        if !observed.vectors.iter().any(|known| known.name == vector) {
            let known = list(observed.vectors.iter().map(|vector| vector.name.as_str()));
            return Err(format!("profile `{name}` uses the vector `{vector}`; the task observes {known}"));
        }
    }
    Ok(())
}

fn check_action(profile: &Profile, task: &TaskSpec) -> Result<(), String> {
    let (name, form, spec) = (&profile.name, &profile.action, &task.action);
    let (kind, numbers) = match form.arm {
        Arm::ToolDelta => ("tool_delta", spec.tool_delta().map(|_| 7)),
        Arm::JointPositions | Arm::JointDeltas => ("joint_position", spec.joints().map(|joints| joints.len() + 1)),
        Arm::Vector => ("vector", spec.vector().map(|(low, _)| low.len())),
    };
    match numbers {
        None => return Err(format!("profile `{name}` commands {kind}; the task takes {}", spec.kinds())),
        Some(expected) if expected != form.size => {
            let size = form.size;
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
