//! Rigid-body poses as plain numbers, independent of any engine.

use serde::{Deserialize, Serialize};

/// A pose in the robot's base frame: x forward, y left, z up.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Pose {
    /// Position in metres.
    pub position: [f64; 3],
    /// Unit quaternion, scalar first (w, x, y, z).
    pub orientation: [f64; 4],
}

impl Pose {
    /// The pose of the base frame: no translation, no rotation.
    pub const IDENTITY: Self = Self { position: [0.0; 3], orientation: [1.0, 0.0, 0.0, 0.0] };

    /// A pose rotated by `yaw` radians about the vertical axis.
    pub fn upright(position: [f64; 3], yaw: f64) -> Self {
        let half = 0.5 * yaw;
        Self { position, orientation: [half.cos(), 0.0, 0.0, half.sin()] }
    }
}

impl Pose {
    /// The pose as seven numbers: x, y, z in metres, then the quaternion w, x, y, z.
    pub fn to_array(&self) -> [f64; 7] {
        let ([x, y, z], [w, i, j, k]) = (self.position, self.orientation);
        [x, y, z, w, i, j, k]
    }

    /// The inverse of [`Self::to_array`].
    pub fn from_array([x, y, z, w, i, j, k]: [f64; 7]) -> Self {
        Self { position: [x, y, z], orientation: [w, i, j, k] }
    }
}
