//! A body that crosses the workspace whatever the robot does.

use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};
use robogate_physics::{Fixture, FixtureKind, Motion, Part, Primitive};

/// Half extents of the body, in metres: a box of 6 cm x 6 cm, 8 cm high.
const HALF: [f64; 3] = [0.03, 0.03, 0.04];

/// Its lower side is this far above the table, in metres: it slides over it without touching.
const FLOAT: f64 = 1e-3;

/// The parameters `disturbance_...` of a scenario: a box that crosses the table in a straight line. Nothing stops
/// it: it is driven, like a conveyor's pusher, and pushes what is in its way.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Disturbance {
    /// `disturbance_speed_m_s`: its speed; at 0 there is none.
    pub speed_m_s: f64,
    /// `disturbance_start_s`: when it sets off.
    pub start_s: f64,
    /// `disturbance_x_m`, `disturbance_y_m`: where its centre stands until then.
    pub from: [f64; 2],
    /// `disturbance_heading_rad`: where it goes, 0 along +x and positive towards +y; it faces that way.
    pub heading_rad: f64,
    /// `disturbance_travel_m`: how far it goes.
    pub travel_m: f64,
}

impl Disturbance {
    /// The moving body, if there is one.
    pub(crate) fn fixture(&self) -> Option<Fixture> {
        if self.speed_m_s <= 0.0 {
            return None;
        }
        let (sin, cos) = self.heading_rad.sin_cos();
        let velocity = Vector3::new(cos, sin, 0.0) * self.speed_m_s;
        let ends_s = self.start_s + self.travel_m / self.speed_m_s;
        let at = Translation3::new(self.from[0], self.from[1], HALF[2] + FLOAT);
        let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), self.heading_rad);
        Some(Fixture {
            name: "disturbance".to_owned(),
            kind: FixtureKind::Disturbance,
            part: Part { primitive: Primitive::Box { half: HALF }, pose: Isometry3::from_parts(at, turn) },
            motion: Some(Motion { velocity, starts_s: self.start_s, ends_s }),
        })
    }

    /// The disturbance whose body moves so from this pose.
    fn of(pose: &Isometry3<f64>, motion: &Motion) -> Self {
        let speed_m_s = motion.velocity.norm();
        Self {
            speed_m_s,
            start_s: motion.starts_s,
            from: [pose.translation.x, pose.translation.y],
            heading_rad: motion.velocity.y.atan2(motion.velocity.x),
            travel_m: speed_m_s * (motion.ends_s - motion.starts_s),
        }
    }

    /// What an engine made of it, where its moving body stands at `pose` and has this motion.
    pub(crate) fn read(self, body: Option<(&Isometry3<f64>, &Motion)>) -> Self {
        match body {
            Some((pose, motion)) => Self::of(pose, motion),
            // Of a body that is not there the rest means nothing: it is as it was asked for.
            None => Self { speed_m_s: 0.0, ..self },
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn its_parameters_come_back_from_its_body() {
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
