//! Solids and their intersections with rays.
//!
//! Rays from one eye point are processed in packets of eight, in plain arithmetic that the compiler vectorises.
//! Directions have length 1 along the line of sight, so a ray's parameter is the depth.

use std::sync::Arc;

use nalgebra::{Isometry3, Vector3};

use crate::finish::Finish;
use crate::mesh::Mesh;

/// Number of rays in a packet.
pub(crate) const LANES: usize = 8;
/// One number per ray of a packet.
pub(crate) type Lanes = [f32; LANES];

/// Nearest visible depth, in metres.
pub(crate) const NEAREST: f32 = 0.01;
/// The depth of a ray without a hit.
pub(crate) const NOWHERE: f32 = 1e9;

/// A solid, centred at its origin with its axis along z, in metres.
#[derive(Debug, Clone)]
pub(crate) enum Form {
    Box { half: [f32; 3] },
    Sphere { radius: f32 },
    Capsule { radius: f32, half_height: f32 },
    Cylinder { radius: f32, half_height: f32 },
    Mesh(Arc<Mesh>),
}

impl Form {
    /// A capsule around the solid, about its z axis or its longest axis: the axis, half its length, and the radius.
    pub(crate) fn hull(&self) -> (usize, f32, f32) {
        let of_box = |half: [f32; 3]| {
            let longest = (0..3).fold(0, |best, i| if half[i] > half[best] { i } else { best });
            let [a, b] = [half[(longest + 1) % 3], half[(longest + 2) % 3]];
            (longest, half[longest], (a * a + b * b).sqrt())
        };
        match self {
            Self::Box { half } => of_box(*half),
            Self::Sphere { radius } => (2, 0.0, *radius),
            Self::Capsule { radius, half_height } | Self::Cylinder { radius, half_height } => {
                (2, *half_height, *radius)
            }
            Self::Mesh(mesh) => of_box(mesh.half()),
        }
    }
}

/// A solid with its pose in the base frame.
#[derive(Debug, Clone)]
pub(crate) struct Body<'a> {
    pub(crate) form: &'a Form,
    pub(crate) finish: &'a Finish,
    pub(crate) centre: Vector3<f32>,
    /// The body's axes in the base frame.
    pub(crate) axes: [Vector3<f32>; 3],
}

/// Eight rays from one eye point.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Rays {
    pub(crate) x: Lanes,
    pub(crate) y: Lanes,
    pub(crate) z: Lanes,
}

impl Rays {
    pub(crate) fn direction(&self, lane: usize) -> Vector3<f32> {
        Vector3::new(self.x[lane], self.y[lane], self.z[lane])
    }
}

/// The nearest hits of eight rays so far.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Hits {
    pub(crate) depth: Lanes,
    /// Index of the body.
    pub(crate) body: [u32; LANES],
    /// Index of the triangle of a mesh.
    pub(crate) triangle: [u32; LANES],
}

impl Hits {
    pub(crate) const NONE: Self = Self { depth: [NOWHERE; LANES], body: [u32::MAX; LANES], triangle: [0; LANES] };
}

impl<'a> Body<'a> {
    pub(crate) fn new(form: &'a Form, finish: &'a Finish, pose: &Isometry3<f64>) -> Self {
        let rotation = pose.rotation.to_rotation_matrix();
        let axes = [0, 1, 2].map(|i| rotation.matrix().column(i).map(|x| x as f32));
        Self { form, finish, centre: pose.translation.vector.map(|x| x as f32), axes }
    }

    /// Ends of the axis of its capsule, and the radius.
    pub(crate) fn hull(&self) -> (Vector3<f32>, Vector3<f32>, f32) {
        let (axis, half, radius) = self.form.hull();
        let along = self.axes[axis] * half;
        (self.centre - along, self.centre + along, radius)
    }

    /// Intersects the rays from `eye` with the body and keeps the hits that are nearer than those so far.
    pub(crate) fn meet(&self, index: u32, eye: &Vector3<f32>, rays: &Rays, hits: &mut Hits) {
        let o = self.local(eye);
        let local = |axis: usize| -> Lanes {
            let [a, b, c]: [f32; 3] = self.axes[axis].into();
            let mut out = [0.0; LANES];
            for (k, out) in out.iter_mut().enumerate() {
                *out = a * rays.x[k] + b * rays.y[k] + c * rays.z[k];
            }
            out
        };
        let (dx, dy, dz) = (local(0), local(1), local(2));
        let depth = match self.form {
            Form::Box { half } => meet_box(half, &o, [&dx, &dy, &dz]),
            Form::Sphere { radius } => meet_sphere(*radius, &o, [&dx, &dy, &dz]),
            Form::Capsule { radius, half_height } => meet_capsule(*radius, *half_height, &o, [&dx, &dy, &dz]),
            Form::Cylinder { radius, half_height } => meet_cylinder(*radius, *half_height, &o, [&dx, &dy, &dz]),
            Form::Mesh(mesh) => {
                for k in 0..LANES {
                    let d = Vector3::new(dx[k], dy[k], dz[k]);
                    if let Some((t, triangle)) = mesh.first(&o, &d, NEAREST, hits.depth[k]) {
                        (hits.depth[k], hits.body[k], hits.triangle[k]) = (t, index, triangle);
                    }
                }
                return;
            }
        };
        for ((depth, first), body) in depth.iter().zip(&mut hits.depth).zip(&mut hits.body) {
            let nearer = *depth > NEAREST && *depth < *first;
            *first = if nearer { *depth } else { *first };
            *body = if nearer { index } else { *body };
        }
    }

    /// A point of the base frame in the body's frame.
    pub(crate) fn local(&self, point: &Vector3<f32>) -> Vector3<f32> {
        self.along_axes(&(point - self.centre))
    }

    /// Outward normal in the base frame at a point of the surface, which is given in the body's frame. Edges are shaded
    /// as if rounded.
    pub(crate) fn normal(&self, p: &Vector3<f32>, triangle: u32) -> Vector3<f32> {
        let local = match self.form {
            Form::Box { half } => {
                let least = half[0].min(half[1]).min(half[2]);
                let edge = (0.15 * least).min(0.003);
                let beyond = [0, 1, 2].map(|i: usize| (p[i].abs() - (half[i] - edge)).max(0.0) * p[i].signum());
                // Away from the edges only one face counts, which is the case for most of an image.
                let faces = beyond.iter().filter(|x| x.abs() > 0.0).count();
                if let (1, Some(i)) = (faces, beyond.iter().position(|x| x.abs() > 0.0)) {
                    return self.axes[i] * beyond[i].signum();
                }
                Vector3::from(beyond)
            }
            Form::Sphere { .. } => *p,
            Form::Capsule { half_height, .. } => Vector3::new(p.x, p.y, p.z - p.z.clamp(-half_height, *half_height)),
            Form::Cylinder { radius, half_height } => {
                let edge = (0.15 * radius.min(*half_height)).min(0.003);
                let around = (p.x * p.x + p.y * p.y).sqrt().max(1e-9);
                let side = (around - (radius - edge)).max(0.0) / around;
                Vector3::new(p.x * side, p.y * side, (p.z.abs() - (half_height - edge)).max(0.0) * p.z.signum())
            }
            Form::Mesh(mesh) => mesh.normal(triangle),
        };
        let square = local.norm_squared();
        if square <= 1e-18 {
            return Vector3::z();
        }
        let [x, y, z] = &self.axes;
        (x * local.x + y * local.y + z * local.z) * (1.0 / square.sqrt())
    }

    /// A direction of the base frame in the body's frame.
    pub(crate) fn along_axes(&self, direction: &Vector3<f32>) -> Vector3<f32> {
        let [x, y, z] = &self.axes;
        Vector3::new(x.dot(direction), y.dot(direction), z.dot(direction))
    }
}

/// Moves a number away from zero to make it a valid divisor.
fn divisor(x: f32) -> f32 {
    if x.abs() < 1e-9 { 1e-9 } else { x }
}

fn lesser(a: f32, b: f32) -> f32 {
    if a < b { a } else { b }
}

fn greater(a: f32, b: f32) -> f32 {
    if a > b { a } else { b }
}

fn meet_box(half: &[f32; 3], o: &Vector3<f32>, d: [&Lanes; 3]) -> Lanes {
    let mut depth = [NOWHERE; LANES];
    for k in 0..LANES {
        let (mut near, mut far) = (-NOWHERE, NOWHERE);
        for i in 0..3 {
            let inverse = 1.0 / divisor(d[i][k]);
            let (a, b) = ((-half[i] - o[i]) * inverse, (half[i] - o[i]) * inverse);
            near = greater(near, lesser(a, b));
            far = lesser(far, greater(a, b));
        }
        depth[k] = if near < far { near } else { NOWHERE };
    }
    depth
}

fn meet_sphere(radius: f32, o: &Vector3<f32>, [dx, dy, dz]: [&Lanes; 3]) -> Lanes {
    let mut depth = [NOWHERE; LANES];
    let c = o.norm_squared() - radius * radius;
    for k in 0..LANES {
        let a = dx[k] * dx[k] + dy[k] * dy[k] + dz[k] * dz[k];
        let b = o.x * dx[k] + o.y * dy[k] + o.z * dz[k];
        let under = b * b - a * c;
        let t = (-b - greater(under, 0.0).sqrt()) / a;
        depth[k] = if under > 0.0 { t } else { NOWHERE };
    }
    depth
}

fn meet_capsule(radius: f32, half: f32, o: &Vector3<f32>, [dx, dy, dz]: [&Lanes; 3]) -> Lanes {
    let mut depth = [NOWHERE; LANES];
    let c = o.x * o.x + o.y * o.y - radius * radius;
    for k in 0..LANES {
        // The side: an infinite cylinder.
        let a = greater(dx[k] * dx[k] + dy[k] * dy[k], 1e-12);
        let b = o.x * dx[k] + o.y * dy[k];
        let under = b * b - a * c;
        let side = (-b - greater(under, 0.0).sqrt()) / a;
        let z = o.z + side * dz[k];
        // Beyond an end: the ball at that end.
        let end = if z > 0.0 { half } else { -half };
        let oz = o.z - end;
        let aa = dx[k] * dx[k] + dy[k] * dy[k] + dz[k] * dz[k];
        let bb = b + oz * dz[k];
        let cc = c + oz * oz;
        let round = bb * bb - aa * cc;
        let ball = (-bb - greater(round, 0.0).sqrt()) / aa;
        let capped = if round > 0.0 { ball } else { NOWHERE };
        let t = if z.abs() <= half { side } else { capped };
        depth[k] = if under > 0.0 { t } else { NOWHERE };
    }
    depth
}

fn meet_cylinder(radius: f32, half: f32, o: &Vector3<f32>, [dx, dy, dz]: [&Lanes; 3]) -> Lanes {
    let mut depth = [NOWHERE; LANES];
    let c = o.x * o.x + o.y * o.y - radius * radius;
    for k in 0..LANES {
        let a = greater(dx[k] * dx[k] + dy[k] * dy[k], 1e-12);
        let b = o.x * dx[k] + o.y * dy[k];
        let under = b * b - a * c;
        let root = greater(under, 0.0).sqrt();
        let (in_side, out_side) = ((-b - root) / a, (-b + root) / a);
        let inverse = 1.0 / divisor(dz[k]);
        let (low, high) = ((-half - o.z) * inverse, (half - o.z) * inverse);
        let near = greater(in_side, lesser(low, high));
        let far = lesser(out_side, greater(low, high));
        depth[k] = if under > 0.0 && near < far { near } else { NOWHERE };
    }
    depth
}
