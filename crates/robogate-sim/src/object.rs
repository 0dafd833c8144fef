//! The objects: five shapes out of primitives, with the inertia of a shifted centre of mass.

use nalgebra::{Isometry3, Matrix3, Translation3, UnitQuaternion, Vector3};
use serde::{Deserialize, Serialize};

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
    fn unit_inertia(&self) -> Vector3<f64> {
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

/// A primitive at its place in an object.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Part {
    /// The primitive.
    pub primitive: Primitive,
    /// Its pose in the object's frame.
    pub pose: Isometry3<f64>,
}

/// The object shapes. Each fits a cube of the object's size and is grasped across its y axis.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Shape {
    /// A cube.
    Box,
    /// An upright cylinder as high as wide.
    Cylinder,
    /// A ball.
    Sphere,
    /// An L standing on its long leg: a foot of full length and half height, and above its rear
    /// half a stem.
    L,
    /// A lump: two slabs turned against each other by 15 degrees, and a ball at their side.
    Irregular,
}

impl Shape {
    /// Every shape.
    pub const ALL: [Self; 5] = [Self::Box, Self::Cylinder, Self::Sphere, Self::L, Self::Irregular];

    /// The shape's word in parameter spaces.
    pub fn word(self) -> &'static str {
        match self {
            Self::Box => "box",
            Self::Cylinder => "cylinder",
            Self::Sphere => "sphere",
            Self::L => "L_shape",
            Self::Irregular => "irregular",
        }
    }

    /// The shape of that word.
    pub fn from_word(word: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|shape| shape.word() == word)
    }

    /// After which turn about the vertical a grasp across y finds the same object again, in radians.
    pub fn grasp_symmetry(self) -> f64 {
        use std::f64::consts::{FRAC_PI_2, PI};
        match self {
            Self::Box | Self::Cylinder | Self::Sphere => FRAC_PI_2,
            Self::L | Self::Irregular => PI,
        }
    }

    /// The middle of the highest face of an object of this size (m), from the object's middle, in metres: where a cup
    /// from above finds it.
    pub fn top(self, size: f64) -> [f64; 2] {
        let height = |part: &Part| part.pose.translation.z + part.primitive.half_extent()[2];
        let highest = self.parts(size).into_iter().max_by(|a, b| height(a).total_cmp(&height(b)));
        highest.map_or([0.0; 2], |part| [part.pose.translation.x, part.pose.translation.y])
    }

    /// Where the ballast of a shifted centre of mass sits, as a direction from the middle: on the +x
    /// face, across the direction in which the fingers close, so that the weight twists the object
    /// in the grip. A ball rests with its heavy side down: its ballast is at the bottom.
    fn ballast(self) -> Vector3<f64> {
        match self {
            Self::Sphere => -Vector3::z(),
            Self::Box | Self::Cylinder | Self::L | Self::Irregular => Vector3::x(),
        }
    }

    fn parts(self, size: f64) -> Vec<Part> {
        let at = |x: f64, y: f64, z: f64, yaw_deg: f64, primitive| Part {
            primitive,
            pose: Isometry3::from_parts(
                Translation3::new(x * size, y * size, z * size),
                UnitQuaternion::from_axis_angle(&Vector3::z_axis(), yaw_deg.to_radians()),
            ),
        };
        let cuboid = |x: f64, y: f64, z: f64| Primitive::Box { half: [x * size, y * size, z * size] };
        match self {
            Self::Box => vec![at(0.0, 0.0, 0.0, 0.0, cuboid(0.5, 0.5, 0.5))],
            Self::Cylinder => {
                let primitive = Primitive::Cylinder { radius: 0.5 * size, half_height: 0.5 * size };
                vec![at(0.0, 0.0, 0.0, 0.0, primitive)]
            }
            Self::Sphere => vec![at(0.0, 0.0, 0.0, 0.0, Primitive::Sphere { radius: 0.5 * size })],
            Self::L => {
                vec![
                    at(0.0, 0.0, -0.25, 0.0, cuboid(0.5, 0.5, 0.25)),
                    at(-0.25, 0.0, 0.25, 0.0, cuboid(0.25, 0.5, 0.25)),
                ]
            }
            Self::Irregular => vec![
                at(0.0, 0.0, -0.25, 0.0, cuboid(0.5, 0.38, 0.25)),
                at(0.02, 0.03, 0.25, 15.0, cuboid(0.36, 0.38, 0.25)),
                at(0.27, -0.2, 0.0, 0.0, Primitive::Sphere { radius: 0.22 * size }),
            ],
        }
    }
}

/// Mass, centre of mass and inertia of a rigid body, in its own frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MassProperties {
    /// Mass in kilograms.
    pub mass_kg: f64,
    /// Centre of mass, in metres.
    pub centre: Vector3<f64>,
    /// Inertia about the centre of mass along the body's axes, in kg m^2.
    pub inertia: Matrix3<f64>,
}

/// An object: its parts about the centre of its bounding box, and what it weighs.
#[derive(Debug, Clone, PartialEq)]
pub struct ObjectModel {
    /// The shape.
    pub shape: Shape,
    /// Edge of the cube that it fits, in metres.
    pub size_m: f64,
    /// The parts.
    pub parts: Vec<Part>,
    /// Mass and inertia.
    pub mass: MassProperties,
}

impl ObjectModel {
    /// An object of this shape, size (m), mass (kg) and centre-of-mass offset.
    ///
    /// `com_offset` is the share of the mass that is a point at the middle of one of the object's faces
    /// (+x; a ball's bottom), the rest being homogeneous. The centre of mass so moves by that share of its
    /// way to the face, and the inertia is the exact one of the two together (parallel axes).
    pub fn new(shape: Shape, size_m: f64, mass_kg: f64, com_offset: f64) -> Self {
        let parts = shape.parts(size_m);
        let volume: f64 = parts.iter().map(|part| part.primitive.volume()).sum();
        let mut masses: Vec<(f64, Vector3<f64>, Matrix3<f64>)> = parts
            .iter()
            .map(|part| {
                let mass = mass_kg * (1.0 - com_offset) * part.primitive.volume() / volume;
                let turn = part.pose.rotation.to_rotation_matrix().into_inner();
                let own = turn * Matrix3::from_diagonal(&(part.primitive.unit_inertia() * mass)) * turn.transpose();
                (mass, part.pose.translation.vector, own)
            })
            .collect();
        masses.push((mass_kg * com_offset, shape.ballast() * (0.5 * size_m), Matrix3::zeros()));
        let centre = masses.iter().map(|(mass, at, _)| at * *mass).sum::<Vector3<f64>>() / mass_kg;
        let inertia = masses
            .iter()
            .map(|(mass, at, own)| {
                let arm = at - centre;
                own + (Matrix3::identity() * arm.norm_squared() - arm * arm.transpose()) * *mass
            })
            .sum();
        Self { shape, size_m, parts, mass: MassProperties { mass_kg, centre, inertia } }
    }

    /// The centre-of-mass offset that puts the centre of mass there (m, in the object's frame): the
    /// inverse of what [`Self::new`] does, for reading an engine's state back.
    pub fn com_offset_of(&self, centre: &Vector3<f64>) -> f64 {
        let way = self.shape.ballast();
        let homogeneous = Self::new(self.shape, self.size_m, 1.0, 0.0).mass.centre.dot(&way);
        (centre.dot(&way) - homogeneous) / (0.5 * self.size_m - homogeneous)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_shape_fits_its_cube() {
        for shape in Shape::ALL {
            for part in ObjectModel::new(shape, 0.1, 1.0, 0.0).parts {
                let turn = part.pose.rotation.to_rotation_matrix().into_inner().abs();
                let reach = match part.primitive {
                    Primitive::Sphere { radius } => Vector3::repeat(radius),
                    other => turn * Vector3::from(other.half_extent()),
                };
                let reach = reach + part.pose.translation.vector.abs();
                assert!(reach.max() <= 0.05 + 1e-12, "{shape:?} reaches {reach}");
            }
        }
    }

    #[test]
    fn the_offset_moves_the_centre_of_mass_by_its_share_of_the_way_to_the_face() {
        let cube = ObjectModel::new(Shape::Box, 0.06, 0.5, 0.4);
        assert!((cube.mass.centre - Vector3::new(0.4 * 0.03, 0.0, 0.0)).norm() < 1e-15);
        for shape in Shape::ALL {
            let object = ObjectModel::new(shape, 0.06, 0.5, 0.3);
            assert!((object.com_offset_of(&object.mass.centre) - 0.3).abs() < 1e-12);
        }
    }

    #[test]
    fn inertia_obeys_the_triangle_inequality_for_every_offset() {
        for shape in Shape::ALL {
            for offset in [0.0, 0.1, 0.4] {
                let eigen = ObjectModel::new(shape, 0.05, 1.0, offset).mass.inertia.symmetric_eigenvalues();
                let (sum, max) = (eigen.sum(), eigen.max());
                assert!(eigen.min() > 0.0 && sum - max >= max * (1.0 - 1e-12), "{shape:?} {offset}: {eigen}");
            }
        }
    }
}
