//! Soft shadows of a distant lamp, in closed form.
//!
//! Projected along the light, each solid is a flat figure: a disc, a stadium, a hexagon. The position of a point
//! relative to that figure gives the hidden fraction of the lamp. The lamp is a panel, so the width of a shadow's edge
//! is proportional to the distance from solid to point. A grid across the light stores for each cell the solids whose
//! shadows may fall there.

use nalgebra::{Vector2, Vector3};

use crate::body::{Body, Form};
use crate::light::{LAMP_SPREAD, Light};

/// Width of a cell, in metres.
const CELL: f32 = 0.03;
/// Cells along each side.
const CELLS: usize = 64;

/// The shadows of a scene.
pub(crate) struct Shadows<'a> {
    bodies: &'a [Body<'a>],
    towards: Vector3<f32>,
    /// Two axes across the light.
    across: [Vector3<f32>; 2],
    casters: Vec<Caster>,
    corner: Vector2<f32>,
    words: usize,
    /// One bit for each cell and caster.
    cells: Vec<u64>,
}

/// A solid projected along the light. Third coordinates are heights along the light.
struct Caster {
    body: u32,
    centre: Vector3<f32>,
    radius: f32,
    opacity: f32,
    figure: Figure,
}

enum Figure {
    Disc {
        radius: f32,
    },
    /// Half the axis.
    Stadium {
        radius: f32,
        half: Vector3<f32>,
    },
    /// Unit vectors across and along the projected axis, half the axis, and the visible fraction of an end disc.
    Tin {
        radius: f32,
        across: Vector2<f32>,
        along: Vector2<f32>,
        half: Vector3<f32>,
        open: f32,
    },
    /// Pairs of parallel edges: their normals and half their distances. And the box's axes and half extents.
    Hexagon {
        edges: [(Vector2<f32>, f32); 3],
        axes: [Vector3<f32>; 3],
        half: [f32; 3],
    },
    Mesh,
}

impl<'a> Shadows<'a> {
    /// Computes the shadows of all bodies that cast one. With `all` they may fall into every cell, which disables the
    /// acceleration by the grid.
    pub(crate) fn new(
        bodies: &'a [Body<'a>],
        casts: impl Fn(usize) -> bool,
        light: &Light,
        middle: Vector3<f32>,
        all: bool,
    ) -> Self {
        let towards = light.towards;
        let x = towards.cross(&Vector3::y()).normalize();
        let across = [x, towards.cross(&x)];
        let seen = |v: &Vector3<f32>| Vector3::new(v.dot(&across[0]), v.dot(&across[1]), v.dot(&towards));
        let mut casters = Vec::with_capacity(bodies.len());
        for (i, body) in bodies.iter().enumerate().filter(|(i, _)| casts(*i)) {
            casters.push(Caster::new(i as u32, body, seen));
        }
        let words = casters.len().div_ceil(64).max(1);
        let reach = 0.5 * CELL * CELLS as f32;
        let corner = seen(&middle).xy() - Vector2::repeat(reach);
        let mut shadows =
            Self { bodies, towards, across, casters, corner, words, cells: vec![0; CELLS * CELLS * words] };
        shadows.fill(seen(&middle).z - 0.9, all);
        shadows
    }

    /// Adds each caster to the cells that its shadow may reach. No visible point is lower than `lowest`.
    fn fill(&mut self, lowest: f32, all: bool) {
        for (k, caster) in self.casters.iter().enumerate() {
            let blur = LAMP_SPREAD * (caster.centre.z + caster.radius - lowest).max(0.0);
            let (a, b, radius) = caster.capsule();
            let margin = radius + blur;
            let cell = |x: f32, axis: usize| ((x - self.corner[axis]) / CELL).floor();
            let range = |axis: usize| {
                if all {
                    return (0.0, CELLS as f32 - 1.0);
                }
                let (low, high) = (a[axis].min(b[axis]) - margin, a[axis].max(b[axis]) + margin);
                let last = CELLS as f32 - 1.0;
                (cell(low, axis).max(0.0), cell(high, axis).min(last))
            };
            let ((left, right), (top, bottom)) = (range(0), range(1));
            if left > right || top > bottom {
                continue;
            }
            let near = (margin + CELL * std::f32::consts::FRAC_1_SQRT_2).powi(2);
            for row in top as usize..=bottom as usize {
                for column in left as usize..=right as usize {
                    let middle = self.corner + Vector2::new(column as f32 + 0.5, row as f32 + 0.5) * CELL;
                    if all || distance_squared(&middle, &a, &b) <= near {
                        self.cells[(row * CELLS + column) * self.words + k / 64] |= 1 << (k % 64);
                    }
                }
            }
        }
    }

    /// Fraction of the lamp that is visible from a point of body `own`.
    pub(crate) fn light_at(&self, point: &Vector3<f32>, own: u32) -> f32 {
        let p = Vector3::new(point.dot(&self.across[0]), point.dot(&self.across[1]), point.dot(&self.towards));
        let [column, row] = [0, 1].map(|axis| (p[axis] - self.corner[axis]) / CELL);
        let inside = 0.0..CELLS as f32;
        if !inside.contains(&column) || !inside.contains(&row) {
            return 1.0;
        }
        let first = (row as usize * CELLS + column as usize) * self.words;
        let mut seen = 1.0;
        for (word, bits) in self.cells[first..first + self.words].iter().enumerate() {
            let mut bits = *bits;
            while bits != 0 {
                let caster = &self.casters[word * 64 + bits.trailing_zeros() as usize];
                bits &= bits - 1;
                if caster.body != own {
                    let hidden = match caster.figure {
                        Figure::Mesh => self.behind_mesh(caster, point),
                        _ => caster.hides(&p),
                    };
                    seen *= 1.0 - caster.opacity * hidden;
                    if seen < 0.004 {
                        return 0.0;
                    }
                }
            }
        }
        seen
    }

    fn behind_mesh(&self, caster: &Caster, point: &Vector3<f32>) -> f32 {
        let body = &self.bodies[caster.body as usize];
        let Form::Mesh(mesh) = body.form else { return 0.0 };
        let direction = body.along_axes(&self.towards);
        f32::from(mesh.first(&body.local(point), &direction, 1e-3, 10.0).is_some())
    }
}

impl Caster {
    fn new(index: u32, body: &Body<'_>, seen: impl Fn(&Vector3<f32>) -> Vector3<f32>) -> Self {
        let axis = |i: usize| seen(&body.axes[i]);
        let (_, half, radius) = body.form.hull();
        let figure = match body.form {
            Form::Sphere { radius } => Figure::Disc { radius: *radius },
            Form::Capsule { radius, half_height } => Figure::Stadium { radius: *radius, half: axis(2) * *half_height },
            Form::Cylinder { radius, half_height } => {
                let axis = axis(2);
                let along = axis.xy().try_normalize(1e-6).unwrap_or_else(Vector2::x);
                let across = Vector2::new(-along.y, along.x);
                Figure::Tin { radius: *radius, across, along, half: axis * *half_height, open: axis.z.abs() }
            }
            Form::Box { half } => {
                let axes = [0, 1, 2].map(axis);
                let edge = |i: usize| {
                    let along = axes[i].xy();
                    // An axis parallel to the light has no edges in the figure: the other two bound it.
                    let Some(along) = along.try_normalize(1e-4) else { return (Vector2::zeros(), 1.0) };
                    let normal = Vector2::new(-along.y, along.x);
                    let reach = (0..3).filter(|j| *j != i).map(|j| half[j] * normal.dot(&axes[j].xy()).abs()).sum();
                    (normal, reach)
                };
                Figure::Hexagon { edges: [edge(0), edge(1), edge(2)], axes, half: *half }
            }
            Form::Mesh(_) => Figure::Mesh,
        };
        let opacity = 1.0 - 0.8 * body.finish.transparency as f32;
        Self { body: index, centre: seen(&body.centre), radius: half + radius, opacity, figure }
    }

    /// A flat capsule around the figure: its ends and its radius.
    fn capsule(&self) -> (Vector2<f32>, Vector2<f32>, f32) {
        let centre = self.centre.xy();
        match &self.figure {
            Figure::Disc { radius } => (centre, centre, *radius),
            Figure::Stadium { radius, half } | Figure::Tin { radius, half, .. } => {
                (centre - half.xy(), centre + half.xy(), *radius)
            }
            Figure::Hexagon { axes, half, .. } => {
                let long = (0..3).fold(0, |best, i| if half[i] > half[best] { i } else { best });
                let along = axes[long].xy() * half[long];
                let [a, b] = [half[(long + 1) % 3], half[(long + 2) % 3]];
                (centre - along, centre + along, (a * a + b * b).sqrt())
            }
            Figure::Mesh => (centre, centre, self.radius),
        }
    }

    /// Fraction of the lamp that the solid hides from a point.
    fn hides(&self, p: &Vector3<f32>) -> f32 {
        let off = p - self.centre;
        // A point above its highest point is in front of it.
        if off.z > self.radius {
            return 0.0;
        }
        match &self.figure {
            Figure::Disc { radius } => {
                let width = blur(-off.z - 0.7 * radius);
                if -off.z < 0.0 { 0.0 } else { bar(off.xy().norm(), *radius, width) }
            }
            Figure::Stadium { radius, half } => {
                let flat = half.xy();
                let along = (off.xy().dot(&flat) / flat.norm_squared().max(1e-9)).clamp(-1.0, 1.0);
                let height = along * half.z - off.z;
                if height < 0.0 {
                    return 0.0;
                }
                bar((off.xy() - flat * along).norm(), *radius, blur(height - 0.7 * radius))
            }
            Figure::Tin { radius, across, along, half, open } => {
                let (u, v) = (off.xy().dot(across).abs(), off.xy().dot(along));
                let flat = half.xy().norm();
                let place = if flat > 1e-5 { (v / flat).clamp(-1.0, 1.0) } else { 0.0 };
                let height = place * half.z - off.z;
                if height < -0.5 * radius * (1.0 - open * open).max(0.0).sqrt() {
                    return 0.0;
                }
                let width = blur(height - 0.7 * radius * (1.0 - open));
                let round = open * (radius * radius - u * u).max(0.0).sqrt();
                bar(u, *radius, width) * bar(v.abs(), flat + round, width)
            }
            Figure::Hexagon { edges, axes, half } => {
                // Outside the widest possible edge of the shadow, which is the case for most points of a cell.
                let widest = blur(self.radius - off.z);
                if edges.iter().any(|(normal, reach)| off.xy().dot(normal).abs() >= reach + widest) {
                    return 0.0;
                }
                // The part of the ray to the lamp that is inside the box.
                let (mut enters, mut leaves) = (-1e9_f32, 1e9_f32);
                for i in 0..3 {
                    let rate = if axes[i].z.abs() < 1e-6 { 1e-6 } else { axes[i].z };
                    let at = off.dot(&axes[i]);
                    let (a, b) = ((-half[i] - at) / rate, (half[i] - at) / rate);
                    enters = enters.max(a.min(b));
                    leaves = leaves.min(a.max(b));
                }
                if 0.5 * (enters + leaves) < 0.0 {
                    return 0.0;
                }
                let width = blur(enters.min(leaves));
                let mut hidden = 1.0;
                for (normal, reach) in edges {
                    hidden *= bar(off.xy().dot(normal).abs(), *reach, width);
                    if hidden <= 0.0 {
                        return 0.0;
                    }
                }
                hidden
            }
            Figure::Mesh => 0.0,
        }
    }
}

/// Half the width of the shadow's edge for a solid at this distance towards the lamp, in metres.
fn blur(distance: f32) -> f32 {
    LAMP_SPREAD * distance.max(0.004)
}

/// Fraction of the lamp that is hidden by a bar of half width `half` whose centre line is at the distance `off`, with
/// edges 2 `width` wide.
fn bar(off: f32, half: f32, width: f32) -> f32 {
    if off >= half + width {
        return 0.0;
    }
    let step = |x: f32| {
        let x = x.clamp(-1.0, 1.0);
        0.5 + 0.75 * x - 0.25 * x * x * x
    };
    (step((half - off) / width) + step((half + off) / width) - 1.0).max(0.0)
}

fn distance_squared(p: &Vector2<f32>, a: &Vector2<f32>, b: &Vector2<f32>) -> f32 {
    let along = b - a;
    let share = ((p - a).dot(&along) / along.norm_squared().max(1e-12)).clamp(0.0, 1.0);
    (p - a - along * share).norm_squared()
}
