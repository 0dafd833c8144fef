//! Reads the shapes of a body, and the mass of a part.

use nalgebra::{Isometry3, Matrix3, Translation3, Vector3};
use robogate_physics::{MassProperties, Part, Primitive};

use super::document::{PartTable, ShapeTable, Text};
use super::model::Reading;
use super::units::{Dimension, quantities};

/// The range of masses of parts, and of densities.
const KG: [f64; 2] = [1e-3, 100.0];
const DENSITIES: [f64; 2] = [1.0, 3e4];

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
        let stated = (&shape.cuboid, &shape.cylinder, &shape.sphere, &shape.mesh, &shape.capsule);
        let (text, primitive) = match stated {
            (None, None, None, None, Some(text)) => return self.capsule(text, pose),
            (None, None, None, Some(name), None) => {
                let mut pieces = self.mesh(shape, name)?;
                pieces.iter_mut().for_each(|piece| piece.pose = pose * piece.pose);
                return Some(pieces);
            }
            (Some(text), None, None, None, None) => {
                let edges: [f64; 3] = self.problems.take(text, quantities(&text.text, Dimension::LENGTH))?;
                (text, Primitive::Box { half: edges.map(|edge| 0.5 * edge) })
            }
            (None, Some(text), None, None, None) => {
                let [diameter, height] = self.problems.take(text, quantities(&text.text, Dimension::LENGTH))?;
                (text, Primitive::Cylinder { radius: 0.5 * diameter, half_height: 0.5 * height })
            }
            (None, None, Some(text), None, None) => {
                let [diameter] = self.problems.take(text, quantities(&text.text, Dimension::LENGTH))?;
                (text, Primitive::Sphere { radius: 0.5 * diameter })
            }
            _ => {
                let one = "a shape of this body needs exactly one of `box`, `cylinder`, `capsule`, `sphere` and `mesh`";
                self.problems.of(owner, one);
                return None;
            }
        };
        if primitive.half_extent().iter().any(|half| !(5e-4..=2.5).contains(half)) {
            self.problems.of(text, format!("`{}` is out of range. Expected 1 mm to 5 m", text.text));
        }
        Some(vec![Part { primitive, pose }])
    }

    /// A capsule is a cylinder between two balls.
    fn capsule(&mut self, text: &Text, pose: Isometry3<f64>) -> Option<Vec<Part>> {
        let [diameter, length] = self.problems.take(text, quantities(&text.text, Dimension::LENGTH))?;
        if !(1e-3..=5.0).contains(&diameter) || !(1e-3..=5.0).contains(&length) {
            self.problems.of(text, format!("`{}` is out of range. Expected 1 mm to 5 m", text.text));
        }
        let (radius, half_height) = (0.5 * diameter, 0.5 * length);
        let ball =
            |z: f64| Part { primitive: Primitive::Sphere { radius }, pose: pose * Translation3::new(0.0, 0.0, z) };
        let cylinder = Part { primitive: Primitive::Cylinder { radius, half_height }, pose };
        Some(vec![cylinder, ball(half_height), ball(-half_height)])
    }

    /// The convex shapes of each shape of a body.
    pub(super) fn shapes(&mut self, shapes: &[ShapeTable], owner: &Text) -> Vec<Vec<Part>> {
        if shapes.is_empty() {
            self.problems.of(owner, format!("`{}` has no shapes. Expected at least one", owner.text));
        }
        shapes.iter().map(|shape| self.shape(shape, owner).unwrap_or_default()).collect()
    }

    /// The mass of a part, which may follow from its density, and how it is spread unless it has homogeneous shapes.
    pub(super) fn mass(&mut self, table: &PartTable, shapes: &[Vec<Part>]) -> (f64, Option<MassProperties>) {
        let of_shapes: Vec<_> = table.shapes.iter().map(|shape| (&shape.mass, &shape.density)).collect();
        let bodies = || table.shapes.iter().zip(shapes);
        let mass_kg = match (&table.mass, &table.density) {
            (Some(mass), None) => self.number(mass, Dimension::MASS, KG).unwrap_or(1.0),
            (None, Some(text)) => {
                let Some(density) = self.number(text, Dimension::DENSITY, DENSITIES) else { return (1.0, None) };
                let mass_kg = density * bodies().map(|(shape, parts)| volume(shape, parts)).sum::<f64>();
                if !shapes.is_empty() && !(KG[0]..=KG[1]).contains(&mass_kg) {
                    let why = format!("the mass that follows is {mass_kg:.2e} kg. Expected {} to {} kg", KG[0], KG[1]);
                    self.problems.of(text, why);
                }
                mass_kg
            }
            (None, None) if of_shapes.iter().any(|(mass, density)| mass.is_some() || density.is_some()) => {
                let of: Vec<_> = bodies().map(|(shape, parts)| self.mass_of_shape(shape, parts)).collect();
                let of = MassProperties::together(&of);
                if !(KG[0]..=KG[1]).contains(&of.mass_kg) {
                    let why = format!(
                        "the mass of `{}` is {:.2e} kg. Expected {} to {} kg",
                        table.name.text, of.mass_kg, KG[0], KG[1]
                    );
                    self.problems.of(&table.name, why);
                    return (1.0, None);
                }
                return (of.mass_kg, self.stated_inertia(table, of.mass_kg).or(Some(of)));
            }
            _ => {
                let why = format!("`{}` needs either `mass` or `density`", table.name.text);
                self.problems.of(&table.name, why);
                1.0
            }
        };
        if let Some(text) = of_shapes.iter().flat_map(|(mass, density)| [*mass, *density]).flatten().next() {
            self.problems.of(text, "the part states its mass, so its shapes have none. Leave one of them out");
        }
        // Several primitives stand for one capsule.
        let capsules = table.shapes.iter().any(|shape| shape.capsule.is_some());
        let total: f64 = bodies().map(|(shape, parts)| volume(shape, parts)).sum();
        let even = capsules.then(|| {
            let of = bodies().map(|(shape, parts)| spread(shape, parts, mass_kg * volume(shape, parts) / total));
            MassProperties::together(&of.collect::<Vec<_>>())
        });
        (mass_kg, self.stated_inertia(table, mass_kg).or(even))
    }

    fn mass_of_shape(&mut self, shape: &ShapeTable, parts: &[Part]) -> MassProperties {
        let mass_kg = match (&shape.mass, &shape.density) {
            (Some(mass), None) => self.number(mass, Dimension::MASS, [0.0, KG[1]]),
            (None, Some(text)) => {
                let density = self.number(text, Dimension::DENSITY, [0.0, DENSITIES[1]]);
                density.map(|density| density * volume(shape, parts))
            }
            (Some(text), Some(_)) => {
                self.problems.of(text, "a shape has either `mass` or `density`");
                None
            }
            (None, None) => Some(0.0),
        };
        spread(shape, parts, mass_kg.unwrap_or(1.0))
    }

    fn stated_inertia(&mut self, table: &PartTable, mass_kg: f64) -> Option<MassProperties> {
        let Some(text) = &table.inertia else {
            if let Some(centre) = &table.centre {
                self.problems.of(centre, "`centre` needs `inertia`. State both, or none");
            }
            return None;
        };
        let [xx, yy, zz, xy, xz, yz] = self.problems.take(text, quantities(&text.text, Dimension::INERTIA))?;
        let inertia = Matrix3::new(xx, xy, xz, xy, yy, yz, xz, yz, zz);
        let moments = inertia.symmetric_eigenvalues();
        let (least, most) = (moments.min(), moments.max());
        // No moment of inertia of a body exceeds the sum of the two others.
        if !(least > 0.0 && 2.0 * most <= moments.sum() * (1.0 + 1e-6)) {
            let why = format!(
                "no body has the moments of inertia of `{}`: each is above 0 and at most the sum of the others",
                text.text
            );
            self.problems.of(text, why);
            return None;
        }
        Some(MassProperties { mass_kg, centre: self.triple(table.centre.as_ref(), Dimension::LENGTH).into(), inertia })
    }
}

/// The volume of a shape, in cubic metres.
fn volume(shape: &ShapeTable, parts: &[Part]) -> f64 {
    let all = parts.iter().map(|part| part.primitive.volume());
    // The two half balls at the ends of a capsule are one ball.
    if shape.capsule.is_some() { all.take(2).sum() } else { all.sum() }
}

/// How the mass of a homogeneous shape is spread.
fn spread(shape: &ShapeTable, parts: &[Part], mass_kg: f64) -> MassProperties {
    if mass_kg <= 0.0 || parts.is_empty() {
        return MassProperties { mass_kg: 0.0, centre: Vector3::zeros(), inertia: Matrix3::zeros() };
    }
    match parts {
        [Part { primitive: Primitive::Cylinder { radius, half_height }, pose }, ..] if shape.capsule.is_some() => {
            MassProperties::capsule(pose, *radius, *half_height, mass_kg)
        }
        _ => MassProperties::homogeneous(parts, mass_kg),
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
