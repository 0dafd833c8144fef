//! Prescribed motion of a fixture.

use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

use crate::plain;

/// A straight path at constant speed within a time window. Before and after it the body does not move.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Motion {
    /// Velocity in the base frame, in m/s.
    #[serde(rename = "velocity_m_s", with = "plain")]
    pub velocity: Vector3<f64>,
    /// Start of the motion, in seconds of simulated time.
    pub starts_s: f64,
    /// End of the motion, in seconds of simulated time.
    pub ends_s: f64,
}

impl Motion {
    /// Displacement from the start at `time_s`, in metres.
    pub fn offset(&self, time_s: f64) -> Vector3<f64> {
        self.velocity * (time_s.clamp(self.starts_s, self.ends_s.max(self.starts_s)) - self.starts_s)
    }

    /// Velocity at `time_s`, in m/s.
    pub fn velocity_at(&self, time_s: f64) -> Vector3<f64> {
        if (self.starts_s..self.ends_s).contains(&time_s) { self.velocity } else { Vector3::zeros() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn motion_is_limited_to_its_window() {
        let motion = Motion { velocity: Vector3::new(0.0, 0.2, 0.0), starts_s: 1.0, ends_s: 3.0 };
        for (time, path) in [(0.0, 0.0), (1.0, 0.0), (1.5, 0.1), (3.0, 0.4), (15.0, 0.4)] {
            assert!((motion.offset(time) - Vector3::new(0.0, path, 0.0)).norm() < 1e-12, "{time}");
        }
    }
}
