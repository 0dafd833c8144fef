//! Surface finishes: colour, gloss, transparency and pattern.

use nalgebra::Vector3;
use robogate_physics::{Color, TableMaterial};

use crate::light::linear;
use crate::table::{self, Texture};

/// The finish of a surface.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Finish {
    /// Fraction of red, green and blue light that is reflected.
    pub(crate) albedo: Vector3<f32>,
    /// Specular reflection of lamp and surroundings: 0 is matt, 1 is varnish.
    pub(crate) gloss: f32,
    /// Fraction of the light that passes through.
    pub(crate) transparency: f64,
    pub(crate) pattern: Pattern,
}

/// Variation of the finish over a surface.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Pattern {
    Plain,
    /// The table's top, with a painted ring at `marker` (m, in the table's frame).
    Table {
        material: TableMaterial,
        marker: Option<[f32; 2]>,
    },
    /// Diagonal stripes of the surface's colour and black, as on moving machines.
    Hazard,
    /// Fine grain, as of a casting or sprayed paint.
    Grain,
}

impl Finish {
    pub(crate) fn new(color: [u8; 3], gloss: f32) -> Self {
        Self { albedo: linear(Color(color)), gloss, transparency: 0.0, pattern: Pattern::Plain }
    }

    pub(crate) fn with(mut self, pattern: Pattern) -> Self {
        self.pattern = pattern;
        self
    }

    /// Colour of the light that has passed through a transparent body.
    pub(crate) fn tint(&self) -> Vector3<f32> {
        Vector3::repeat(1.0).lerp(&self.albedo, 0.35)
    }

    /// Reflectances and gloss at a point in the body's frame. A pixel covers `footprint` metres there.
    pub(crate) fn at(&self, p: &Vector3<f32>, footprint: f32) -> (Vector3<f32>, f32) {
        match self.pattern {
            Pattern::Plain => (self.albedo, self.gloss),
            Pattern::Table { material, marker } => self.table(material, marker, p, footprint),
            Pattern::Hazard => {
                let width = 0.028;
                let phase = ((p.x + p.y + p.z) / width).rem_euclid(1.0);
                let edge = (0.5 * footprint / width).clamp(0.02, 0.25);
                let black = smooth((phase - 0.5 + edge) / (2.0 * edge)) * smooth((1.0 - phase) / edge);
                (self.albedo * (1.0 - 0.94 * black), self.gloss)
            }
            Pattern::Grain => {
                let fade = (0.003 / footprint.max(1e-4)).min(1.0);
                let grain = table::noise3(p * 700.0) - 0.5;
                (self.albedo * (1.0 + 0.1 * fade * grain), self.gloss)
            }
        }
    }

    fn table(
        &self,
        material: TableMaterial,
        marker: Option<[f32; 2]>,
        p: &Vector3<f32>,
        footprint: f32,
    ) -> (Vector3<f32>, f32) {
        let texture = Texture::of(material);
        if p.z < 0.0 {
            return (texture.edge, 0.2);
        }
        let top = texture.at(p.x, p.y, footprint);
        let Some(marker) = marker else { return (top, self.gloss) };
        let off = ((p.x - marker[0]).powi(2) + (p.y - marker[1]).powi(2)).sqrt();
        if off > MARK + footprint {
            return (top, self.gloss);
        }
        // Each line keeps its width and is blurred over the size of a pixel.
        let blur = footprint.max(5e-4);
        let inside = |radius: f32| smooth((radius - off) / blur + 0.5);
        let ring = |outer: f32, inner: f32| inside(outer) * (1.0 - inside(inner));
        let bar = (p.x - marker[0]).abs().min((p.y - marker[1]).abs());
        let cross = inside(0.022) * smooth((0.0035 - bar) / blur + 0.5);
        let green = (ring(0.058, 0.042) + cross).min(1.0);
        let white = Vector3::repeat(0.8);
        let ground = top + (white - top) * inside(MARK);
        (ground + (Vector3::new(0.02, 0.26, 0.12) - ground) * green, self.gloss + (0.15 - self.gloss) * inside(MARK))
    }
}

/// Radius of the marker, in metres.
pub(crate) const MARK: f32 = 0.066;

/// A smooth step from 0 at 0 to 1 at 1 (cubic Hermite).
pub(crate) fn smooth(x: f32) -> f32 {
    let x = x.clamp(0.0, 1.0);
    x * x * (3.0 - 2.0 * x)
}
