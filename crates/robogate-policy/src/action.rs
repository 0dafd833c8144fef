//! Converts the output of a model to actions of the robot.

use robogate_core::{Action, Command};

use super::error::PolicyError;
use super::profile::{ActionForm, Arm, Rotation, Side};
use super::rotation;

impl ActionForm {
    /// Convert the `raw` numbers of a model to an action, for a robot with joints at `joints`.
    ///
    /// The numbers must be finite, and their count must be [`ActionForm::size`].
    pub fn action(&self, raw: &[f64], joints: &[f64]) -> Result<Action, PolicyError> {
        if self.arm == Arm::Vector {
            return Ok(Action { command: Command::Vector(raw.to_vec()), gripper: None, phase: None });
        }
        let Some((gripper, arm)) = raw.split_last() else {
            return Err(PolicyError::Shape("the action has no numbers".to_owned()));
        };
        let (Some(threshold), Some(side)) = (self.gripper_threshold, self.gripper_open) else {
            let why = "the profile lacks action.gripper_threshold or action.gripper_open";
            return Err(PolicyError::Shape(why.to_owned()));
        };
        let open = match side {
            Side::Above => *gripper > threshold,
            Side::Below => *gripper < threshold,
        };
        let gripper = Some(if open { Action::OPEN } else { Action::CLOSE });
        let clip = |n: f64| self.clip.map_or(n, |limit| n.clamp(-limit, limit));
        if self.arm != Arm::ToolDelta && arm.len() != joints.len() {
            let (got, expected) = (arm.len(), joints.len());
            return Err(PolicyError::Shape(format!("the action is for {got} joints, but the arm has {expected}")));
        }
        let command = match (self.arm, arm) {
            (Arm::ToolDelta, [x, y, z, a, b, c]) => {
                let rotation = [*a, *b, *c].map(|n| clip(n) * self.rotation_scale_rad);
                Command::ToolDelta {
                    translation_m: [*x, *y, *z].map(|n| clip(n) * self.position_scale_m),
                    rotation_rad: match self.rotation {
                        Rotation::AxisAngle => rotation,
                        Rotation::Euler => rotation::euler_to_vector(rotation),
                    },
                }
            }
            (Arm::ToolDelta, other) => {
                let got = other.len();
                return Err(PolicyError::Shape(format!("a tool delta needs 6 numbers for the arm, got {got}")));
            }
            (Arm::JointPositions | Arm::Vector, arm) => Command::JointPosition(arm.to_vec()),
            (Arm::JointDeltas, arm) => Command::JointPosition(
                joints.iter().zip(arm).map(|(q, n)| q + clip(*n) * self.rotation_scale_rad).collect(),
            ),
        };
        Ok(Action { command, gripper, phase: None })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Profile;

    #[test]
    fn actions_are_clipped_and_scaled() {
        let mut form = Profile::from_toml(Profile::built_in("pi0-libero").unwrap()).unwrap().action;
        let action = form.action(&[0.5, -3.0, 0.0, 0.0, 0.0, 1.0, 0.2], &[]).unwrap();
        let delta = Command::ToolDelta { translation_m: [0.01, -0.02, 0.0], rotation_rad: [0.0, 0.0, 0.05] };
        assert_eq!((action.command, action.gripper), (delta, Some(Action::CLOSE)));
        form.gripper_open = Some(Side::Above);
        assert_eq!(form.action(&[0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.2], &[]).unwrap().gripper, Some(Action::OPEN));
        form.arm = Arm::JointDeltas;
        let action = form.action(&[1.0, -9.0, 0.0], &[0.5, 0.5]).unwrap();
        assert_eq!(action.command, Command::JointPosition(vec![0.55, 0.45]));
        form.arm = Arm::JointPositions;
        assert_eq!(
            form.action(&[1.0, -9.0, 0.0], &[0.5, 0.5]).unwrap().command,
            Command::JointPosition(vec![1.0, -9.0])
        );
        let error = form.action(&[1.0, 0.0], &[0.5, 0.5]).unwrap_err().to_string();
        assert!(error.contains("for 1 joints, but the arm has 2"), "{error}");
    }
}
