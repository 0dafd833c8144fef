//! A joint between a body of the scene and the world: a hinge or a slide with damping, friction, spring and stops.

use nalgebra::{Isometry3, Translation3, UnitQuaternion, UnitVector3, Vector3};
use serde::{Deserialize, Serialize};

use crate::plain;

/// The joint that holds a body of the scene. Its value is 0 where the body has its pose in the scene.
///
/// Quantities of a slide are in m, N, N s/m and N/m, those of a hinge in rad, N m, N m s/rad and N m/rad.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Joint {
    /// Whether it turns or slides.
    pub kind: JointKind,
    /// Direction of the axis in the body's frame.
    #[serde(with = "plain")]
    pub axis: Vector3<f64>,
    /// A point of the axis in the body's frame, in metres. A slide ignores it.
    #[serde(with = "plain")]
    pub anchor: Vector3<f64>,
    /// Values of the two stops.
    pub range: [f64; 2],
    /// Value at the start.
    pub start: f64,
    /// Force or torque per speed against the motion.
    pub damping: f64,
    /// Force or torque of dry friction.
    pub friction: f64,
    /// Stiffness of the spring.
    pub stiffness: f64,
    /// Value at which the spring has no force.
    pub rest: f64,
}

/// The kind of a joint.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum JointKind {
    /// It turns about its axis.
    Hinge,
    /// It slides along its axis.
    Slide,
}

impl Joint {
    fn direction(&self) -> UnitVector3<f64> {
        UnitVector3::new_normalize(self.axis)
    }

    /// The motion of the body from the value 0 to this value, in the frame of the body at 0.
    pub fn motion(&self, value: f64) -> Isometry3<f64> {
        match self.kind {
            JointKind::Slide => Translation3::from(self.direction().scale(value)).into(),
            JointKind::Hinge => {
                let turn = UnitQuaternion::from_axis_angle(&self.direction(), value);
                let at = Translation3::from(self.anchor);
                at * turn * at.inverse()
            }
        }
    }

    /// Linear velocity (m/s) of the body's frame, and its angular velocity (rad/s), at this value and speed, in the frame of
    /// the body at 0.
    pub fn velocity(&self, value: f64, speed: f64) -> (Vector3<f64>, Vector3<f64>) {
        let along = self.direction().scale(speed);
        match self.kind {
            JointKind::Slide => (along, Vector3::zeros()),
            JointKind::Hinge => (along.cross(&(self.motion(value).translation.vector - self.anchor)), along),
        }
    }
}
