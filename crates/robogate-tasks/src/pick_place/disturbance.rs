//! The disturbance: a body that crosses the workspace independently of the robot.

use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};
use robogate_physics::{Fixture, FixtureKind, Motion, Part, Primitive};

/// Half extents of the body, in metres: a box of 6 cm x 6 cm, 8 cm high.
const HALF: [f64; 3] = [0.03, 0.03, 0.04];

/// Gap between its lower side and the table, in metres, so that it moves without contact.
const FLOAT: f64 = 1e-3;

/// A box that crosses the table in a straight line, from the parameters `disturbance_...`. It moves like the pusher of
/// a conveyor: nothing stops it, and it pushes objects in its path.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Disturbance {
    /// Speed in m/s. At 0 there is no box.
    pub speed_m_s: f64,
    /// Start of its motion, in seconds.
    pub start_s: f64,
    /// Position of its centre (x, y) before it moves, in metres.
    pub from: [f64; 2],
    /// Direction of its motion and yaw, in radians: 0 along +x, positive towards +y.
    pub heading_rad: f64,
    /// Length of its path, in metres.
    pub travel_m: f64,
}

impl Disturbance {
    /// The moving body. `None` if the speed is 0.
    pub(crate) fn fixture(&self) -> Option<Fixture> {
        if self.speed_m_s <= 0.0 {
            return None;
        }
        let (sin, cos) = self.heading_rad.sin_cos();
        let velocity = Vector3::new(cos, sin, 0.0) * self.speed_m_s;
        let ends_s = self.start_s + self.travel_m / self.speed_m_s;
        let at = Translation3::new(self.from[0], self.from[1], HALF[2] + FLOAT);
        let rotation = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), self.heading_rad);
        Some(Fixture {
            name: "disturbance".to_owned(),
            kind: FixtureKind::Disturbance,
            part: Part { primitive: Primitive::Box { half: HALF }, pose: Isometry3::from_parts(at, rotation) },
            motion: Some(Motion::Straight { velocity, starts_s: self.start_s, ends_s }),
            friction: None,
            color: None,
        })
    }

    /// The disturbance as read from an engine. `body` is the pose and motion of the engine's moving body.
    pub(crate) fn read(self, body: Option<(&Isometry3<f64>, &Motion)>) -> Self {
        // Without a body the other values have no effect.
        let Some((pose, Motion::Straight { velocity, starts_s, ends_s })) = body else {
            return Self { speed_m_s: 0.0, ..self };
        };
        let speed_m_s = velocity.norm();
        Self {
            speed_m_s,
            start_s: *starts_s,
            from: [pose.translation.x, pose.translation.y],
            heading_rad: velocity.y.atan2(velocity.x),
            travel_m: speed_m_s * (ends_s - starts_s),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parameters_are_read_from_the_body() {
        let asked = Disturbance { speed_m_s: 0.3, start_s: 0.7, from: [0.62, -0.4], heading_rad: 2.1, travel_m: 0.9 };
        let body = asked.fixture().unwrap();
        let read = asked.read(Some((&body.part.pose, &body.motion.unwrap())));
        let numbers = |d: Disturbance| [d.speed_m_s, d.start_s, d.from[0], d.from[1], d.heading_rad, d.travel_m];
        for (asked, read) in numbers(asked).into_iter().zip(numbers(read)) {
            assert!((asked - read).abs() < 1e-12, "{asked} became {read}");
        }
        assert_eq!(Disturbance { speed_m_s: 0.0, ..asked }.fixture(), None);
    }
}
