//! Records the trajectory of an episode.

use robogate_core::{Frame, Pose, Solid, SolidShape, Trajectory};

/// Height of the hinge, in metres.
const HINGE_M: f64 = 1.0;
/// Radius of the pole, in metres.
const POLE_M: f64 = 0.02;

/// A recorder of the pole's angle.
pub(super) struct Film {
    /// Time between two frames, in seconds.
    period_s: f64,
    /// Length of the pole, in metres.
    length: f64,
    /// Simulated time in seconds, and angle from hanging in rad, of each frame.
    frames: Vec<(f64, f64)>,
}

impl Film {
    pub(super) fn new(period_s: f64) -> Self {
        Self { period_s, length: 0.0, frames: Vec::new() }
    }

    /// Starts an episode.
    pub(super) fn start(&mut self, length: f64, angle: f64) {
        *self = Self { period_s: self.period_s, length, frames: vec![(0.0, angle)] };
    }

    /// Notes the angle at the end of a control period. The last one always gets a frame.
    pub(super) fn note(&mut self, time_s: f64, angle: f64, last: bool) {
        if last || time_s >= self.frames.len() as f64 * self.period_s - 1e-9 {
            self.frames.push((time_s, angle));
        }
    }

    /// Takes the trajectory of the last episode. `None` without an episode.
    pub(super) fn take(&mut self) -> Option<Trajectory> {
        let frames = std::mem::take(&mut self.frames);
        frames.first()?;
        let solid = |body, shape, z: f64, color| Solid {
            body,
            shape,
            pose: Pose { position: [0.0, 0.0, z], ..Pose::IDENTITY },
            color,
            opacity: 1.0,
        };
        let pole = SolidShape::Capsule { radius: POLE_M, half_height: 0.5 * self.length };
        let stand = Pose { position: [0.0, 0.0, HINGE_M], ..Pose::IDENTITY };
        let pose = |angle: f64| {
            let half = 0.5 * angle;
            Pose { position: stand.position, orientation: [half.cos(), 0.0, half.sin(), 0.0] }
        };
        Some(Trajectory {
            bodies: vec!["stand".to_owned(), "pole".to_owned()],
            solids: vec![
                solid(0, SolidShape::Sphere { radius: 1.8 * POLE_M }, 0.0, [62, 65, 70]),
                solid(1, pole, -0.5 * self.length, [104, 150, 190]),
                solid(1, SolidShape::Sphere { radius: 1.5 * POLE_M }, -self.length, [217, 116, 43]),
            ],
            frames: frames
                .into_iter()
                .map(|(time_s, angle)| Frame { time_s, poses: vec![stand, pose(angle)], contacts: Vec::new() })
                .collect(),
        })
    }
}
