//! The declaration of insertion as data.

use robogate_core::{
    Better, CameraSpec, FailureMode, Fault, FaultKind, ObservationSpec, Pose, Severity, TaskInstance, TaskSpec, Word,
};
use robogate_physics::Robot;
use serde::{Deserialize, Serialize};

use super::parameters::ROWS;
use crate::arm::{action_spec, measure, mode, observed_vectors, specs};

/// Time between two actions, in seconds.
pub(super) const CONTROL_PERIOD_S: f64 = 0.05;
/// The time limit of an episode, in seconds.
const TIME_LIMIT_S: f64 = 40.0;

/// The peg is pressed and does not move, and another direction of the load would move it.
pub(super) const JAM: FailureMode = FailureMode::constant("jam");
/// The peg is caught between two contacts and no load moves it.
pub(super) const WEDGE: FailureMode = FailureMode::constant("wedge");
/// The gripper closed without the peg, or the peg was released outside the hole.
pub(super) const MISSED: FailureMode = FailureMode::constant("missed");
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
        name: Word::constant(super::NAME),
        version: 1,
        instruction: "pick up the peg and insert it into the hole".to_owned(),
        control_period_s: CONTROL_PERIOD_S,
        time_limit_s: TIME_LIMIT_S,
        failure_modes: vec![
            mode(JAM, Severity::Major, "The peg was pressed in the hole or on the block and did not move."),
            mode(
                WEDGE,
                Severity::Critical,
                "The peg was caught in the hole where friction can hold it against any load.",
            ),
            mode(MISSED, Severity::Major, "The gripper closed without the peg, or released it outside the hole."),
            mode(DROPPED, Severity::Critical, "The peg was lost between grasp and release."),
            mode(COLLISION, Severity::Critical, "A link or finger of the robot touched the table or the block."),
            mode(FailureMode::TIMEOUT, Severity::Minor, "The time limit passed before the peg was seated."),
        ],
        draws: Vec::new(),
        measures: vec![
            measure(DEPTH, "m", Better::Higher, "Largest depth of the peg's tip in the hole."),
            measure(PRESS, "N", Better::Lower, "Largest force of block and table on the peg along the hole's axis."),
            measure(LATERAL, "N", Better::Lower, "Largest force of block and table on the peg across the hole's axis."),
            measure(DURATION, "s", Better::Lower, "Time from the first contact with the block to the seat."),
        ],
        phases: phases::ALL.to_vec(),
        parameters: specs(&ROWS),
        observation: ObservationSpec { vectors: observed_vectors(robot), cameras },
        action: action_spec(robot),
        details: serde_json::Value::Null,
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
    /// The briefing as the details of an episode.
    pub(super) fn instance(&self, instruction: String) -> TaskInstance {
        // Strings and finite numbers cannot fail to serialise.
        TaskInstance { instruction, details: serde_json::to_value(self).unwrap_or_default() }
    }

    /// Reads the briefing from the details of an episode.
    ///
    /// # Errors
    /// A setup fault if the details are not those of insertion.
    pub(super) fn of(instance: &TaskInstance) -> Result<Self, Fault> {
        Self::deserialize(&instance.details).map_err(|why| {
            Fault::new(FaultKind::Setup, format!("the episode details are not a briefing of insertion: {why}"))
        })
    }
}
