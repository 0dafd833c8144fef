//! Compares the mapping of a profile with the published conventions of its model, and names each step that differs.
//!
//! The comparison needs no server and no simulator: the same numbers of a model, and the same pose of the arm, are read
//! with both conventions.

use robogate_core::{Action, Observation, Pose, vectors};
use serde::{Deserialize, Serialize};

use super::decoder::Decoder;
use super::encoder::{read_pose, state_numbers};
use super::profile::{Arm, Part, Profile, Side};
use super::rotation;

/// A step of the path from the observation to the motion of the robot.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum MappingStep {
    /// Orientation of the images.
    Image,
    /// Size and content of the state.
    State,
    /// Frame and offset of positions in the state.
    StateFrame,
    /// Representation of rotations in the state, for example the order of a quaternion.
    StateRotation,
    /// Number of actions per second.
    Rate,
    /// What the numbers for the arm mean.
    Arm,
    /// Sign of a motion.
    Sign,
    /// Scale of a motion.
    Scale,
    /// Frame of a motion.
    Frame,
    /// Representation of the rotation in an action.
    Rotation,
    /// Which number opens the gripper.
    Gripper,
}

impl MappingStep {
    /// The name in reports.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Image => "image orientation",
            Self::State => "state",
            Self::StateFrame => "state frame",
            Self::StateRotation => "state rotation",
            Self::Rate => "control rate",
            Self::Arm => "arm mode",
            Self::Sign => "action sign",
            Self::Scale => "action scale",
            Self::Frame => "action frame",
            Self::Rotation => "action rotation",
            Self::Gripper => "gripper sign",
        }
    }
}

/// A step that differs from the published conventions.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct MappingProblem {
    /// The step.
    pub step: MappingStep,
    /// The difference, with the field of the profile.
    pub detail: String,
}

/// Relative difference that counts as rounding.
const TOLERANCE: f64 = 1e-6;

/// The steps in which `profile` differs from `reference`. Empty if both map alike.
pub fn compare_mappings(profile: &Profile, reference: &Profile) -> Vec<MappingProblem> {
    let mut found = Vec::new();
    images(profile, reference, &mut found);
    states(profile, reference, &mut found);
    rate(profile, reference, &mut found);
    if arm(profile, reference, &mut found) {
        motions(profile, reference, &mut found);
    }
    gripper(profile, reference, &mut found);
    found.sort_by_key(|problem| problem.step);
    found
}

fn push(found: &mut Vec<MappingProblem>, step: MappingStep, detail: String) {
    found.push(MappingProblem { step, detail });
}

fn images(profile: &Profile, reference: &Profile, found: &mut Vec<MappingProblem>) {
    for camera in &profile.cameras {
        let Some(other) = reference.cameras.iter().find(|other| other.key == camera.key) else { continue };
        if camera.orientation() != other.orientation() {
            let (is, was) = (camera.orientation().as_str(), other.orientation().as_str());
            push(
                found,
                MappingStep::Image,
                format!("camera `{}` is {is}; the model was trained on {was} images", camera.key),
            );
        }
    }
}

/// An arm whose tool is tilted and rotated, so that every convention gives different numbers.
fn probe() -> Observation {
    let turn = rotation::product(rotation::from_euler([0.0, 0.0, 0.7]), [0.0, 1.0, 0.0, 0.0]);
    let tilted = rotation::product(turn, rotation::from_axis_angle([0.2, -0.1, 0.05]));
    let orientation = rotation::downwards(tilted);
    let pose = Pose { position: [0.45, 0.12, 0.31], orientation };
    Observation {
        vectors: vec![
            (vectors::JOINT_POSITIONS, (1..=7).map(|i| 0.1 * f64::from(i)).collect()),
            (vectors::JOINT_VELOCITIES, vec![0.0; 7]),
            (vectors::GRIPPER_OPENING, vec![0.05]),
            (vectors::TOOL_POSE, pose.to_array().to_vec()),
        ],
        ..Observation::default()
    }
}

fn states(profile: &Profile, reference: &Profile, found: &mut Vec<MappingProblem>) {
    let observation = probe();
    let (ours, theirs) = match (state_numbers(profile, &observation), state_numbers(reference, &observation)) {
        (Ok(ours), Ok(theirs)) => (ours, theirs),
        // The vectors of the task itself: there is no convention to compare.
        _ => return,
    };
    if ours.len() != theirs.len() {
        let (is, was) = (ours.len(), theirs.len());
        push(found, MappingStep::State, format!("the state has {is} numbers; the model was trained on {was}"));
        return;
    }
    let joints = observation.joint_positions().len();
    let (read, known) = (read_pose(reference, &ours, joints), read_pose(reference, &theirs, joints));
    if let (Some(read), Some(known)) = (read, known) {
        let off: Vec<f64> = read.position.iter().zip(known.position).map(|(a, b)| a - b).collect();
        if off.iter().any(|n| n.abs() > TOLERANCE) {
            push(
                found,
                MappingStep::StateFrame,
                format!("the model reads a position that is {off:.3?} m off (tool.shift_m)"),
            );
        }
        let turn = rotation::product(read.orientation, rotation::inverse(known.orientation));
        let angle = rotation::shortest(turn).iter().map(|n| n * n).sum::<f64>().sqrt();
        if angle > TOLERANCE {
            push(
                found,
                MappingStep::StateRotation,
                format!(
                    "the model reads an orientation that is {angle:.2} rad off (representation or order in state.parts, \
                     or tool.turn_rad)"
                ),
            );
        }
    } else if known.is_some() {
        push(found, MappingStep::StateRotation, "the model reads no valid rotation in the state".to_owned());
    }
    let rest = |numbers: &[f64]| others(reference, numbers, joints);
    let differs = rest(&ours).iter().zip(rest(&theirs)).any(|(a, b)| (a - b).abs() > TOLERANCE);
    if differs || (known.is_none() && ours.iter().zip(&theirs).any(|(a, b)| (a - b).abs() > TOLERANCE)) {
        push(found, MappingStep::State, "joints or gripper differ in state.parts".to_owned());
    }
}

/// The numbers of a state that are not part of the pose.
fn others(profile: &Profile, numbers: &[f64], joints: usize) -> Vec<f64> {
    let mut at = 0;
    let mut kept = Vec::new();
    for part in profile.states.iter().flat_map(|state| &state.parts) {
        let size = part.size(joints);
        let pose = part.vector() == Some(vectors::TOOL_POSE) || *part == Part::Zero;
        if !pose {
            kept.extend(numbers.get(at..at + size).unwrap_or_default());
        }
        at += size;
    }
    kept
}

fn rate(profile: &Profile, reference: &Profile, found: &mut Vec<MappingProblem>) {
    let hz = |profile: &Profile| {
        profile.action.control_hz.map_or_else(|| "one action per control period".to_owned(), |hz| format!("{hz} Hz"))
    };
    if hz(profile) != hz(reference) {
        let detail = format!("{}; the model was trained with {} (action.control_hz)", hz(profile), hz(reference));
        push(found, MappingStep::Rate, detail);
    }
}

/// Whether the numbers for the arm have the same kind.
fn arm(profile: &Profile, reference: &Profile, found: &mut Vec<MappingProblem>) -> bool {
    let (ours, theirs) = (&profile.action, &reference.action);
    if ours.arm != theirs.arm {
        let (is, was) = (ours.arm.as_str(), theirs.arm.as_str());
        push(found, MappingStep::Arm, format!("{is}; the model was trained with {was} (action.arm)"));
        return false;
    }
    if ours.rotation != theirs.rotation {
        let detail = format!("{:?}; the model sends {:?} (action.rotation)", ours.rotation, theirs.rotation);
        push(found, MappingStep::Rotation, detail);
        return ours.rotation.size() == theirs.rotation.size();
    }
    if ours.used() != theirs.used() {
        let detail =
            format!("{} numbers are used; the model sends {} (action.size, action.used)", ours.used(), theirs.used());
        push(found, MappingStep::Arm, detail);
        return false;
    }
    true
}

/// What a decoder does with one number of the arm at 0.1, in the base frame: six numbers, or one for each joint.
fn response(profile: &Profile, number: usize, observation: &Observation) -> Option<Vec<f64>> {
    let form = &profile.action;
    let decoder = Decoder::new(profile);
    let mut arm = vec![0.0; form.used().saturating_sub(1)];
    *arm.get_mut(number)? = 0.1;
    match form.arm {
        Arm::ToolDelta | Arm::OscPose => {
            let (mut translation, mut turn) = decoder.scaled(&arm).ok()?;
            if !form.frame.is_base() {
                let frame = decoder.frame(observation).ok()?;
                (translation, turn) = (rotation::rotate(frame, translation), rotation::rotate(frame, turn));
            }
            Some(translation.into_iter().chain(turn).collect())
        }
        Arm::JointDeltas => {
            let clip = |n: f64| form.clip.map_or(n, |limit| n.clamp(-limit, limit));
            Some(arm.into_iter().map(|n| clip(n) * form.rotation_scale_rad).collect())
        }
        Arm::ToolPose => {
            let mut position = [0.0; 3];
            position.iter_mut().zip(&arm).for_each(|(p, n)| *p = n * form.position_scale_m);
            let pose = Pose { position, orientation: [1.0, 0.0, 0.0, 0.0] };
            let pose = rotation::cell_pose(&pose, profile.tool.shift_m, profile.tool.turn_rad);
            Some(pose.position.into_iter().chain(pose.orientation).collect())
        }
        Arm::JointPositions => {
            let unit = profile.tool.joint_unit_rad.unwrap_or(1.0);
            Some(arm.into_iter().map(|n| n * unit).collect())
        }
        Arm::Vector => Some(arm),
    }
}

fn motions(profile: &Profile, reference: &Profile, found: &mut Vec<MappingProblem>) {
    let observation = probe();
    let scaled = reference.action.arm != Arm::ToolDelta && reference.action.arm != Arm::OscPose
        || reference.action.rotation.is_scaled();
    let numbers = if scaled { reference.action.used().saturating_sub(1) } else { 3 };
    for number in 0..numbers {
        let (Some(ours), Some(theirs)) =
            (response(profile, number, &observation), response(reference, number, &observation))
        else {
            continue;
        };
        let product = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
        let length = product(&theirs, &theirs);
        if length <= 0.0 || ours.len() != theirs.len() {
            continue;
        }
        let ratio = product(&ours, &theirs) / length;
        let aside: f64 = ours.iter().zip(&theirs).map(|(a, b)| (a - ratio * b).powi(2)).sum();
        let step = if aside > TOLERANCE * length {
            MappingStep::Frame
        } else if ratio < 0.0 {
            MappingStep::Sign
        } else if (ratio - 1.0).abs() > TOLERANCE {
            MappingStep::Scale
        } else {
            continue;
        };
        // One message for each step and kind of motion.
        let kind = if number < 3 { "translation" } else { "rotation" };
        if found.iter().any(|known| known.step == step && known.detail.starts_with(kind)) {
            continue;
        }
        let detail = match step {
            MappingStep::Frame => {
                format!("{kind}: number {number} moves the tool in another direction (action.frame, [tool])")
            }
            MappingStep::Sign => format!("{kind}: number {number} moves the arm in the opposite direction"),
            _ => format!("{kind}: number {number} moves the arm {ratio:.3} times as far"),
        };
        push(found, step, detail);
    }
    let (ours, theirs) = (profile.action.clip, reference.action.clip);
    if ours != theirs {
        let text = |clip: Option<f64>| clip.map_or_else(|| "not clipped".to_owned(), |n| format!("clipped to {n}"));
        let detail =
            format!("clip: numbers are {}; the model was trained with {} (action.clip)", text(ours), text(theirs));
        push(found, MappingStep::Scale, detail);
    }
}

fn gripper(profile: &Profile, reference: &Profile, found: &mut Vec<MappingProblem>) {
    let (Some(threshold), Some(side)) = (reference.action.gripper_threshold, reference.action.gripper_open) else {
        return;
    };
    let (Some(ours), Some(our_side)) = (profile.action.gripper_threshold, profile.action.gripper_open) else {
        return;
    };
    // 0 and 1, or -1 and 1.
    let reach = if threshold > 0.0 { threshold.min(1.0) } else { 1.0 };
    let (open, close) = match side {
        Side::Above => (threshold + reach, threshold - reach),
        Side::Below => (threshold - reach, threshold + reach),
    };
    let command = |number: f64| match our_side {
        Side::Above if number > ours => Action::OPEN,
        Side::Below if number < ours => Action::OPEN,
        _ => Action::CLOSE,
    };
    let right = [command(open) <= Action::OPEN, command(close) >= Action::CLOSE];
    let detail = match right {
        [true, true] => return,
        [false, false] => format!(
            "{open} closes the gripper and {close} opens it; the model means the opposite (action.gripper_open)"
        ),
        [false, true] => {
            format!("{open} closes the gripper; the model opens it with this number (action.gripper_threshold)")
        }
        [true, false] => {
            format!("{close} opens the gripper; the model closes it with this number (action.gripper_threshold)")
        }
    };
    push(found, MappingStep::Gripper, detail);
}
