//! The occluders: panels between the object and the front camera.

use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};
use robogate_camera::FRONT_CAMERA;
use robogate_physics::{Fixture, FixtureKind, Part, Primitive};

/// Half extents of a panel, in metres: 1 cm thick, 1.5 cm wide and 16 cm high. A lower panel would not hide the
/// object's centre.
const HALF: [f64; 3] = [0.005, 0.0075, 0.08];

/// Distance from the object's centre to the panels, in metres. A hand that comes from above clears them at any yaw.
const DISTANCE: f64 = 0.15;

/// Distance between the centres of two panels, in metres.
const SPACING: f64 = 0.017;

/// Creates `count` panels side by side across the front camera's line of sight to an object at `object` (m). One panel
/// hides a third of an object that is 5 cm wide, two hide three quarters and three hide nearly all.
pub(crate) fn panels(count: usize, object: [f64; 2]) -> Vec<Fixture> {
    let (camera, _) = FRONT_CAMERA;
    let bearing = (camera[1] - object[1]).atan2(camera[0] - object[0]);
    let rotation = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), bearing);
    let panel = |i: usize| {
        let aside = (i as f64 - 0.5 * (count as f64 - 1.0)) * SPACING;
        let at = rotation * Vector3::new(DISTANCE, aside, 0.0) + Vector3::new(object[0], object[1], HALF[2]);
        let part = Part {
            primitive: Primitive::Box { half: HALF },
            pose: Isometry3::from_parts(Translation3::from(at), rotation),
        };
        Fixture {
            name: format!("occluder_{}", i + 1),
            kind: FixtureKind::Occluder,
            part,
            motion: None,
            friction: None,
            color: None,
        }
    };
    (0..count).map(panel).collect()
}

/// The circles on the table that the panels occupy: centre and radius, in metres.
pub(crate) fn footprints(panels: &[Fixture]) -> impl Iterator<Item = ([f64; 2], f64)> {
    panels.iter().map(|panel| {
        let at = panel.part.pose.translation;
        ([at.x, at.y], HALF[0].hypot(HALF[1]))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Fraction of the width of a 5 cm object, at half its height, that panels hide from the front camera.
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
    fn each_panel_hides_more() {
        for object in [[0.5, 0.0], [0.5, 0.15], [0.62, -0.1]] {
            for (count, share) in [(0, 0.0), (1, 0.375), (2, 0.75), (3, 0.9)] {
                assert!((hidden(count, object) - share).abs() < 0.08, "{count}: {}", hidden(count, object));
            }
        }
    }
}
