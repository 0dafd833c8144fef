//! Size, direction and effect of the actions of a policy in the cell.

use robogate_core::{Action, Environment, Observation};
use robogate_policy::{Arm, Chunk, Decoder, Profile, Side};

use super::Findings;
use crate::exit::{Exit, OrExit};
use robogate_session::{nominal, policy_error};

/// Check the actions for the first observation. In the cell the gripper is open and far above the object.
pub(super) fn check_actions(
    profile: &Profile,
    chunk: &Chunk,
    observation: &Observation,
    cell: bool,
    found: &mut Findings,
) {
    let form = &profile.action;
    // The numbers of a vector are all for the arm.
    let whole = form.arm == Arm::Vector;
    let arms =
        || chunk.rows().iter().filter_map(move |row| if whole { Some((&0.0, &**row)) } else { row.split_last() });
    let largest = arms().flat_map(|(_, arm)| arm).fold(0.0_f64, |largest, n| largest.max(n.abs()));
    found.properties.push(("largest arm value", format!("{largest:.4}")));
    if form.arm != Arm::JointPositions {
        if largest == 0.0 {
            found.problems.push("all numbers for the arm are zero, so it would never move".to_owned());
        } else if largest * form.position_scale_m < 1e-4 && matches!(form.arm, Arm::ToolDelta | Arm::OscPose) {
            found.problems.push(format!(
                "the largest number for the arm is {largest:.4}. With action.position_scale_m = {} the tool moves less than \
                 0.1 mm per step. If the model answers in metres, set the scale to 1",
                form.position_scale_m
            ));
        } else if form.clip.is_some_and(|clip| largest > 10.0 * clip) {
            found.problems.push(format!(
                "the largest number for the arm is {largest:.1}, more than ten times action.clip. Check the scale of the actions"
            ));
        }
    }
    let grippers: Vec<f64> = arms().map(|(gripper, _)| *gripper).collect();
    let low = grippers.iter().copied().fold(f64::INFINITY, f64::min);
    let high = grippers.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let Some(threshold) = form.gripper_threshold else { return };
    found.properties.push(("gripper values", format!("{low:.3} to {high:.3}, threshold {threshold}")));
    let first = chunk.rows().first().map(|row| {
        let mut decoder = Decoder::new(profile);
        decoder.put(row.clone());
        decoder.next(observation)
    });
    if cell && matches!(&first, Some(Ok(action)) if action.gripper == Some(Action::CLOSE)) {
        found.problems.push(format!(
            "the first action closes the gripper ({}) although it is open and far from the object. Check \
             action.gripper_open and action.gripper_threshold = {threshold}",
            grippers.first().copied().unwrap_or_default(),
        ));
    }
    if let Some(Err(error)) = first {
        found.problems.push(error.to_string());
    }
}

/// Check the effect of the profile's actions in the cell: translations along each axis, opening and closing the
/// gripper.
pub(super) fn check_motion(
    profile: &Profile,
    environment: &mut dyn Environment,
    found: &mut Findings,
) -> Result<(), Exit> {
    const TICKS: u32 = 20;
    /// Length of a step, in metres.
    const PROBE_M: f64 = 0.004;
    let form = &profile.action;
    let (Some(threshold), Some(side)) = (form.gripper_threshold, form.gripper_open) else { return Ok(()) };
    // Absolute poses need a pose to start from; the controls of a gate check them.
    if form.arm == Arm::ToolPose {
        return Ok(());
    }
    let (open, close) = match side {
        Side::Above => (threshold + 1.0, threshold - 1.0),
        Side::Below => (threshold - 1.0, threshold + 1.0),
    };
    let mut decoder = Decoder::new(profile);
    decoder.begin(environment.task()).map_err(policy_error)?;
    let mut run = |arm: &dyn Fn(&Observation) -> Vec<f64>, gripper: f64, ticks: u32| -> Result<_, Exit> {
        let before = environment.reset(&nominal()).or_broken()?.observation;
        decoder.begin(environment.task()).map_err(policy_error)?;
        let mut after = before.clone();
        for _ in 0..ticks {
            if decoder.is_empty() {
                let mut raw = arm(&before);
                raw.push(gripper);
                raw.resize(form.size, 0.0);
                decoder.put(raw);
            }
            let action = decoder.next(&after).map_err(policy_error)?;
            let step = environment.step(&action).or_broken()?;
            after = step.observation;
            // Closing the gripper on nothing ends the episode.
            if step.ending.is_some() {
                break;
            }
        }
        Ok((before, after))
    };
    if matches!(form.arm, Arm::ToolDelta | Arm::OscPose) && form.rotation.is_scaled() {
        // A step of a few millimetres, whether the model sends metres or fractions of a limit.
        let value = (PROBE_M / form.position_scale_m.abs()).min(form.clip.unwrap_or(f64::INFINITY));
        for (axis, name) in
            ["+x moves the tool by", "+y moves the tool by", "+z moves the tool by"].into_iter().enumerate()
        {
            let one = |_: &Observation| (0..6).map(|i| if i == axis { value } else { 0.0 }).collect();
            let (before, after) = run(&one, open, TICKS)?;
            let moved: Vec<f64> = position(&after).iter().zip(position(&before)).map(|(a, b)| a - b).collect();
            let mm: Vec<String> = moved.iter().map(|m| format!("{:+.1}", 1e3 * m)).collect();
            let lag = if form.arm == Arm::OscPose { " as goals, which the arm follows with a lag" } else { "" };
            found.properties.push((
                name,
                format!(
                    "{} mm in {TICKS} steps of {value:.3}: {:.1} mm each{lag}",
                    mm.join(", "),
                    1e3 * value * form.position_scale_m
                ),
            ));
            let aside = moved.iter().enumerate().filter(|(i, _)| *i != axis).map(|(_, m)| m.abs()).fold(0.0, f64::max);
            if moved[axis] <= 0.0 || aside > moved[axis] {
                found.problems.push(format!(
                    "an action along {} does not move the tool in this direction",
                    ["+x", "+y", "+z"][axis]
                ));
            }
        }
    }
    let hold = |observation: &Observation| match form.arm {
        Arm::JointPositions => {
            let unit = profile.tool.joint_unit_rad.unwrap_or(1.0);
            observation.joint_positions().iter().map(|q| q / unit).collect()
        }
        _ => vec![0.0; form.used() - 1],
    };
    let opening = Observation::gripper_opening_m;
    if let (Some(opened), Some(closed)) = (opening(&run(&hold, open, 40)?.1), opening(&run(&hold, close, 40)?.1)) {
        found.properties.push((
            "gripper opens to",
            format!("{:.1} mm with {open}, closes to {:.1} mm with {close}", 1e3 * opened, 1e3 * closed),
        ));
        if opened <= closed {
            found.problems.push("action.gripper_open of the profile does not open the gripper".to_owned());
        }
    }
    Ok(())
}

/// Position of the tool, in metres.
fn position(observation: &Observation) -> [f64; 3] {
    let robosuite = || <[f64; 3]>::try_from(observation.vector("eef_pos")?).ok();
    observation.tool_pose().map(|pose| pose.position).or_else(robosuite).unwrap_or([f64::NAN; 3])
}
