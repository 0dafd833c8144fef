//! A joint between a body of the scene and the world: a hinge, a slide or a screw with damping, friction, spring and stops.

use nalgebra::{Isometry3, Translation3, UnitQuaternion, UnitVector3, Vector3};
use serde::{Deserialize, Serialize};

use crate::plain;

/// The joint that holds a body of the scene. Its value is 0 where the body has its pose in the scene.
///
/// Quantities of a slide are in m, N, N s/m and N/m, those of a hinge and a screw in rad, N m, N m s/rad and N m/rad.
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
    /// How far a screw moves along its axis in one turn, in metres. 0 for the others.
    #[serde(default)]
    pub pitch_m: f64,
    /// The thread of a screw, if it takes up a body that moves freely.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub thread: Option<Thread>,
}

/// The thread of a body on a screw, which takes up a free body: from then on both move as one body.
///
/// It takes the body up where a point of the body is near to the origin of the body on the screw, the axis of the screw is nearly the same in
/// both, and the free body turns in its direction. Until then it does not turn. It lets go of the body when it is turned back to its lower stop.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Thread {
    /// The body that it takes up, by its index in the scene.
    pub body: usize,
    /// The point of that body, in its frame.
    #[serde(with = "plain")]
    pub point: Vector3<f64>,
    /// Largest distance of the point from the origin, in metres.
    pub within_m: f64,
    /// Largest angle between the axes, in radians.
    pub lean_rad: f64,
}

/// The kind of a joint.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum JointKind {
    /// It turns about its axis.
    Hinge,
    /// It slides along its axis.
    Slide,
    /// It turns about its axis and moves along it by the pitch per turn.
    Screw,
}

impl Joint {
    pub(crate) fn direction(&self) -> UnitVector3<f64> {
        UnitVector3::new_normalize(self.axis)
    }

    /// How far a screw moves along its axis per angle, in m/rad. 0 for the others.
    pub fn lead_m_rad(&self) -> f64 {
        self.pitch_m / std::f64::consts::TAU
    }

    /// The motion of the body from the value 0 to this value, in the frame of the body at 0.
    pub fn motion(&self, value: f64) -> Isometry3<f64> {
        match self.kind {
            JointKind::Slide => Translation3::from(self.direction().scale(value)).into(),
            JointKind::Hinge | JointKind::Screw => {
                let turn = UnitQuaternion::from_axis_angle(&self.direction(), value);
                let at = Translation3::from(self.anchor);
                let along = Translation3::from(self.direction().scale(self.lead_m_rad() * value));
                along * at * turn * at.inverse()
            }
        }
    }

    /// Linear velocity (m/s) of the body's frame, and its angular velocity (rad/s), at this value and speed, in the frame of
    /// the body at 0.
    pub fn velocity(&self, value: f64, speed: f64) -> (Vector3<f64>, Vector3<f64>) {
        let along = self.direction().scale(speed);
        match self.kind {
            JointKind::Slide => (along, Vector3::zeros()),
            JointKind::Hinge | JointKind::Screw => {
                let lever = self.motion(value).translation.vector - self.anchor;
                (along.cross(&lever) + along * self.lead_m_rad(), along)
            }
        }
    }
}
