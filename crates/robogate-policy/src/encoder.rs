//! Encodes the actions of an expert as a model would send them: the inverse of [`Decoder`].

use robogate_core::{Action, Command, Observation, Pose, TaskSpec};

use super::decoder::{Decoder, ROBOSUITE_UNIT};
use super::error::PolicyError;
use super::profile::{Arm, Frame, Part, Profile, Rotation, Side};
use super::{query, rotation};

/// Writes actions with the conventions of a profile. It keeps the state that a model would know: how far the arm lags
/// behind, and which pose was commanded last.
#[derive(Debug, Clone)]
pub struct Encoder {
    profile: Profile,
    decoder: Decoder,
}

impl Encoder {
    /// An encoder with the conventions of this profile.
    pub fn new(profile: &Profile) -> Self {
        Self { profile: profile.clone(), decoder: Decoder::new(profile) }
    }

    /// Begins an episode of this task.
    ///
    /// # Errors
    /// If the control rate of the profile does not fit the task.
    pub fn begin(&mut self, task: &TaskSpec) -> Result<(), PolicyError> {
        self.decoder.begin(task)
    }

    /// The numbers for an action that the robot should run in each control period until the next action. Motions beyond
    /// the limits of the convention are clipped to them.
    ///
    /// # Errors
    /// If the convention cannot express the action.
    pub fn encode(&mut self, action: &Action, observation: &Observation) -> Result<Vec<f64>, PolicyError> {
        let mut raw = self.arm(action, observation)?;
        if self.decoder.form.arm != Arm::Vector {
            raw.push(self.gripper(action)?);
        }
        raw.resize(self.decoder.form.size, 0.0);
        // The state of the decoder follows.
        self.decoder.put(raw.clone());
        while !self.decoder.is_empty() {
            self.decoder.next(observation)?;
        }
        Ok(raw)
    }

    fn arm(&self, action: &Action, observation: &Observation) -> Result<Vec<f64>, PolicyError> {
        let form = &self.decoder.form;
        let periods = f64::from(self.decoder.periods);
        match (form.arm, &action.command) {
            (Arm::Vector, Command::Vector(numbers)) => Ok(numbers.clone()),
            (Arm::ToolDelta, Command::ToolDelta { translation_m, rotation_rad }) => {
                self.motion(translation_m.map(|n| n * periods), rotation_rad.map(|n| n * periods), observation)
            }
            (Arm::OscPose, Command::ToolDelta { translation_m, rotation_rad }) => {
                let (translation, rotation) =
                    self.decoder.osc.goal_for(*translation_m, *rotation_rad, self.decoder.period_s);
                self.motion(translation, rotation, observation)
            }
            // An environment with this controller: the numbers are its own.
            (Arm::OscPose, Command::Vector(numbers)) => {
                let [x, y, z, a, b, c, _] = **numbers else {
                    return Err(self.cannot(&format!("a vector of {} numbers", numbers.len())));
                };
                let (metres, radians) = ROBOSUITE_UNIT;
                self.motion([x, y, z].map(|n| n * metres), [a, b, c].map(|n| n * radians), observation)
            }
            (Arm::ToolPose, Command::ToolDelta { translation_m, rotation_rad }) => {
                let from = self.decoder.start(observation)?;
                let mut position = from.position;
                position.iter_mut().zip(translation_m).for_each(|(p, n)| *p += n * periods);
                let turn = rotation::from_axis_angle(rotation_rad.map(|n| n * periods));
                let pose = Pose { position, orientation: rotation::product(turn, from.orientation) };
                let pose = rotation::model_pose(&pose, self.decoder.tool.shift_m, self.decoder.tool.turn_rad);
                let scale = form.position_scale_m;
                let numbers = pose.position.map(|n| n / scale).into_iter();
                Ok(numbers.chain(rotation::write(form.rotation, pose.orientation)).collect())
            }
            (Arm::JointPositions, Command::JointPosition(joints)) => {
                let unit = self.decoder.tool.joint_unit_rad.unwrap_or(1.0);
                Ok(joints.iter().map(|q| q / unit).collect())
            }
            (Arm::JointDeltas, Command::JointPosition(joints)) => {
                let measured = observation.joint_positions();
                let per_unit = form.rotation_scale_rad / periods;
                Ok(joints.iter().zip(measured).map(|(q, now)| self.clipped((q - now) / per_unit)).collect())
            }
            (_, command) => Err(self.cannot(&format!("{command:?}"))),
        }
    }

    /// The numbers for a motion in the base frame.
    fn motion(
        &self,
        translation_m: [f64; 3],
        rotation_rad: [f64; 3],
        observation: &Observation,
    ) -> Result<Vec<f64>, PolicyError> {
        let form = &self.decoder.form;
        let (mut translation_m, mut rotation_rad) = (translation_m, rotation_rad);
        if form.frame == Frame::Tool {
            let back = rotation::inverse(self.decoder.frame(observation)?);
            translation_m = rotation::rotate(back, translation_m);
            rotation_rad = rotation::rotate(back, rotation_rad);
        }
        let rotation = match form.rotation {
            Rotation::AxisAngle => rotation_rad.to_vec(),
            kind => rotation::write(kind, rotation::from_axis_angle(rotation_rad)),
        };
        let scaled = |n: f64, scale: f64| self.clipped(n / scale);
        let position = translation_m.map(|n| scaled(n, form.position_scale_m));
        let rotation = rotation.into_iter().map(|n| match form.rotation.is_scaled() {
            true => scaled(n, form.rotation_scale_rad),
            false => n,
        });
        Ok(position.into_iter().chain(rotation).collect())
    }

    fn clipped(&self, n: f64) -> f64 {
        self.decoder.form.clip.map_or(n, |limit| n.clamp(-limit, limit))
    }

    fn gripper(&self, action: &Action) -> Result<f64, PolicyError> {
        let form = &self.decoder.form;
        let (Some(threshold), Some(side)) = (form.gripper_threshold, form.gripper_open) else {
            return Err(self.cannot("a gripper command"));
        };
        let command = match (&action.command, action.gripper) {
            (Command::Vector(numbers), None) => numbers.last().copied(),
            (_, command) => command,
        };
        let open = command.is_some_and(|n| n < 0.0);
        // 0 and 1, or -1 and 1: as far from the threshold as the models that are known.
        let reach = if threshold > 0.0 { threshold.min(1.0) } else { 1.0 };
        Ok(if open == (side == Side::Above) { threshold + reach } else { threshold - reach })
    }

    fn cannot(&self, what: &str) -> PolicyError {
        let arm = self.decoder.form.arm;
        PolicyError::Shape(format!("the profile {} ({arm:?}) cannot express {what}", self.profile.name))
    }
}

/// The numbers of all states of the profile, in order.
///
/// # Errors
/// If the observation lacks a vector that the profile requires.
pub fn state_numbers(profile: &Profile, observation: &Observation) -> Result<Vec<f64>, PolicyError> {
    query::numbers(profile, observation).map(|states| states.concat())
}

/// How many numbers each state of the profile has.
///
/// # Errors
/// If the observation lacks a vector that the profile requires.
pub fn state_sizes(profile: &Profile, observation: &Observation) -> Result<Vec<usize>, PolicyError> {
    query::numbers(profile, observation).map(|states| states.iter().map(Vec::len).collect())
}

/// The numbers of the states that are outside of the range of the checkpoint's training data (`state.low` and
/// `state.high`), as one sentence each.
///
/// # Errors
/// If the observation lacks a vector that the profile requires.
pub fn outside_range(profile: &Profile, observation: &Observation) -> Result<Vec<String>, PolicyError> {
    let states = query::numbers(profile, observation)?;
    let mut found = Vec::new();
    for (state, numbers) in profile.states.iter().zip(states) {
        let ranges = state.low.iter().zip(&state.high);
        for (at, (number, (low, high))) in numbers.iter().zip(ranges).enumerate() {
            if !(*low..=*high).contains(number) {
                found.push(format!(
                    "number {at} of the state `{}` is {number:.4}, outside of the published range of the checkpoint, {low:.4} to \
                     {high:.4}",
                    state.key
                ));
            }
        }
    }
    Ok(found)
}

/// The pose of the tool in the base frame of the cell that a model reads in the numbers of the states, with the
/// conventions of `profile`. `None` if the states do not contain a whole pose.
pub fn read_pose(profile: &Profile, numbers: &[f64], joints: usize) -> Option<Pose> {
    let mut position = [None; 3];
    let mut angles = [None; 3];
    let mut orientation = None;
    let mut at = 0;
    for part in profile.states.iter().flat_map(|state| &state.parts) {
        let size = part.size(joints);
        let here = numbers.get(at..at + size)?;
        at += size;
        let form = |form| rotation::read(form, here);
        match part {
            Part::ToolPosition => position.iter_mut().zip(here).for_each(|(p, n)| *p = Some(*n)),
            Part::ToolX => position[0] = Some(here[0]),
            Part::ToolY => position[1] = Some(here[0]),
            Part::ToolZ => position[2] = Some(here[0]),
            Part::ToolAxisAngle => orientation = form(Rotation::AxisAngle),
            Part::ToolEuler => orientation = form(Rotation::Euler),
            Part::ToolQuaternionXyzw => orientation = form(Rotation::QuaternionXyzw),
            Part::ToolQuaternionWxyz => orientation = form(Rotation::QuaternionWxyz),
            Part::ToolRot6dColumns => orientation = form(Rotation::Rot6dColumns),
            Part::ToolRot6dInterleaved => orientation = form(Rotation::Rot6dInterleaved),
            Part::ToolRot6dRows => orientation = form(Rotation::Rot6dRows),
            Part::ToolAxisAngleX | Part::ToolRoll => angles[0] = Some((*part, here[0])),
            Part::ToolAxisAngleY | Part::ToolPitch => angles[1] = Some((*part, here[0])),
            Part::ToolAxisAngleZ | Part::ToolYaw => angles[2] = Some((*part, here[0])),
            _ => {}
        }
    }
    if let [Some((Part::ToolAxisAngleX, x)), Some((_, y)), Some((_, z))] = angles {
        orientation = Some(rotation::from_axis_angle([x, y, z]));
    } else if let [Some((_, x)), Some((_, y)), Some((_, z))] = angles {
        orientation = Some(rotation::from_euler([x, y, z]));
    }
    let [Some(x), Some(y), Some(z)] = position else { return None };
    let pose = Pose { position: [x, y, z], orientation: orientation? };
    Some(rotation::cell_pose(&pose, profile.tool.shift_m, profile.tool.turn_rad))
}
