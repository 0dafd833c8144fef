//! Conversions between plain data and Rapier's types.

use nalgebra::{Isometry3, UnitQuaternion, Vector3};
use rapier3d_f64::dynamics::MassProperties;
use rapier3d_f64::geometry::{Collider, SharedShape};
use rapier3d_f64::math::{Matrix, Pose, Rotation, Vector};

use crate::Primitive;
use crate::description::{Link, Solid};

pub(super) fn vector(v: &Vector3<f64>) -> Vector {
    Vector::new(v.x, v.y, v.z)
}

pub(super) fn pose(pose: &Isometry3<f64>) -> Pose {
    let q = pose.rotation;
    Pose { translation: vector(&pose.translation.vector), rotation: Rotation::from_xyzw(q.i, q.j, q.k, q.w) }
}

/// Rotation from Rapier's cylinders and capsules (axis y) to ours (axis z).
pub(super) fn quarter() -> UnitQuaternion<f64> {
    UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::FRAC_PI_2)
}

pub(super) fn solid(solid: &Solid, at: &Isometry3<f64>) -> Result<(SharedShape, Isometry3<f64>), String> {
    Ok(match solid {
        Solid::Box { half: [x, y, z] } => (SharedShape::cuboid(*x, *y, *z), *at),
        Solid::Sphere { radius } => (SharedShape::ball(*radius), *at),
        Solid::Cylinder { radius, half_height } => (SharedShape::cylinder(*half_height, *radius), at * quarter()),
        Solid::Capsule { radius, half_height } => (SharedShape::capsule_y(*half_height, *radius), at * quarter()),
        Solid::Hull { points } => {
            let points: Vec<Vector> = points.iter().map(|p| vector(&p.coords)).collect();
            let hull =
                SharedShape::convex_hull(&points).ok_or("a mesh has no convex hull: its vertices are coplanar")?;
            (hull, *at)
        }
    })
}

pub(super) fn primitive(primitive: &Primitive) -> Solid {
    match primitive {
        Primitive::Box { half } => Solid::Box { half: *half },
        Primitive::Cylinder { radius, half_height } => Solid::Cylinder { radius: *radius, half_height: *half_height },
        Primitive::Sphere { radius } => Solid::Sphere { radius: *radius },
        Primitive::Hull(hull) => Solid::Hull { points: hull.corners().to_vec() },
    }
}

pub(super) fn read_primitive(collider: &Collider) -> Option<Primitive> {
    let shape = collider.shape();
    if let Some(b) = shape.as_cuboid() {
        Some(Primitive::Box { half: [b.half_extents.x, b.half_extents.y, b.half_extents.z] })
    } else if let Some(c) = shape.as_cylinder() {
        Some(Primitive::Cylinder { radius: c.radius, half_height: c.half_height })
    } else {
        shape.as_ball().map(|b| Primitive::Sphere { radius: b.radius })
    }
}

pub(super) fn mass_properties(link: &Link) -> MassProperties {
    let columns: Vec<f64> = link.inertia.iter().copied().collect();
    let mut matrix = [0.0; 9];
    matrix.copy_from_slice(&columns);
    MassProperties::with_inertia_matrix(vector(&link.centre), link.mass, Matrix::from_cols_array(&matrix))
}
