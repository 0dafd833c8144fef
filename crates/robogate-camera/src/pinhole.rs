//! The pinhole model of a camera.

use nalgebra::{Isometry3, Matrix3, Point3, Rotation3, UnitQuaternion, Vector3};

/// A camera without distortion, with square pixels and its principal point at the centre of the image.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pinhole {
    /// Pose in the base frame: x to the right of the image, y down, z along the line of sight.
    pub pose: Isometry3<f64>,
    /// Vertical field of view, in radians.
    pub field_of_view_rad: f64,
    /// Width in pixels.
    pub width: usize,
    /// Height in pixels.
    pub height: usize,
}

impl Pinhole {
    /// Pose of an upright camera at `from` that looks at `at` (m). `up` points up in the image and must not be parallel
    /// to the line of sight.
    pub fn looking(from: Point3<f64>, at: Point3<f64>, up: &Vector3<f64>) -> Isometry3<f64> {
        let forward = (at - from).normalize();
        let right = forward.cross(up).normalize();
        let down = forward.cross(&right);
        let rotation = Rotation3::from_matrix_unchecked(Matrix3::from_columns(&[right, down, forward]));
        Isometry3::from_parts(from.into(), UnitQuaternion::from_rotation_matrix(&rotation))
    }

    /// A camera pose rotated about the line of sight by `roll` (positive: clockwise as seen from behind the camera), then
    /// tilted up by `pitch`, in radians.
    pub fn turned(pose: &Isometry3<f64>, roll_rad: f64, pitch_rad: f64) -> Isometry3<f64> {
        pose * UnitQuaternion::from_axis_angle(&Vector3::x_axis(), pitch_rad)
            * UnitQuaternion::from_axis_angle(&Vector3::z_axis(), roll_rad)
    }

    /// Roll and pitch from `pose` to `turned`, in radians: the inverse of [`Self::turned`].
    pub fn turn_between(pose: &Isometry3<f64>, turned: &Isometry3<f64>) -> [f64; 2] {
        let off = (pose.rotation.inverse() * turned.rotation).to_rotation_matrix();
        [(-off[(0, 1)]).atan2(off[(0, 0)]), (-off[(1, 2)]).atan2(off[(2, 2)])]
    }

    /// Focal length in pixels.
    pub fn focal_px(&self) -> f64 {
        0.5 * self.height as f64 / (0.5 * self.field_of_view_rad).tan()
    }

    /// Projects a point of the base frame: pixels from the left edge, pixels from the upper edge, and depth along the line
    /// of sight in metres. The centre of the first pixel is at (0.5, 0.5). `None` for a point behind the camera.
    pub fn project(&self, point: &Point3<f64>) -> Option<[f64; 3]> {
        let local = self.pose.inverse_transform_point(point);
        let focal = self.focal_px();
        let [across, down] = [0.5 * self.width as f64, 0.5 * self.height as f64];
        (local.z > 0.0).then(|| [across + focal * local.x / local.z, down + focal * local.y / local.z, local.z])
    }

    /// The point in the base frame at this position in the image (pixels) and depth (m).
    pub fn point(&self, [u, v]: [f64; 2], depth: f64) -> Point3<f64> {
        let focal = self.focal_px();
        let x = (u - 0.5 * self.width as f64) / focal;
        let y = (v - 0.5 * self.height as f64) / focal;
        self.pose * Point3::new(x * depth, y * depth, depth)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn camera() -> Pinhole {
        let pose = Pinhole::looking(Point3::new(1.25, 0.0, 0.55), Point3::new(0.5, 0.0, 0.05), &Vector3::z());
        Pinhole { pose, field_of_view_rad: 1.2, width: 320, height: 200 }
    }

    #[test]
    fn upright_camera_shows_up_as_up() {
        let camera = camera();
        let [u, v, depth] = camera.project(&Point3::new(0.5, 0.0, 0.05)).unwrap();
        assert!((u - 160.0).abs() < 1e-9 && (v - 100.0).abs() < 1e-9);
        assert!((depth - 0.75_f64.hypot(0.5)).abs() < 1e-12);
        assert!(camera.project(&Point3::new(0.5, 0.0, 0.15)).unwrap()[1] < 100.0);
        // The camera looks back at the robot, so the robot's left, +y, is on the right of the image.
        assert!(camera.project(&Point3::new(0.5, 0.1, 0.05)).unwrap()[0] > 160.0);
        assert_eq!(camera.project(&Point3::new(2.0, 0.0, 1.0)), None);
    }

    #[test]
    fn field_of_view_spans_the_height() {
        let camera = camera();
        let at_edge = camera.pose * Point3::new(0.0, -0.6_f64.tan() * 2.0, 2.0);
        assert!(camera.project(&at_edge).unwrap()[1].abs() < 1e-9);
    }

    #[test]
    fn projection_can_be_inverted() {
        let camera = camera();
        let point = Point3::new(0.31, -0.2, 0.12);
        let [u, v, depth] = camera.project(&point).unwrap();
        assert!((camera.point([u, v], depth) - point).norm() < 1e-12);
    }

    #[test]
    fn roll_and_pitch_round_trip() {
        let pose = camera().pose;
        for (roll, pitch) in [(0.0, 0.0), (0.2, -0.1), (-0.5, 0.5), (0.01, 0.3)] {
            let off = Pinhole::turn_between(&pose, &Pinhole::turned(&pose, roll, pitch));
            assert!((off[0] - roll).abs() < 1e-12 && (off[1] - pitch).abs() < 1e-12, "{off:?}");
        }
        let up = Pinhole { pose: Pinhole::turned(&pose, 0.0, 0.1), ..camera() };
        // The point at the image centre is now below it.
        assert!(up.project(&Point3::new(0.5, 0.0, 0.05)).unwrap()[1] > 100.0);
        let clockwise = Pinhole { pose: Pinhole::turned(&pose, 0.1, 0.0), ..camera() };
        // The camera rotates clockwise, so points to its right move up.
        assert!(clockwise.project(&Point3::new(0.5, 0.1, 0.05)).unwrap()[1] < 100.0);
    }
}
