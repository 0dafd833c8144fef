//! Mounts of the two cameras, for all renderers.

use nalgebra::{Isometry3, Point3, Vector3};
use robogate_physics::{Gripper, WORKSPACE_CENTRE};

use crate::Pinhole;

/// Nominal pose of the front camera, beyond the table and looking back at the workspace: its position and the point
/// that it looks at, in metres in the base frame.
pub const FRONT_CAMERA: ([f64; 3], [f64; 3]) = ([1.25, 0.0, 0.55], [0.5, 0.0, 0.05]);

/// Fields of view of the front and the wrist camera, in radians.
const FIELD_OF_VIEW_RAD: [f64; 2] = [70.0 * RADIANS, 75.0 * RADIANS];
const RADIANS: f64 = std::f64::consts::PI / 180.0;

/// The cameras' mounts: the front camera is fixed in the room, the wrist camera moves with the hand.
#[derive(Debug)]
pub(crate) struct Mounts {
    /// Nominal pose of the wrist camera in the frame of the tool centre point.
    wrist: Isometry3<f64>,
}

impl Mounts {
    /// Creates the mounts for this gripper. `waiting` is the pose of the tool centre point with the arm at home.
    pub(crate) fn new(gripper: &Gripper, waiting: &Isometry3<f64>) -> Self {
        let behind = match gripper {
            Gripper::ParallelJaw(jaw) => jaw.palm_m + 0.035,
            Gripper::Suction(_) => 0.09,
        };
        // Mounted next to the hand, perpendicular to the tool's y axis, along which the fingers close. The hand is in
        // the lower part of the image.
        let mounted = |side: f64| {
            let from = Point3::new(side * 0.1, 0.0, -behind);
            Pinhole::looking(from, Point3::new(0.0, 0.0, 0.02), &(Vector3::x() * side))
        };
        // On the side from which it looks towards the workspace, not back at the robot, with the arm at home.
        let [x, y] = WORKSPACE_CENTRE;
        let ahead = Vector3::new(x, y, 0.0) - waiting.translation.vector;
        let sight = waiting.rotation * (mounted(1.0).rotation * Vector3::z());
        let side = if sight.xy().dot(&ahead.xy()) >= 0.0 { 1.0 } else { -1.0 };
        Self { wrist: mounted(side) }
    }

    /// The front camera at `front`, and the wrist camera for the tool pose `tool`, with the same roll and pitch from its
    /// nominal pose as the front camera.
    pub(crate) fn pinholes(
        &self,
        front: &Isometry3<f64>,
        tool: &Isometry3<f64>,
        [width, height]: [usize; 2],
    ) -> [Pinhole; 2] {
        let [roll, pitch] = Pinhole::turn_between(&front_pose(), front);
        let wrist = tool * Pinhole::turned(&self.wrist, roll, pitch);
        let camera = |pose, field_of_view_rad| Pinhole { pose, field_of_view_rad, width, height };
        [camera(*front, FIELD_OF_VIEW_RAD[0]), camera(wrist, FIELD_OF_VIEW_RAD[1])]
    }
}

/// Nominal pose of the front camera.
pub(crate) fn front_pose() -> Isometry3<f64> {
    let (from, at) = FRONT_CAMERA;
    Pinhole::looking(Point3::from(from), Point3::from(at), &Vector3::z())
}
