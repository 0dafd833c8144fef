//! Observations: the sensor values and images that a policy receives.

use crate::{Pose, Word};

/// An observation: the sensor values that a policy receives in one control period. They include sensor errors.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Observation {
    /// Simulated time since the start, in seconds.
    pub time_s: f64,
    /// Named vectors of numbers, as the task declares them.
    pub vectors: Vec<(Word, Vec<f64>)>,
    /// Camera images; empty unless the policy [wants them](crate::Policy::wants_images).
    pub images: Vec<Image>,
}

/// Names of vectors with the same meaning in every task.
pub mod vectors {
    use crate::Word;

    /// Measured joint positions of the arm, base to tip, in radians (metres for a sliding joint).
    pub const JOINT_POSITIONS: Word = Word::constant("joint_positions");
    /// Measured joint velocities of the arm, in rad/s (m/s for a sliding joint).
    pub const JOINT_VELOCITIES: Word = Word::constant("joint_velocities");
    /// Opening between the fingers in metres, as one number. Absent for a gripper without fingers.
    pub const GRIPPER_OPENING: Word = Word::constant("gripper_opening");
    /// Pose of the tool centre point in the base frame, at the measured joint positions: x, y, z in metres, then the
    /// unit quaternion w, x, y, z. The tool points along its z axis; fingers close along y.
    pub const TOOL_POSE: Word = Word::constant("tool_pose");
    /// Force (N) and torque (N m) of everything outside the robot on hand and fingers, about the tool centre point and along its axes: the
    /// mean over the last control period. Only tasks with a sensor at the wrist have it.
    pub const WRIST_WRENCH: Word = Word::constant("wrist_wrench");
}

impl Observation {
    /// The vector with this name.
    pub fn vector(&self, name: &str) -> Option<&[f64]> {
        self.vectors.iter().find(|(known, _)| *known == name).map(|(_, values)| &**values)
    }

    /// Measured joint positions ([`vectors::JOINT_POSITIONS`]). Empty if the task has none.
    pub fn joint_positions(&self) -> &[f64] {
        self.vector(vectors::JOINT_POSITIONS.as_str()).unwrap_or_default()
    }

    /// Measured joint velocities ([`vectors::JOINT_VELOCITIES`]). Empty if the task has none.
    pub fn joint_velocities(&self) -> &[f64] {
        self.vector(vectors::JOINT_VELOCITIES.as_str()).unwrap_or_default()
    }

    /// Opening between the fingers, in metres ([`vectors::GRIPPER_OPENING`]).
    pub fn gripper_opening_m(&self) -> Option<f64> {
        self.vector(vectors::GRIPPER_OPENING.as_str())?.first().copied()
    }

    /// Pose of the tool centre point ([`vectors::TOOL_POSE`]).
    pub fn tool_pose(&self) -> Option<Pose> {
        let values: [f64; 7] = self.vector(vectors::TOOL_POSE.as_str())?.try_into().ok()?;
        Some(Pose::from_array(values))
    }
}

/// A camera image.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Image {
    /// The camera's name.
    pub camera: String,
    /// Width in pixels.
    pub width: usize,
    /// Height in pixels.
    pub height: usize,
    /// Red, green and blue (sRGB, 8 bits each) of each pixel, row by row from the top left:
    /// `3 x width x height` bytes.
    pub rgb: Vec<u8>,
}
