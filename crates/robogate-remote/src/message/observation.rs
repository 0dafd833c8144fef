//! Observations on the wire.

use robogate_core::{Observation, Pose};
use serde::{Deserialize, Serialize};

/// An observation without images.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ObservationMessage {
    /// Simulated time since the start of the episode, in seconds.
    pub time_s: f64,
    /// Joint positions, in radians (metres for a sliding joint).
    pub joint_positions: Vec<f64>,
    /// Joint velocities, in the same units per second.
    pub joint_velocities: Vec<f64>,
    /// Distance between the fingers, in metres; nothing for a gripper without fingers.
    pub gripper_opening_m: Option<f64>,
    /// Pose of the tool centre point in the base frame.
    pub tool_pose: Pose,
}

impl From<&Observation> for ObservationMessage {
    fn from(observation: &Observation) -> Self {
        Self {
            time_s: observation.time_s,
            joint_positions: observation.joint_positions.clone(),
            joint_velocities: observation.joint_velocities.clone(),
            gripper_opening_m: observation.gripper_opening_m,
            tool_pose: observation.tool_pose,
        }
    }
}

impl ObservationMessage {
    /// Check the number of joints and the time, and convert to an observation.
    pub(crate) fn checked(self, joints: usize, time_s: f64) -> Result<Observation, String> {
        let (positions, velocities) = (self.joint_positions.len(), self.joint_velocities.len());
        if positions != joints || velocities != joints {
            return Err(format!(
                "the observation has {positions} joint positions and {velocities} joint velocities; expected {joints} \
                 of each"
            ));
        }
        if (self.time_s - time_s).abs() > 1e-6 {
            return Err(format!("the observation has the time {} s; expected {time_s} s", self.time_s));
        }
        check_pose("tool_pose", &self.tool_pose)?;
        Ok(Observation {
            time_s,
            joint_positions: self.joint_positions,
            joint_velocities: self.joint_velocities,
            gripper_opening_m: self.gripper_opening_m,
            tool_pose: self.tool_pose,
            images: Vec::new(),
        })
    }
}

/// Check that the orientation of a pose is a unit quaternion.
pub(crate) fn check_pose(name: &str, pose: &Pose) -> Result<(), String> {
    let squared: f64 = pose.orientation.iter().map(|x| x * x).sum();
    if (squared - 1.0).abs() <= 2e-6 {
        return Ok(());
    }
    Err(format!("{name}.orientation is {:?}, which is not a unit quaternion", pose.orientation))
}
