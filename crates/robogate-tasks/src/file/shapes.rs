//! Reads the shapes of a body, and the mass of a part.

use robogate_physics::{Part, Primitive};

use super::document::{PartTable, ShapeTable, Text};
use super::model::Reading;
use super::units::{Dimension, quantities};

impl Reading<'_, '_> {
    fn shape(&mut self, shape: &ShapeTable, owner: &Text) -> Option<Vec<Part>> {
        let pose = self.placed(shape.at.as_ref(), shape.rotation.as_ref()).pose();
        if shape.mesh.is_none() {
            let of_mesh = [&shape.unit, &shape.scale, &shape.pieces].into_iter().flatten().next();
            if let Some(text) = of_mesh {
                self.problems
                    .of(text, "`unit`, `scale` and `pieces` are keys of a mesh. Leave it out, or name a `mesh`");
            }
        }
        let (text, primitive) = match (&shape.cuboid, &shape.cylinder, &shape.sphere, &shape.mesh) {
            (None, None, None, Some(name)) => {
                let mut pieces = self.mesh(shape, name)?;
                pieces.iter_mut().for_each(|piece| piece.pose = pose * piece.pose);
                return Some(pieces);
            }
            (Some(text), None, None, None) => {
                let edges: [f64; 3] = self.problems.take(text, quantities(&text.text, Dimension::LENGTH))?;
                (text, Primitive::Box { half: edges.map(|edge| 0.5 * edge) })
            }
            (None, Some(text), None, None) => {
                let [diameter, height] = self.problems.take(text, quantities(&text.text, Dimension::LENGTH))?;
                (text, Primitive::Cylinder { radius: 0.5 * diameter, half_height: 0.5 * height })
            }
            (None, None, Some(text), None) => {
                let [diameter] = self.problems.take(text, quantities(&text.text, Dimension::LENGTH))?;
                (text, Primitive::Sphere { radius: 0.5 * diameter })
            }
            _ => {
                self.problems
                    .of(owner, "a shape of this body needs exactly one of `box`, `cylinder`, `sphere` and `mesh`");
                return None;
            }
        };
        if primitive.half_extent().iter().any(|half| !(5e-4..=2.5).contains(half)) {
            self.problems.of(text, format!("`{}` is out of range. Expected 1 mm to 5 m", text.text));
        }
        Some(vec![Part { primitive, pose }])
    }

    pub(super) fn shapes(&mut self, shapes: &[ShapeTable], owner: &Text) -> Vec<Part> {
        if shapes.is_empty() {
            self.problems.of(owner, format!("`{}` has no shapes. Expected at least one", owner.text));
        }
        shapes.iter().filter_map(|shape| self.shape(shape, owner)).flatten().collect()
    }

    /// The mass of a part, which may follow from its density.
    pub(super) fn mass(&mut self, table: &PartTable, shapes: &[Part]) -> f64 {
        const KG: [f64; 2] = [1e-3, 100.0];
        match (&table.mass, &table.density) {
            (Some(mass), None) => self.number(mass, Dimension::MASS, KG).unwrap_or(1.0),
            (None, Some(text)) => {
                let volume: f64 = shapes.iter().map(|shape| shape.primitive.volume()).sum();
                let Some(density) = self.number(text, Dimension::DENSITY, [1.0, 3e4]) else { return 1.0 };
                let mass_kg = density * volume;
                if !shapes.is_empty() && !(KG[0]..=KG[1]).contains(&mass_kg) {
                    let why = format!("the mass that follows is {mass_kg:.2e} kg. Expected {} to {} kg", KG[0], KG[1]);
                    self.problems.of(text, why);
                }
                mass_kg
            }
            _ => {
                let why = format!("`{}` needs either `mass` or `density`", table.name.text);
                self.problems.of(&table.name, why);
                1.0
            }
        }
    }
}

/// The lowest and the highest point of shapes in the frame of their body, in metres.
pub(super) fn heights<'a>(shapes: impl Iterator<Item = &'a Part>) -> [f64; 2] {
    let of = |part: &Part| {
        let up = part.pose.rotation.to_rotation_matrix().matrix().row(2).transpose();
        part.primitive.extent(&up).map(|end| part.pose.translation.z + end)
    };
    shapes
        .map(of)
        .fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], [bottom, top]| [low.min(bottom), high.max(top)])
}
