//! The declaration of insertion as data.

use robogate_core::{Better, CameraSpec, FailureMode, Fault, Pose, Severity, TaskInstance, TaskSpec, Word};
use robogate_physics::Robot;
use serde::{Deserialize, Serialize};

use super::{NAME, foresight};
use crate::arm::{base_spec, briefing, common_measures, measure, mode};

/// The peg is pressed and does not move, and another direction of the load would move it.
pub(super) const JAM: FailureMode = FailureMode::constant("jam");
/// The peg is caught between two contacts and no load moves it.
pub(super) const WEDGE: FailureMode = FailureMode::constant("wedge");
/// The gripper closed without the peg, or the peg was released outside the hole.
pub(super) const MISSED: FailureMode = FailureMode::constant("missed");
/// The peg moved in the hand, which led to a collision, a release outside the hole or the time limit.
pub(super) const SLIPPED: FailureMode = FailureMode::constant("slipped");
/// The peg was lost between grasp and release.
pub(super) const DROPPED: FailureMode = FailureMode::constant("dropped");
/// The robot touched the table or the block.
pub(super) const COLLISION: FailureMode = FailureMode::constant("collision");

/// Largest depth of the tip in the hole, in metres.
pub(super) const DEPTH: Word = Word::constant("insertion_depth_m");
/// Largest force of block and table on the peg along the hole's axis, in newtons.
pub(super) const PRESS: Word = Word::constant("peak_press_force_n");
/// Largest force of block and table on the peg across the hole's axis, in newtons.
pub(super) const LATERAL: Word = Word::constant("peak_lateral_force_n");
/// Time from the first contact of the held peg with the block to its seat, in seconds.
pub(super) const DURATION: Word = Word::constant("insertion_time_s");

/// Largest displacement of the peg in the hand since it was held, in metres.
pub(super) const SLIP: Word = Word::constant("slip_m");

/// The phases of the scripted controller.
pub(super) mod phases {
    use robogate_core::Word;

    pub(in crate::insertion) const PICK: Word = Word::constant("pick");
    pub(in crate::insertion) const TOUCH: Word = Word::constant("touch");
    pub(in crate::insertion) const SEARCH: Word = Word::constant("search");
    pub(in crate::insertion) const INSERT: Word = Word::constant("insert");
    pub(in crate::insertion) const RELEASE: Word = Word::constant("release");

    /// Every phase, in order.
    pub(in crate::insertion) const ALL: [Word; 5] = [PICK, TOUCH, SEARCH, INSERT, RELEASE];
}

/// The task specification for this robot with these cameras.
pub(super) fn spec(robot: &Robot, cameras: Vec<CameraSpec>) -> TaskSpec {
    TaskSpec {
        instruction: "pick up the peg and insert it into the hole".to_owned(),
        failure_modes: vec![
            mode(JAM, Severity::Major, "The peg was pressed in the hole or on the block and did not move."),
            mode(
                WEDGE,
                Severity::Critical,
                "The peg was caught in the hole where friction can hold it against any load.",
            ),
            mode(MISSED, Severity::Major, "The gripper closed without the peg, or released it outside the hole."),
            mode(SLIPPED, Severity::Major, "The peg moved in the hand by more than 5 mm before it was seated."),
            mode(DROPPED, Severity::Critical, "The peg was lost between grasp and release."),
            mode(COLLISION, Severity::Critical, "A link or finger of the robot touched the table or the block."),
            mode(FailureMode::TIMEOUT, Severity::Minor, "The time limit passed before the peg was seated."),
        ],
        draws: foresight::draw_specs(robot.settings.arm.joints.len()),
        measures: [
            measure(DEPTH, "m", Better::Higher, "Largest depth of the peg's tip in the hole."),
            measure(PRESS, "N", Better::Lower, "Largest force of block and table on the peg along the hole's axis."),
            measure(LATERAL, "N", Better::Lower, "Largest force of block and table on the peg across the hole's axis."),
            measure(SLIP, "m", Better::Lower, "Largest displacement of the peg in the hand since it was held."),
            measure(DURATION, "s", Better::Lower, "Time from the first contact with the block to the seat."),
        ]
        .into_iter()
        .chain(common_measures())
        .collect(),
        phases: phases::ALL.to_vec(),
        ..base_spec(NAME, robot, cameras)
    }
}

/// Information that a policy may use about one episode.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) struct Briefing {
    /// Nominal pose of the peg: the middle of its tip.
    pub(super) peg: Pose,
    /// Nominal pose of the hole: the middle of its mouth.
    pub(super) hole: Pose,
    /// Difference of the widths of hole and peg, in metres.
    pub(super) clearance_m: f64,
    /// Width of the chamfer, in metres.
    pub(super) chamfer_m: f64,
    /// Stiffness of the arm's servos as a multiple of the robot's own.
    pub(super) arm_stiffness: f64,
}

impl Briefing {
    /// Reads the briefing from the details of an episode.
    ///
    /// # Errors
    /// A setup fault if the details are not those of insertion.
    pub(super) fn of(instance: &TaskInstance) -> Result<Self, Fault> {
        briefing(NAME, instance)
    }
}
