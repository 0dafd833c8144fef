//! From what a policy asks of the arm to joint positions.

use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};
use robogate_core::{ArmCommand, Fault, FaultKind};

use crate::Chain;

/// The tool goes on from where it was sent to while it is within this of it, in metres; from where it is
/// otherwise: pushed against something, it shall not wind up a way that it would leap once it is free.
const LEAD_M: f64 = 0.04;
/// The same for its direction, in radians.
const LEAD_RAD: f64 = 0.2;

/// Turns arm commands into joint positions, in the frame of the encoders.
#[derive(Debug, Clone, Default)]
pub struct Steering {
    /// The joint positions last sent, in radians.
    sent: Option<Vec<f64>>,
}

impl Steering {
    /// The joint positions (rad) that `command` asks for, where the encoders read `measured`.
    ///
    /// Ways of the tool are added to the pose it was last sent to, so that what the arm lags behind is not lost; the
    /// inverse kinematics start at the joint positions last sent and, of a redundant arm, keep near `rest`. A way that
    /// leads out of reach is not gone: the arm stays where it was sent to.
    pub fn joints(
        &mut self,
        command: &ArmCommand,
        measured: &[f64],
        chain: &Chain,
        rest: &[f64],
    ) -> Result<Vec<f64>, Fault> {
        let joints = match command {
            ArmCommand::JointPositions(wanted) => {
                if wanted.len() != chain.joints.len() || wanted.iter().any(|q| !q.is_finite()) {
                    let why = format!("{} finite joint positions were due, got {wanted:?}", chain.joints.len());
                    return Err(Fault::new(FaultKind::BadAction, why));
                }
                wanted.clone()
            }
            ArmCommand::ToolDelta { translation_m, rotation_rad } => {
                if translation_m.iter().chain(rotation_rad).any(|x| !x.is_finite()) {
                    let why =
                        format!("a finite way of the tool was due, got {translation_m:?} m, {rotation_rad:?} rad");
                    return Err(Fault::new(FaultKind::BadAction, why));
                }
                let from = self.from(measured, chain);
                let start = chain.tcp_at(&from);
                let turn = UnitQuaternion::from_scaled_axis(Vector3::from(*rotation_rad));
                let goal = Isometry3::from_parts(
                    Translation3::from(start.translation.vector + Vector3::from(*translation_m)),
                    turn * start.rotation,
                );
                chain.inverse(&goal, &from, rest).unwrap_or(from)
            }
        };
        self.sent = Some(joints.clone());
        Ok(joints)
    }

    /// Where the next way of the tool starts.
    fn from(&self, measured: &[f64], chain: &Chain) -> Vec<f64> {
        let Some(sent) = &self.sent else { return measured.to_vec() };
        let off = chain.tcp_at(sent).inverse() * chain.tcp_at(measured);
        let near = off.translation.vector.norm() <= LEAD_M && off.rotation.angle() <= LEAD_RAD;
        if near { sent.clone() } else { measured.to_vec() }
    }
}
