//! What surfaces look like from close by.

use nalgebra::Vector3;

use crate::camera::light::linear;
use crate::camera::table::{self, Texture};
use crate::{Color, TableMaterial};

/// A surface's own look.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Finish {
    /// Share of red, green and blue light that it reflects.
    pub(crate) albedo: Vector3<f32>,
    /// How strongly it mirrors lamp and surroundings: 0 is matt, 1 is varnish.
    pub(crate) gloss: f32,
    /// Share of the light that goes through.
    pub(crate) transparency: f64,
    pub(crate) pattern: Pattern,
}

/// What varies over a surface.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Pattern {
    Plain,
    /// The table's top, with the mark at the target (m).
    Table {
        material: TableMaterial,
        target: [f32; 2],
    },
    /// Slanted stripes, yellow and black: something moves here.
    Hazard,
    /// Fine grain, as of a casting or of sprayed paint.
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

    /// What a clear body leaves of the light that goes through it.
    pub(crate) fn tint(&self) -> Vector3<f32> {
        Vector3::repeat(1.0).lerp(&self.albedo, 0.35)
    }

    /// Reflectances and gloss at a point of the body's frame, of which a pixel covers `footprint` metres.
    pub(crate) fn at(&self, p: &Vector3<f32>, footprint: f32) -> (Vector3<f32>, f32) {
        match self.pattern {
            Pattern::Plain => (self.albedo, self.gloss),
            Pattern::Table { material, target } => self.table(material, target, p, footprint),
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
        target: [f32; 2],
        p: &Vector3<f32>,
        footprint: f32,
    ) -> (Vector3<f32>, f32) {
        let texture = Texture::of(material);
        if p.z < 0.0 {
            return (texture.edge, 0.2);
        }
        let top = texture.at(p.x, p.y, footprint);
        let off = ((p.x - target[0]).powi(2) + (p.y - target[1]).powi(2)).sqrt();
        if off > MARK + footprint {
            return (top, self.gloss);
        }
        // Each line of the mark as wide as it is, blurred by what a pixel covers.
        let blur = footprint.max(5e-4);
        let inside = |radius: f32| smooth((radius - off) / blur + 0.5);
        let ring = |outer: f32, inner: f32| inside(outer) * (1.0 - inside(inner));
        let bar = (p.x - target[0]).abs().min((p.y - target[1]).abs());
        let cross = inside(0.022) * smooth((0.0035 - bar) / blur + 0.5);
        let green = (ring(0.058, 0.042) + cross).min(1.0);
        let white = Vector3::repeat(0.8);
        let ground = top + (white - top) * inside(MARK);
        (ground + (Vector3::new(0.02, 0.26, 0.12) - ground) * green, self.gloss + (0.15 - self.gloss) * inside(MARK))
    }
}

/// Radius of the mark at the target, in metres.
const MARK: f32 = 0.066;

/// From 0 at 0 to 1 at 1, without a kink.
pub(crate) fn smooth(x: f32) -> f32 {
    let x = x.clamp(0.0, 1.0);
    x * x * (3.0 - 2.0 * x)
}
