//! Prescribed motion of a fixture.

use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};
use serde::{Deserialize, Serialize};

#[cfg(feature = "mujoco")]
use crate::JointKind;
use crate::plain;

/// The law by which a fixture moves. Nothing stops it. Vectors are in the base frame.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum Motion {
    /// A straight path at constant speed within a time window. Before and after it the body does not move.
    Straight {
        /// Velocity, in m/s.
        #[serde(rename = "velocity_m_s", with = "plain")]
        velocity: Vector3<f64>,
        /// Start of the motion, in seconds of simulated time.
        starts_s: f64,
        /// End of the motion, in seconds of simulated time.
        ends_s: f64,
    },
    /// Back and forth along a line, as a cosine of time. It starts at rest at one end.
    Shuttle {
        /// Unit vector from the start to the other end.
        #[serde(with = "plain")]
        direction: Vector3<f64>,
        /// Distance between the ends, in metres.
        distance_m: f64,
        /// Largest speed, in m/s.
        largest_speed_m_s: f64,
    },
    /// A turn at constant speed.
    Turn {
        /// Unit vector of the axis.
        #[serde(with = "plain")]
        axis: Vector3<f64>,
        /// A point of the axis, in metres.
        #[serde(with = "plain")]
        anchor: Vector3<f64>,
        /// Speed, in rad/s.
        speed_rad_s: f64,
    },
    /// A conveyor: the body stands still, and its surface moves at constant speed.
    Belt {
        /// Unit vector of the surface's motion.
        #[serde(with = "plain")]
        direction: Vector3<f64>,
        /// Speed of the surface, in m/s.
        speed_m_s: f64,
    },
}

impl Motion {
    /// How far it has moved at `time_s` along its line (m) or about its axis (rad).
    pub fn travel(&self, time_s: f64) -> f64 {
        match *self {
            Self::Straight { velocity, starts_s, ends_s } => {
                (velocity * (time_s.clamp(starts_s, ends_s.max(starts_s)) - starts_s)).norm()
            }
            Self::Shuttle { distance_m, largest_speed_m_s, .. } if distance_m > 0.0 => {
                0.5 * distance_m * (1.0 - (2.0 * largest_speed_m_s * time_s / distance_m).cos())
            }
            Self::Turn { speed_rad_s, .. } => speed_rad_s * time_s,
            Self::Shuttle { .. } | Self::Belt { .. } => 0.0,
        }
    }

    /// Speed at `time_s` along its line (m/s) or about its axis (rad/s). That of a belt is the speed of its surface.
    pub fn speed(&self, time_s: f64) -> f64 {
        match *self {
            Self::Straight { velocity, starts_s, ends_s } => {
                if (starts_s..ends_s).contains(&time_s) {
                    velocity.norm()
                } else {
                    0.0
                }
            }
            Self::Shuttle { distance_m, largest_speed_m_s, .. } if distance_m > 0.0 => {
                largest_speed_m_s * (2.0 * largest_speed_m_s * time_s / distance_m).sin()
            }
            Self::Shuttle { .. } => 0.0,
            Self::Turn { speed_rad_s, .. } => speed_rad_s,
            Self::Belt { speed_m_s, .. } => speed_m_s,
        }
    }

    /// When it ends, in seconds of simulated time. Infinite for one that does not end.
    pub fn ends_s(&self) -> f64 {
        match *self {
            Self::Straight { ends_s, .. } => ends_s,
            _ => f64::INFINITY,
        }
    }

    /// The kind of its joint, with a unit vector of the axis and a point of it.
    #[cfg(feature = "mujoco")]
    pub(crate) fn joint(&self) -> (JointKind, Vector3<f64>, Vector3<f64>) {
        match *self {
            Self::Straight { velocity, .. } => (JointKind::Slide, velocity.normalize(), Vector3::zeros()),
            Self::Shuttle { direction, .. } | Self::Belt { direction, .. } => {
                (JointKind::Slide, direction, Vector3::zeros())
            }
            Self::Turn { axis, anchor, .. } => (JointKind::Hinge, axis, anchor),
        }
    }

    /// The motion in the base frame after this travel (m or rad).
    pub fn moved(&self, travel: f64) -> Isometry3<f64> {
        match *self {
            Self::Straight { velocity, .. } => Translation3::from(velocity.normalize() * travel).into(),
            Self::Shuttle { direction, .. } => Translation3::from(direction * travel).into(),
            Self::Turn { axis, anchor, .. } => {
                let at = Translation3::from(anchor);
                at * UnitQuaternion::from_scaled_axis(axis * travel) * at.inverse()
            }
            Self::Belt { .. } => Isometry3::identity(),
        }
    }

    /// The motion in the base frame from the start to `time_s`.
    pub fn at(&self, time_s: f64) -> Isometry3<f64> {
        self.moved(self.travel(time_s))
    }

    /// As [`Self::at`], of a body that rides on it without slipping.
    pub fn riding(&self, time_s: f64) -> Isometry3<f64> {
        match *self {
            Self::Belt { direction, speed_m_s } => Translation3::from(direction * (speed_m_s * time_s)).into(),
            _ => self.at(time_s),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn straight_path_is_limited_to_its_window() {
        let motion = Motion::Straight { velocity: Vector3::new(0.0, 0.2, 0.0), starts_s: 1.0, ends_s: 3.0 };
        for (time, path) in [(0.0, 0.0), (1.0, 0.0), (1.5, 0.1), (3.0, 0.4), (15.0, 0.4)] {
            assert!((motion.at(time).translation.vector - Vector3::new(0.0, path, 0.0)).norm() < 1e-12, "{time}");
        }
    }

    #[test]
    fn speed_is_the_derivative_of_travel() {
        let (direction, anchor) = (Vector3::x(), Vector3::new(0.5, 0.0, 0.0));
        for motion in [
            Motion::Straight { velocity: Vector3::new(0.0, 0.2, 0.1), starts_s: 1.0, ends_s: 3.0 },
            Motion::Shuttle { direction, distance_m: 0.3, largest_speed_m_s: 0.1 },
            Motion::Turn { axis: Vector3::z(), anchor, speed_rad_s: -0.4 },
        ] {
            for time in [0.4, 1.7, 2.9, 8.3] {
                let slope = (motion.travel(time + 1e-6) - motion.travel(time - 1e-6)) / 2e-6;
                assert!((slope - motion.speed(time)).abs() < 1e-6, "{motion:?} at {time}");
            }
        }
    }

    #[test]
    fn shuttle_returns() {
        let motion = Motion::Shuttle { direction: Vector3::y(), distance_m: 0.3, largest_speed_m_s: 0.1 };
        let period_s = std::f64::consts::PI * 0.3 / 0.1;
        assert!((motion.travel(0.5 * period_s) - 0.3).abs() < 1e-12 && motion.travel(period_s).abs() < 1e-12);
    }
}
