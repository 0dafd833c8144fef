//! The declaration of stacking as data.

use robogate_core::{Better, CameraSpec, FailureMode, Fault, Pose, Severity, TaskInstance, TaskSpec, Word};
use robogate_physics::Robot;
use serde::{Deserialize, Serialize};

use super::{NAME, foresight};
use crate::arm::{base_spec, briefing, common_measures, instance, measure, mode, not_a_briefing};

/// A part that stood on another one fell off it or tipped over.
pub(super) const TOPPLED: FailureMode = FailureMode::constant("toppled");
/// A part came to rest outside the tolerance of its place.
pub(super) const MISPLACED: FailureMode = FailureMode::constant("misplaced");
/// A part was lost between grasp and release, or released in the air.
pub(super) const DROPPED: FailureMode = FailureMode::constant("dropped");
/// The gripper closed without a part.
pub(super) const MISSED: FailureMode = FailureMode::constant("missed");
/// The time limit passed, and the robot had pressed on something.
pub(super) const JAM: FailureMode = FailureMode::constant("jam");
/// The robot touched the table.
pub(super) const COLLISION: FailureMode = FailureMode::constant("collision");

/// Largest distance of a placed part from its place, in metres.
pub(super) const OFFSET: Word = Word::constant("stack_offset_m");
/// Smallest distance from the line of gravity to an edge of support, in metres.
pub(super) const MARGIN: Word = Word::constant("stability_margin_m");
/// Largest displacement of a part in the hand since it was held, in metres.
pub(super) const SLIP: Word = Word::constant("slip_m");

/// The phases of the scripted controller.
pub(super) mod phases {
    use robogate_core::Word;

    pub(in crate::stacking) const APPROACH: Word = Word::constant("approach");
    pub(in crate::stacking) const GRASP: Word = Word::constant("grasp");
    pub(in crate::stacking) const CARRY: Word = Word::constant("carry");
    pub(in crate::stacking) const RELEASE: Word = Word::constant("release");
}

/// The task specification for this robot with these cameras.
pub(super) fn spec(robot: &Robot, cameras: Vec<CameraSpec>) -> TaskSpec {
    TaskSpec {
        instruction: "stack the parts in the given order".to_owned(),
        failure_modes: vec![
            mode(TOPPLED, Severity::Critical, "A part that stood on another one fell off it or tipped over."),
            mode(MISPLACED, Severity::Major, "A part came to rest outside the tolerance of its place."),
            mode(DROPPED, Severity::Critical, "A part was lost between grasp and release, or released in the air."),
            mode(MISSED, Severity::Major, "The gripper closed without a part."),
            mode(COLLISION, Severity::Critical, "A link or finger of the robot touched the table."),
            mode(
                JAM,
                Severity::Critical,
                "The time limit passed, and the robot had pressed for the duration of a jam.",
            ),
            mode(FailureMode::TIMEOUT, Severity::Minor, "The time limit passed before the stack was complete."),
        ],
        draws: foresight::draw_specs(robot.settings.arm.joints.len()),
        measures: [
            measure(OFFSET, "m", Better::Lower, "Largest horizontal distance of a placed part from its place."),
            measure(
                MARGIN,
                "m",
                Better::Higher,
                "Smallest distance from the line of gravity of the parts above a face to the edge of that face.",
            ),
            measure(SLIP, "m", Better::Lower, "Largest displacement of a part in the hand since it was held."),
        ]
        .into_iter()
        .chain(common_measures())
        .collect(),
        phases: vec![phases::APPROACH, phases::GRASP, phases::CARRY, phases::RELEASE],
        ..base_spec(NAME, robot, cameras)
    }
}

/// Information that a policy may use about one episode.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) struct Briefing {
    /// Edge of each part, in metres.
    pub(super) size_m: f64,
    /// Nominal pose of each part's centre: a, b, c.
    pub(super) parts: [Pose; 3],
    /// Indices of the parts from the bottom of the stack to its top.
    pub(super) order: [usize; 3],
    /// Offset (x, y) of each part from the part below it in the base frame, in metres.
    pub(super) offset_m: [f64; 2],
    /// Success means within this horizontal distance of that offset, in metres.
    pub(super) tolerance_m: f64,
}

impl Briefing {
    /// Nominal position (x, y) of the part at a level of the stack, in metres.
    pub(super) fn place(&self, level: usize) -> [f64; 2] {
        let [x, y, _] = self.parts[self.order[0]].position;
        [x + level as f64 * self.offset_m[0], y + level as f64 * self.offset_m[1]]
    }

    /// The briefing as the details of an episode.
    pub(super) fn instance(&self) -> TaskInstance {
        let [first, second, third] = self.order.map(|part| ["a", "b", "c"][part]);
        instance(format!("put part {second} on part {first} and part {third} on part {second}"), self)
    }

    /// Reads the briefing from the details of an episode.
    ///
    /// # Errors
    /// A setup fault if the details are not those of stacking.
    pub(super) fn of(instance: &TaskInstance) -> Result<Self, Fault> {
        let briefing: Self = briefing(NAME, instance)?;
        match briefing.order.iter().find(|part| **part > 2) {
            Some(part) => Err(not_a_briefing(NAME, &format!("there is no part {part}"))),
            None => Ok(briefing),
        }
    }
}
