//! Panels that stand in the front camera's view of the object.

use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};

use crate::scene::{Fixture, FixtureKind};
use crate::visual::FRONT_CAMERA;
use crate::{Part, Primitive};

/// Half extents of a panel, in metres: 1 cm thick, 1.5 cm wide and 16 cm high. The camera sees the object's middle
/// over anything lower.
const HALF: [f64; 3] = [0.005, 0.0075, 0.08];

/// From the object's centre to the panels, in metres: a hand that comes from above clears them, whichever way
/// it is turned.
const DISTANCE: f64 = 0.15;

/// From one panel's middle to the next, in metres.
const SPACING: f64 = 0.017;

/// `count` panels side by side across the front camera's line of sight to an object at `object` (m). Of one
/// 5 cm wide, one panel hides a third, two hide three quarters and three nearly all.
pub(crate) fn panels(count: usize, object: [f64; 2]) -> Vec<Fixture> {
    let (camera, _) = FRONT_CAMERA;
    let bearing = (camera[1] - object[1]).atan2(camera[0] - object[0]);
    let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), bearing);
    let panel = |i: usize| {
        let aside = (i as f64 - 0.5 * (count as f64 - 1.0)) * SPACING;
        let at = turn * Vector3::new(DISTANCE, aside, 0.0) + Vector3::new(object[0], object[1], HALF[2]);
        let part = Part {
            primitive: Primitive::Box { half: HALF },
            pose: Isometry3::from_parts(Translation3::from(at), turn),
        };
        Fixture { name: format!("occluder_{}", i + 1), kind: FixtureKind::Occluder, part, motion: None }
    };
    (0..count).map(panel).collect()
}

/// The circles on the table that they need: centre and radius, in metres.
pub(crate) fn footprints(panels: &[Fixture]) -> impl Iterator<Item = ([f64; 2], f64)> {
    panels.iter().map(|panel| {
        let at = panel.part.pose.translation;
        ([at.x, at.y], HALF[0].hypot(HALF[1]))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Share of a 5 cm object's width, at its middle's height, that panels hide from the front camera.
    fn hidden(count: usize, object: [f64; 2]) -> f64 {
        let panels = panels(count, object);
        let ([x, y, z], _) = FRONT_CAMERA;
        let camera = nalgebra::Point3::new(x, y, z);
        let bearing = (y - object[1]).atan2(x - object[0]);
        let across = Vector3::new(-bearing.sin(), bearing.cos(), 0.0);
        let samples = 500;
        let blocked = (0..samples).filter(|i| {
            let aside = 0.05 * ((f64::from(*i) + 0.5) / f64::from(samples) - 0.5);
            let point = nalgebra::Point3::new(object[0], object[1], 0.025) + across * aside;
            panels.iter().any(|panel| {
                (0..400).any(|k| {
                    let on_ray = point + (camera - point) * (f64::from(k) / 400.0);
                    let local = panel.part.pose.inverse_transform_point(&on_ray);
                    local.coords.iter().zip(HALF).all(|(x, half)| x.abs() <= half)
                })
            })
        });
        blocked.count() as f64 / f64::from(samples)
    }

    #[test]
    fn one_hides_a_third_two_three_quarters_and_three_nearly_all() {
        for object in [[0.5, 0.0], [0.5, 0.15], [0.62, -0.1]] {
            for (count, share) in [(0, 0.0), (1, 0.375), (2, 0.75), (3, 0.9)] {
                assert!((hidden(count, object) - share).abs() < 0.08, "{count}: {}", hidden(count, object));
            }
        }
    }
}
