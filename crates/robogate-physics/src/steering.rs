//! Converts a policy's arm command to joint positions.

use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};
use robogate_core::{Command, Fault, FaultKind};

use crate::Chain;

/// A tool delta starts at the last commanded pose while the tool is within this distance of it, in metres. Beyond this
/// distance it starts at the measured pose. Otherwise the command of a tool pushed against an obstacle would run ahead,
/// and the tool would jump once it is free.
const LEAD_M: f64 = 0.04;
/// The corresponding limit for the orientation of the tool, in radians.
const LEAD_RAD: f64 = 0.2;

/// Converts arm commands to joint positions in encoder coordinates.
#[derive(Debug, Clone, Default)]
pub struct Steering {
    /// The last commanded joint positions, in radians.
    sent: Option<Vec<f64>>,
}

impl Steering {
    /// The joint positions (rad) for `command`, with the encoder readings `measured`.
    ///
    /// A tool delta is added to the last commanded pose, so the lag of the arm does not accumulate. The inverse
    /// kinematics start at the last commanded joint positions and keep a redundant arm near `rest`. If the new pose is
    /// out of reach, the command does not change.
    ///
    /// # Errors
    /// A fault of kind `BadAction` if the command has the wrong length or is not finite.
    pub fn joints(
        &mut self,
        command: &Command,
        measured: &[f64],
        chain: &Chain,
        rest: &[f64],
    ) -> Result<Vec<f64>, Fault> {
        let joints = match command {
            Command::JointPosition(wanted) => {
                if wanted.len() != chain.joints.len() || wanted.iter().any(|q| !q.is_finite()) {
                    let count = chain.joints.len();
                    let why = format!("the action has the joint positions {wanted:?}. Expected {count} finite numbers");
                    return Err(Fault::new(FaultKind::BadAction, why));
                }
                wanted.clone()
            }
            Command::ToolDelta { translation_m, rotation_rad } => {
                if translation_m.iter().chain(rotation_rad).any(|x| !x.is_finite()) {
                    let why = format!(
                        "the action moves the tool by {translation_m:?} m and {rotation_rad:?} rad. Expected finite numbers"
                    );
                    return Err(Fault::new(FaultKind::BadAction, why));
                }
                let from = self.from(measured, chain);
                let start = chain.tcp_at(&from);
                let rotation = UnitQuaternion::from_scaled_axis(Vector3::from(*rotation_rad));
                let goal = Isometry3::from_parts(
                    Translation3::from(start.translation.vector + Vector3::from(*translation_m)),
                    rotation * start.rotation,
                );
                chain.inverse(&goal, &from, rest).unwrap_or(from)
            }
            Command::Vector(_) => {
                let why = "the action is a vector. Expected joint_position or tool_delta";
                return Err(Fault::new(FaultKind::BadAction, why));
            }
        };
        self.sent = Some(joints.clone());
        Ok(joints)
    }

    /// The joint positions at which the next tool delta starts.
    fn from(&self, measured: &[f64], chain: &Chain) -> Vec<f64> {
        let Some(sent) = &self.sent else { return measured.to_vec() };
        let off = chain.tcp_at(sent).inverse() * chain.tcp_at(measured);
        let near = off.translation.vector.norm() <= LEAD_M && off.rotation.angle() <= LEAD_RAD;
        if near { sent.clone() } else { measured.to_vec() }
    }
}
