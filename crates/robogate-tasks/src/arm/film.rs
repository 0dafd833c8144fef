//! Records the trajectory of an episode.

use robogate_camera::{Cameras, Posture};
use robogate_core::{ContactPoint, Frame, Trajectory};
use robogate_physics::{Engine, Scene, StepView};

use super::cameras::posture;

/// A recorder. It reads the engine and never changes it.
#[derive(Debug)]
pub(crate) struct Film {
    /// Time between two frames, in seconds.
    period_s: f64,
    /// The task's control period, in seconds.
    control_period_s: f64,
    /// Number of fixtures of the scene, and of free bodies other than the object.
    bodies: [usize; 2],
    /// Number of completed control periods.
    ticks: u64,
    /// Simulated time of each frame in seconds, with positions and contacts.
    frames: Vec<(f64, Posture, Vec<ContactPoint>)>,
    /// The contacts since the last frame at the time step with the largest force on the robot.
    strongest: Option<(f64, Vec<ContactPoint>)>,
    /// The end of the last control period: time in seconds, and positions.
    end: Option<(f64, Posture)>,
}

impl Film {
    pub(crate) fn new(period_s: f64, control_period_s: f64) -> Self {
        Self { period_s, control_period_s, bodies: [0; 2], ticks: 0, frames: Vec::new(), strongest: None, end: None }
    }

    /// Starts an episode in this scene.
    pub(crate) fn start(&mut self, engine: &impl Engine, scene: &Scene) {
        let bodies = [scene.fixtures.len(), scene.others.len()];
        *self = Self { bodies, ..Self::new(self.period_s, self.control_period_s) };
        self.expose(engine, 0.0);
    }

    /// Observes one time step.
    pub(crate) fn observe(&mut self, engine: &impl Engine, view: &StepView<'_>) {
        let force = view.touches.peak_force.unwrap_or(-1.0);
        if self.strongest.as_ref().is_none_or(|(strongest, _)| force > *strongest) {
            self.strongest = Some((force, engine.contact_points()));
        }
        let time_s = (self.ticks as f64 + view.fraction) * self.control_period_s;
        if time_s >= self.frames.len() as f64 * self.period_s - 1e-9 {
            self.expose(engine, time_s);
        }
    }

    /// Ends a control period, which may be the last one.
    pub(crate) fn end_period(&mut self, engine: &impl Engine) {
        self.ticks += 1;
        self.end = Some((self.ticks as f64 * self.control_period_s, posture(engine, self.bodies)));
    }

    /// Takes the trajectory of the last episode, with the geometry of these cameras. `None` without an episode.
    pub(crate) fn take(&mut self, cameras: &Cameras) -> Option<Trajectory> {
        let mut frames = std::mem::take(&mut self.frames);
        let last = frames.last()?.0;
        if let Some((time_s, posture)) = self.end.take().filter(|(time_s, _)| *time_s > last + 1e-9) {
            let contacts = self.strongest.take().map(|(_, points)| points).unwrap_or_default();
            frames.push((time_s, posture, contacts));
        }
        let frame = |(time_s, posture, contacts)| Frame { time_s, poses: cameras.poses(&posture), contacts };
        Some(Trajectory {
            bodies: cameras.bodies(),
            solids: cameras.solids(),
            frames: frames.into_iter().map(frame).collect(),
        })
    }

    fn expose(&mut self, engine: &impl Engine, time_s: f64) {
        let contacts = self.strongest.take().map(|(_, points)| points).unwrap_or_default();
        self.frames.push((time_s, posture(engine, self.bodies), contacts));
    }
}
