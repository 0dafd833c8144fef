//! Contact forces on the robot: the largest one, and contacts that are too hard.

use robogate_core::{FailureMode, Measures, Word};
use robogate_physics::{GripperCommand, Robot};

use super::grip::touching;
use super::rules::{Record, Sight};

/// A contact with too much force.
pub(crate) const STRUCK: FailureMode = FailureMode::constant("struck");
/// The largest contact force, in newtons.
pub(crate) const PEAK_CONTACT_FORCE: Word = Word::constant("peak_contact_force_n");
/// The limit for robots whose file states none, in newtons: the factory setting of the controllers of Universal Robots.
const USUAL_LIMIT_N: f64 = 150.0;

/// The limit of contact forces on this robot, in newtons. `chosen` is that of the task's settings.
pub(crate) fn limit_n(robot: &Robot, chosen: Option<f64>) -> f64 {
    chosen.or(robot.settings.arm.collision_force_n).unwrap_or(USUAL_LIMIT_N)
}

/// The contact forces of one episode.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Forces {
    /// `None` if no contact is too hard.
    limit_n: Option<f64>,
    /// Normal force of each pad, in newtons.
    grip_force_n: f64,
    /// Whether the gripper closes or holds, or has not let go yet.
    grips: bool,
    peak_n: Option<f64>,
}

impl Forces {
    /// Before the first step. The pads press with `grip_force_n` newtons each.
    pub(crate) fn new(limit_n: Option<f64>, grip_force_n: f64) -> Self {
        Self { limit_n, grip_force_n, grips: false, peak_n: None }
    }

    /// Observes one time step. A contact above the limit ends the episode, however short it is. While the gripper closes, holds or
    /// lets go, its force is added to the limit.
    pub(crate) fn feel(&mut self, sight: &Sight<'_>, record: &mut Record) {
        let force = sight.view.touches.peak_force;
        self.peak_n = force.map_or(self.peak_n, |force| Some(self.peak_n.unwrap_or(0.0).max(force)));
        let Some(limit_n) = self.limit_n else { return };
        self.grips = sight.command == GripperCommand::Close || self.grips && touching(sight.view);
        let grip = if self.grips { self.grip_force_n } else { 0.0 };
        let Some(force) = force else { return };
        if force > limit_n + grip && !record.is_over() {
            record.note(format!("struck: contact force {force:.0} N"));
            record.end(Some(STRUCK), sight.time, sight.view.touches.collision);
        }
    }

    /// Adds its measures.
    pub(crate) fn measure(&self, measures: &mut Measures) {
        measures.set(PEAK_CONTACT_FORCE, self.peak_n);
    }
}
