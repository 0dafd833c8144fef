//! Nominal placements of the object.

use robogate_core::Pose;
use robogate_physics::WORKSPACE_CENTRE;

/// Nominal position and yaw of the object.
///
/// A placement's name is a place and an angle in degrees, `edge_45`:
///
/// | place | position of the object's centre |
/// |---|---|
/// | `center` | at the workspace centre, 0.5 m in front of the base |
/// | `edge` | 0.12 m farther out, at the far edge of the workspace |
/// | `left`, `right` | 0.15 m to the robot's left (+y), right (-y) |
/// | `rotated` | 0.10 m from the centre, in the direction of the angle |
///
/// The angle rotates the object about the vertical. For `rotated`, object and place rotate together.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Placement {
    /// Horizontal position of the object's centre, in metres.
    pub position: [f64; 2],
    /// Rotation of the object about the vertical, in radians.
    pub yaw: f64,
}

impl Placement {
    /// The 14 placements of the released dictionaries.
    pub const NAMES: [&'static str; 14] = [
        "center_0",
        "center_45",
        "center_90",
        "edge_0",
        "edge_45",
        "edge_90",
        "left_0",
        "left_45",
        "right_0",
        "right_45",
        "rotated_0",
        "rotated_45",
        "rotated_90",
        "rotated_135",
    ];

    /// The placement with this name. The angle may be any integer from 0 to 359.
    pub fn from_name(name: &str) -> Option<Self> {
        let (place, angle) = name.rsplit_once('_')?;
        let angle = angle.parse::<u16>().ok().filter(|a| *a < 360)?;
        let yaw = f64::from(angle).to_radians();
        let offset = match place {
            "center" => [0.0, 0.0],
            "edge" => [0.12, 0.0],
            "left" => [0.0, 0.15],
            "right" => [0.0, -0.15],
            "rotated" => [0.1 * yaw.cos(), 0.1 * yaw.sin()],
            _ => return None,
        };
        Some(Self { position: [WORKSPACE_CENTRE[0] + offset[0], WORKSPACE_CENTRE[1] + offset[1]], yaw })
    }

    /// The same placement in a workspace that is scaled about the robot's base.
    #[must_use]
    pub fn scaled(mut self, scale: f64) -> Self {
        self.position = self.position.map(|x| x * scale);
        self
    }

    /// The same placement, moved on the table by `offset` (m).
    #[must_use]
    pub fn moved(mut self, offset: [f64; 2]) -> Self {
        self.position = [self.position[0] + offset[0], self.position[1] + offset[1]];
        self
    }

    /// Pose of an object of this height (m) at the placement.
    pub fn pose(&self, height_m: f64) -> Pose {
        Pose::upright([self.position[0], self.position[1], 0.5 * height_m], self.yaw)
    }
}
