//! Convex shapes, and parts of a rigid body made of them.

use std::sync::Arc;

use nalgebra::{Isometry3, Matrix3, Vector3};
use serde::{Deserialize, Serialize};

use crate::{Hull, plain};

/// A convex shape. The centre of its bounding box is its own origin.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
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
    /// A convex piece of a mesh. Messages to an engine in another process have none.
    #[serde(skip)]
    Hull(Arc<Hull>),
}

impl Primitive {
    /// Volume in cubic metres. The first piece of a mesh has that of the mesh, the others have none.
    pub fn volume(&self) -> f64 {
        use std::f64::consts::PI;
        match self {
            Self::Box { half: [x, y, z] } => 8.0 * x * y * z,
            Self::Cylinder { radius, half_height } => 2.0 * PI * radius * radius * half_height,
            Self::Sphere { radius } => 4.0 / 3.0 * PI * radius.powi(3),
            Self::Hull(hull) => hull.mesh().map_or(0.0, |mesh| mesh.bulk().volume_m3),
        }
    }

    /// Half extents of the bounding box along the primitive's own axes, in metres.
    pub fn half_extent(&self) -> [f64; 3] {
        match self {
            Self::Box { half } => *half,
            Self::Cylinder { radius, half_height } => [*radius, *radius, *half_height],
            Self::Sphere { radius } => [*radius; 3],
            Self::Hull(hull) => hull.half(),
        }
    }

    /// How far it reaches from its origin against and along a unit vector, in metres: of a piece of a mesh itself, of others their
    /// bounding box.
    pub fn extent(&self, along: &Vector3<f64>) -> [f64; 2] {
        match self {
            Self::Hull(hull) => hull.extent(along),
            _ => {
                let reach = Vector3::from(self.half_extent()).dot(&along.abs());
                [-reach, reach]
            }
        }
    }

    /// Centre of mass (m), and inertia about it (m^2), of a homogeneous body of unit mass.
    pub(crate) fn unit_mass(&self) -> (Vector3<f64>, Matrix3<f64>) {
        let principal = match self {
            Self::Box { half: [x, y, z] } => Vector3::new(y * y + z * z, x * x + z * z, x * x + y * y) / 3.0,
            Self::Cylinder { radius: r, half_height: h } => {
                let across = r * r / 4.0 + h * h / 3.0;
                Vector3::new(across, across, r * r / 2.0)
            }
            Self::Sphere { radius } => Vector3::repeat(0.4 * radius * radius),
            Self::Hull(hull) => {
                return hull
                    .mesh()
                    .map_or((Vector3::zeros(), Matrix3::zeros()), |mesh| (mesh.bulk().centre, mesh.bulk().inertia_m2));
            }
        };
        (Vector3::zeros(), Matrix3::from_diagonal(&principal))
    }
}

/// A convex shape at its place in a rigid body.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
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
