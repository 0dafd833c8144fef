//! The object shapes, made of primitives.

use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};
use robogate_physics::{MassProperties, Object, Part, Primitive};

/// The object shapes. Each fits a cube of the object's size and is grasped across its y axis.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum Shape {
    /// A cube.
    #[default]
    Box,
    /// An upright cylinder with equal height and diameter.
    Cylinder,
    /// A ball.
    Sphere,
    /// An L that stands on its long leg: a foot of full length and half height, and a stem above its rear half.
    L,
    /// A lump: two slabs rotated against each other by 15 degrees, and a ball at their side.
    Irregular,
}

impl Shape {
    /// Every shape.
    pub const ALL: [Self; 5] = [Self::Box, Self::Cylinder, Self::Sphere, Self::L, Self::Irregular];

    /// The shape's name in parameter spaces.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Box => "box",
            Self::Cylinder => "cylinder",
            Self::Sphere => "sphere",
            Self::L => "L_shape",
            Self::Irregular => "irregular",
        }
    }

    /// The shape with this name.
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|shape| shape.as_str() == name)
    }

    /// The rotation about the vertical after which a grasp across y is equivalent, in radians.
    pub fn grasp_symmetry(self) -> f64 {
        use std::f64::consts::{FRAC_PI_2, PI};
        match self {
            Self::Box | Self::Cylinder | Self::Sphere => FRAC_PI_2,
            Self::L | Self::Irregular => PI,
        }
    }

    /// The width across which it is grasped, as a fraction of its size.
    pub fn grasp_width(self) -> f64 {
        if self == Self::Irregular { 0.76 } else { 1.0 }
    }

    /// The smallest angle between an object with rotation `actual` and one with rotation `wanted`, in radians, over all
    /// rotations of the shape onto itself. Both shapes stand upright at angle 0 about the vertical.
    pub fn angle_between(self, actual: &UnitQuaternion<f64>, wanted: &UnitQuaternion<f64>) -> f64 {
        let copies = match self {
            Self::Sphere => return 0.0,
            Self::Cylinder => return (actual * Vector3::z()).angle(&(wanted * Vector3::z())),
            Self::Box => 4,
            Self::L | Self::Irregular => 1,
        };
        let turned = |k: i32| {
            let turn = std::f64::consts::TAU * f64::from(k) / f64::from(copies);
            actual.angle_to(&(wanted * UnitQuaternion::from_axis_angle(&Vector3::z_axis(), turn)))
        };
        (0..copies).map(turned).fold(f64::INFINITY, f64::min)
    }

    /// Centre of the highest face of an object of this size (m), relative to the object's centre, in metres. A cup that
    /// comes from above touches this face.
    pub fn top(self, size: f64) -> [f64; 2] {
        let height = |part: &Part| part.pose.translation.z + part.primitive.half_extent()[2];
        let highest = self.parts(size).into_iter().max_by(|a, b| height(a).total_cmp(&height(b)));
        highest.map_or([0.0; 2], |part| [part.pose.translation.x, part.pose.translation.y])
    }

    /// Direction from the centre to the ballast of a shifted centre of mass. It is the +x face, perpendicular to the
    /// closing direction of the fingers, so the weight twists the object in the grip. A ball rests with its heavy side
    /// down, so its ballast is at the bottom.
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

    /// Creates an object of this shape, size (m), mass (kg) and centre-of-mass offset.
    ///
    /// `com_offset` is the fraction of the mass that is a point at the centre of one face (+x; the bottom of a ball).
    /// The rest is homogeneous. The centre of mass therefore moves by that fraction of its distance to the face.
    pub fn object(self, size_m: f64, mass_kg: f64, com_offset: f64) -> Object {
        let parts = self.parts(size_m);
        let mass = MassProperties::with_ballast(&parts, mass_kg, com_offset, self.ballast() * (0.5 * size_m));
        Object { parts, mass, joint: None, friction: None }
    }

    /// The centre-of-mass offset of an object of this size (m) whose centre of mass is at `centre` (m, in the object's
    /// frame): the inverse of [`Shape::object`], for reading an engine's state back.
    pub fn com_offset_of(self, size_m: f64, centre: &Vector3<f64>) -> f64 {
        let direction = self.ballast();
        let homogeneous = self.object(size_m, 1.0, 0.0).mass.centre.dot(&direction);
        (centre.dot(&direction) - homogeneous) / (0.5 * size_m - homogeneous)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shapes_fit_their_cube() {
        for shape in Shape::ALL {
            for part in shape.object(0.1, 1.0, 0.0).parts {
                let rotation = part.pose.rotation.to_rotation_matrix().into_inner().abs();
                let reach = match part.primitive {
                    Primitive::Sphere { radius } => Vector3::repeat(radius),
                    other => rotation * Vector3::from(other.half_extent()),
                };
                let reach = reach + part.pose.translation.vector.abs();
                assert!(reach.max() <= 0.05 + 1e-12, "{shape:?} reaches {reach}");
            }
        }
    }

    #[test]
    fn angles_respect_symmetry() {
        let about = |axis, degrees: f64| UnitQuaternion::from_axis_angle(&axis, degrees.to_radians());
        let (upright, turned) = (UnitQuaternion::identity(), about(Vector3::z_axis(), 100.0));
        for (shape, degrees) in [(Shape::Box, 10.0), (Shape::Cylinder, 0.0), (Shape::Sphere, 0.0), (Shape::L, 100.0)] {
            assert!((shape.angle_between(&turned, &upright).to_degrees() - degrees).abs() < 1e-6, "{shape:?}");
        }
        let tilted = about(Vector3::x_axis(), 20.0);
        for shape in [Shape::Box, Shape::Cylinder, Shape::Irregular] {
            assert!((shape.angle_between(&tilted, &upright).to_degrees() - 20.0).abs() < 1e-6, "{shape:?}");
        }
    }

    #[test]
    fn offset_moves_centre_of_mass() {
        let cube = Shape::Box.object(0.06, 0.5, 0.4);
        assert!((cube.mass.centre - Vector3::new(0.4 * 0.03, 0.0, 0.0)).norm() < 1e-15);
        for shape in Shape::ALL {
            let object = shape.object(0.06, 0.5, 0.3);
            assert!((shape.com_offset_of(0.06, &object.mass.centre) - 0.3).abs() < 1e-12);
        }
    }

    #[test]
    fn inertia_obeys_the_triangle_inequality() {
        for shape in Shape::ALL {
            for offset in [0.0, 0.1, 0.4] {
                let eigen = shape.object(0.05, 1.0, offset).mass.inertia.symmetric_eigenvalues();
                let (sum, max) = (eigen.sum(), eigen.max());
                assert!(eigen.min() > 0.0 && sum - max >= max * (1.0 - 1e-12), "{shape:?} {offset}: {eigen}");
            }
        }
    }
}
