//! Mass properties of bodies made of primitives.

use nalgebra::{Isometry3, Matrix3, Point3, Vector3};
use serde::{Deserialize, Serialize};

use crate::{Part, plain};

/// Mass, centre of mass and inertia of a rigid body, in its own frame.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct MassProperties {
    /// Mass in kilograms.
    pub mass_kg: f64,
    /// Centre of mass, in metres.
    #[serde(rename = "centre_of_mass", with = "plain")]
    pub centre: Vector3<f64>,
    /// Inertia about the centre of mass along the body's axes, in kg m^2.
    #[serde(rename = "inertia_kg_m2", with = "plain")]
    pub inertia: Matrix3<f64>,
}

impl MassProperties {
    /// Mass properties of parts with the same density and a total mass of `mass_kg`.
    pub fn homogeneous(parts: &[Part], mass_kg: f64) -> Self {
        Self::with_ballast(parts, mass_kg, 0.0, Vector3::zeros())
    }

    /// Mass properties of a body with a point mass: the fraction `share` of the mass is at `at` (m, in the body's
    /// frame), and the parts share the rest by volume.
    ///
    /// The inertia is exact for parts and point together (parallel axes).
    pub fn with_ballast(parts: &[Part], mass_kg: f64, share: f64, at: Vector3<f64>) -> Self {
        let volume: f64 = parts.iter().map(|part| part.primitive.volume()).sum();
        let mut masses: Vec<(f64, Vector3<f64>, Matrix3<f64>)> = parts
            .iter()
            .map(|part| {
                let mass = mass_kg * (1.0 - share) * part.primitive.volume() / volume;
                let rotation = part.pose.rotation.to_rotation_matrix().into_inner();
                let (centre, inertia) = part.primitive.unit_mass();
                let own = rotation * (inertia * mass) * rotation.transpose();
                (mass, (part.pose * Point3::from(centre)).coords, own)
            })
            .collect();
        masses.push((mass_kg * share, at, Matrix3::zeros()));
        let centre = masses.iter().map(|(mass, at, _)| at * *mass).sum::<Vector3<f64>>() / mass_kg;
        let inertia = masses
            .iter()
            .map(|(mass, at, own)| {
                let arm = at - centre;
                own + (Matrix3::identity() * arm.norm_squared() - arm * arm.transpose()) * *mass
            })
            .sum();
        Self { mass_kg, centre, inertia }
    }

    /// Mass properties of several bodies together that are fixed to each other, in their common frame (parallel axes).
    pub fn together(bodies: &[Self]) -> Self {
        let mass_kg = bodies.iter().map(|body| body.mass_kg).sum::<f64>();
        let centre = bodies.iter().map(|body| body.centre * body.mass_kg).sum::<Vector3<f64>>() / mass_kg;
        let inertia = bodies.iter().map(|body| {
            let arm = body.centre - centre;
            body.inertia + (Matrix3::identity() * arm.norm_squared() - arm * arm.transpose()) * body.mass_kg
        });
        Self { mass_kg, centre, inertia: inertia.sum() }
    }

    /// The same body of another density, with this mass.
    #[must_use]
    pub fn with_mass(self, mass_kg: f64) -> Self {
        Self { mass_kg, inertia: self.inertia * (mass_kg / self.mass_kg), ..self }
    }

    /// A homogeneous capsule along the z axis of a pose: a cylinder between two half balls of this radius (m).
    pub fn capsule(pose: &Isometry3<f64>, radius: f64, half_length: f64, mass_kg: f64) -> Self {
        let (r, h) = (radius, half_length);
        // Volumes as multiples of pi r^2.
        let (cylinder, ball) = (2.0 * h, 4.0 / 3.0 * r);
        let [cylinder, ball] = [cylinder, ball].map(|part| mass_kg * part / (cylinder + ball));
        let across = cylinder * (r * r / 4.0 + h * h / 3.0) + ball * (0.4 * r * r + h * h + 0.75 * h * r);
        let along = cylinder * r * r / 2.0 + ball * 0.4 * r * r;
        let rotation = pose.rotation.to_rotation_matrix().into_inner();
        let inertia = rotation * Matrix3::from_diagonal(&Vector3::new(across, across, along)) * rotation.transpose();
        Self { mass_kg, centre: pose.translation.vector, inertia }
    }
}
