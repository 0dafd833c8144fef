//! Mass properties of bodies made of primitives.

use nalgebra::{Matrix3, Point3, Vector3};
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
}
