//! Convex primitives, and parts of a rigid body made of them.

use nalgebra::{Isometry3, Vector3};
use serde::{Deserialize, Serialize};

use crate::plain;

/// A convex primitive, centred at its own origin.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "snake_case")]
pub enum Primitive {
    /// A box by its half extents, in metres.
    Box {
        /// Half extents along x, y, z.
        half: [f64; 3],
    },
    /// An upright cylinder (axis z).
    Cylinder {
        /// Radius in metres.
        radius: f64,
        /// Half the height in metres.
        half_height: f64,
    },
    /// A ball.
    Sphere {
        /// Radius in metres.
        radius: f64,
    },
}

impl Primitive {
    /// Volume in cubic metres.
    pub fn volume(&self) -> f64 {
        use std::f64::consts::PI;
        match self {
            Self::Box { half: [x, y, z] } => 8.0 * x * y * z,
            Self::Cylinder { radius, half_height } => 2.0 * PI * radius * radius * half_height,
            Self::Sphere { radius } => 4.0 / 3.0 * PI * radius.powi(3),
        }
    }

    /// Half extents of the bounding box along the primitive's own axes, in metres.
    pub fn half_extent(&self) -> [f64; 3] {
        match *self {
            Self::Box { half } => half,
            Self::Cylinder { radius, half_height } => [radius, radius, half_height],
            Self::Sphere { radius } => [radius; 3],
        }
    }

    /// Principal moments of inertia of a homogeneous body of unit mass about its centre, in m^2.
    pub(crate) fn unit_inertia(&self) -> Vector3<f64> {
        match self {
            Self::Box { half: [x, y, z] } => Vector3::new(y * y + z * z, x * x + z * z, x * x + y * y) / 3.0,
            Self::Cylinder { radius: r, half_height: h } => {
                let across = r * r / 4.0 + h * h / 3.0;
                Vector3::new(across, across, r * r / 2.0)
            }
            Self::Sphere { radius } => Vector3::repeat(0.4 * radius * radius),
        }
    }
}

/// A primitive at its place in a rigid body.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Part {
    /// The primitive.
    pub primitive: Primitive,
    /// The pose in the body's frame.
    #[serde(with = "plain")]
    pub pose: Isometry3<f64>,
}

#[cfg(feature = "mujoco")]
impl Part {
    /// How far below its body a part is that nothing can touch, in metres. Scenes that differ in their parts have the same topology with
    /// such parts.
    pub(crate) const OUT_OF_REACH_M: f64 = 200.0;

    /// Whether it is a ball that something can touch. A ball needs rolling friction to come to rest.
    pub(crate) fn rolls(&self) -> bool {
        matches!(self.primitive, Primitive::Sphere { .. }) && self.pose.translation.z > -Self::OUT_OF_REACH_M
    }
}
