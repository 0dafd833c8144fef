//! Small actions of a profile in an environment: what each number of the model moves.

use robogate_core::{Environment, Observation};
use robogate_policy::{Arm, BoundMap, Decoder, Frame, Profile, Side, tool_pose};
use serde::Serialize;

use crate::exit::{Exit, OrExit};
use robogate_session::{nominal, policy_error};

/// How many control periods a probe takes.
const TICKS: u32 = 10;
/// How many numbers of an action are probed at most.
const NUMBERS: usize = 16;
/// Length of a translation in a control period, in metres.
const TRANSLATION_M: f64 = 0.004;
/// Rotation in a control period, in radians.
const ROTATION_RAD: f64 = 0.02;
/// Size of a number of a vector, as a fraction of its range.
const FRACTION: f64 = 0.1;
/// Differences below this are rounding.
const NOTHING: f64 = 1e-9;

/// What one number of an action moves.
#[derive(Debug, Serialize)]
pub(crate) struct Probe {
    /// Position in the action of the model.
    pub(crate) number: usize,
    /// How much larger the number was than at rest.
    pub(crate) by: f64,
    /// The observed numbers that changed most, against the same episode at rest.
    pub(crate) moves: String,
}

/// The results of all probes.
#[derive(Debug, Default)]
pub(crate) struct Probes {
    /// One for each number.
    pub(crate) probes: Vec<Probe>,
    /// Whether the environment repeated an episode exactly. `None` if nothing was probed.
    pub(crate) repeats: Option<bool>,
    /// Descriptions of problems.
    pub(crate) problems: Vec<String>,
}

/// The end of an episode.
struct End {
    observation: Observation,
    hashes: Vec<u64>,
}

/// Runs a short episode for each number of the profile's action, and one at rest.
pub(crate) fn probe(profile: &Profile, bound: &BoundMap, environment: &mut dyn Environment) -> Result<Probes, Exit> {
    let start = environment.reset(&nominal()).or_broken()?.observation;
    let seen = bound.observation(&start).or_broken()?;
    let Some(rest) = at_rest(profile, bound, &seen) else { return Ok(Probes::default()) };
    let calm = run(profile, bound, environment, &rest)?;
    let again = run(profile, bound, environment, &rest)?;
    let mut found = Probes { repeats: Some(calm.hashes == again.hashes), ..Probes::default() };
    for number in 0..rest.len().min(NUMBERS) {
        let by = step(profile, bound, &rest, number);
        let mut raw = rest.clone();
        raw[number] += by;
        let end = run(profile, bound, environment, &raw)?;
        let changes = changes(&calm.observation, &end.observation);
        if changes.is_empty() && found.repeats == Some(true) {
            found.problems.push(format!(
                "number {number} of the action changes no observation within {TICKS} control periods: it may not be mapped"
            ));
        }
        if let Some(problem) = direction(profile, bound, number, by, &calm, &end) {
            found.problems.push(problem);
        }
        let largest: Vec<String> = changes.iter().take(3).map(|(name, by)| format!("{name} {by:+.4}")).collect();
        let moves = if largest.is_empty() { "nothing".to_owned() } else { largest.join(", ") };
        found.probes.push(Probe { number, by, moves });
    }
    Ok(found)
}

/// Runs [`TICKS`] control periods with the same action of the model.
fn run(profile: &Profile, bound: &BoundMap, environment: &mut dyn Environment, raw: &[f64]) -> Result<End, Exit> {
    let mut observation = environment.reset(&nominal()).or_broken()?.observation;
    let mut decoder = Decoder::new(profile);
    decoder.begin(bound.task()).map_err(policy_error)?;
    let mut hashes = Vec::new();
    for _ in 0..TICKS {
        if decoder.is_empty() {
            let mut numbers = raw.to_vec();
            numbers.resize(profile.action.size, 0.0);
            decoder.put(numbers);
        }
        let seen = bound.observation(&observation).or_broken()?;
        let action = bound.action(decoder.next(&seen).map_err(policy_error)?);
        let step = environment.step(&action).or_broken()?;
        observation = step.observation;
        hashes.push(step.state_hash);
        if step.ending.is_some() {
            break;
        }
    }
    Ok(End { observation, hashes })
}

/// The action of the model that commands no motion. `None` for absolute poses, and for motions whose rotations have no
/// zero.
fn at_rest(profile: &Profile, bound: &BoundMap, seen: &Observation) -> Option<Vec<f64>> {
    let form = &profile.action;
    let mut raw = match form.arm {
        Arm::Vector => {
            let (low, high) = bound.task().action.vector()?;
            return Some(low.iter().zip(high).map(|(low, high)| 0.0_f64.clamp(*low, *high)).collect());
        }
        Arm::ToolPose => return None,
        Arm::ToolDelta | Arm::OscPose if !form.rotation.is_scaled() => return None,
        Arm::ToolDelta | Arm::OscPose | Arm::JointDeltas => vec![0.0; form.used().saturating_sub(1)],
        Arm::JointPositions => {
            let unit = profile.tool.joint_unit_rad.unwrap_or(1.0);
            seen.joint_positions().iter().map(|q| q / unit).collect()
        }
    };
    let (threshold, side) = (form.gripper_threshold?, form.gripper_open?);
    raw.push(if side == Side::Above { threshold + 1.0 } else { threshold - 1.0 });
    Some(raw)
}

/// By how much a number is changed.
fn step(profile: &Profile, bound: &BoundMap, rest: &[f64], number: usize) -> f64 {
    let form = &profile.action;
    let within_clip = |n: f64| n.min(form.clip.unwrap_or(f64::INFINITY));
    if form.arm == Arm::Vector {
        let range = bound.task().action.vector().and_then(|(low, high)| Some((*low.get(number)?, *high.get(number)?)));
        let (low, high) = range.unwrap_or((-1.0, 1.0));
        let by = FRACTION * (high - low);
        return if rest[number] + by > high { -by } else { by };
    }
    if number + 1 == rest.len() {
        // From open to closed.
        return if form.gripper_open == Some(Side::Above) { -2.0 } else { 2.0 };
    }
    match form.arm {
        Arm::JointPositions => ROTATION_RAD / profile.tool.joint_unit_rad.unwrap_or(1.0),
        Arm::ToolDelta | Arm::OscPose if number < 3 => within_clip(TRANSLATION_M / form.position_scale_m.abs()),
        _ => within_clip(ROTATION_RAD / form.rotation_scale_rad.abs()),
    }
}

/// The observed numbers that differ, the largest difference first.
fn changes(calm: &Observation, moved: &Observation) -> Vec<(String, f64)> {
    let mut found = Vec::new();
    for (name, values) in &moved.vectors {
        let before = calm.vector(name.as_str()).unwrap_or_default();
        for (at, (now, was)) in values.iter().zip(before).enumerate() {
            if (now - was).abs() > NOTHING {
                found.push((format!("{name}[{at}]"), now - was));
            }
        }
    }
    found.sort_by(|(_, a), (_, b)| b.abs().total_cmp(&a.abs()));
    found
}

/// The problem of a translation that moves the observed tool in another direction.
fn direction(profile: &Profile, bound: &BoundMap, number: usize, by: f64, calm: &End, end: &End) -> Option<String> {
    let form = &profile.action;
    let translates = matches!(form.arm, Arm::ToolDelta | Arm::OscPose) && number < 3;
    if !translates || form.frame != Frame::Base {
        return None;
    }
    let place = |end: &End| tool_pose(profile, &bound.observation(&end.observation).ok()?).map(|pose| pose.position);
    let (from, to) = (place(calm)?, place(end)?);
    let sign = (by * form.position_scale_m).signum();
    let moved: Vec<f64> = to.iter().zip(from).map(|(to, from)| sign * (to - from)).collect();
    let aside = moved.iter().enumerate().filter(|(axis, _)| *axis != number).map(|(_, m)| m.abs()).fold(0.0, f64::max);
    let wrong = moved[number] <= 0.0 || aside > moved[number];
    wrong.then(|| {
        let mm: Vec<String> = moved.iter().map(|m| format!("{:+.1}", 1e3 * m)).collect();
        format!(
            "an action along {} moves the observed tool by {} mm: another direction. Check the order and the signs in the map",
            ["+x", "+y", "+z"][number],
            mm.join(", ")
        )
    })
}
