//! The declaration of pick and place as data.

use robogate_core::{
    Better, CameraSpec, FailureMode, FailureModeSpec, Fault, MeasureSpec, Pose, Severity, TaskInstance, TaskSpec, Word,
};
use robogate_physics::Robot;
use serde::{Deserialize, Serialize};

use super::{ModeSet, PickPlace, foresight};
use crate::arm::{base_spec, briefing, common_measures, instance, measure, mode};

/// The gripper closed without the object.
pub const GRASP_MISS: FailureMode = FailureMode::constant("grasp_miss");
/// The object was lost between grasp and release.
pub const GRIP_LOSS: FailureMode = FailureMode::constant("grip_loss");
/// A robot link or finger touched something other than the object.
pub const COLLISION: FailureMode = FailureMode::constant("collision");
/// The time limit passed, and the robot had pressed on something.
pub const JAM: FailureMode = FailureMode::constant("jam");
/// The time limit passed, and the object was at rest after its release, but not at the target.
pub const MISPLACED: FailureMode = FailureMode::constant("misplaced");

/// Largest normal force between any body of the robot and another body, in newtons.
/// Largest displacement of the object relative to the hand since it was held, in metres.
pub const SLIP: Word = Word::constant("slip_m");
/// Smallest distance between the robot and anything other than the object, in metres.
pub const MIN_CLEARANCE: Word = Word::constant("min_clearance_m");
/// Horizontal distance of the object from its target, in metres.
pub const TARGET_DISTANCE: Word = Word::constant("target_distance_m");

/// The phases of the scripted controller (paper, section 4.1).
pub mod phases {
    use robogate_core::Word;

    /// Move to the point above the object.
    pub const APPROACH_ABOVE: Word = Word::constant("APPROACH_ABOVE");
    /// Move straight down to the grasp.
    pub const DESCEND: Word = Word::constant("DESCEND");
    /// Close the gripper.
    pub const GRASP: Word = Word::constant("GRASP");
    /// Move straight up.
    pub const LIFT: Word = Word::constant("LIFT");
    /// Carry the object to the target and down to the table.
    pub const MOVE_TO_TARGET: Word = Word::constant("MOVE_TO_TARGET");
    /// Open the gripper and retreat.
    pub const RELEASE: Word = Word::constant("RELEASE");

    /// Every phase, in order.
    pub const ALL: [Word; 6] = [APPROACH_ABOVE, DESCEND, GRASP, LIFT, MOVE_TO_TARGET, RELEASE];
}

/// The task specification for this robot with these cameras under these rules.
pub fn spec(robot: &Robot, cameras: Vec<CameraSpec>, rules: &PickPlace) -> TaskSpec {
    TaskSpec {
        version: 2,
        instruction: "pick up the part and place it at the target".to_owned(),
        failure_modes: failure_modes(rules),
        measures: measures(),
        draws: foresight::draw_specs(robot.settings.arm.joints.len()),
        phases: phases::ALL.to_vec(),
        ..base_spec(super::NAME, robot, cameras)
    }
}

fn failure_modes(rules: &PickPlace) -> Vec<FailureModeSpec> {
    let at_limit = |name, severity, meaning: String| FailureModeSpec {
        name,
        meaning,
        severity,
        published_as: Some(FailureMode::TIMEOUT),
    };
    let jam = format!(
        "The time limit passed, and the robot had pressed with more than {} N for {} s.",
        rules.jam_force_n, rules.jam_duration_s
    );
    let off = match rules.orientation_limit_rad() {
        None => format!("more than {:.0} mm from the target", 1e3 * rules.tolerance_m),
        Some(angle) => {
            format!("more than {:.0} mm or {:.0} degrees from the target", 1e3 * rules.tolerance_m, angle.to_degrees())
        }
    };
    let misplaced = format!("The time limit passed, and the released part was at rest {off}.");
    let mut modes = vec![
        mode(GRASP_MISS, Severity::Major, "The gripper closed without the part."),
        mode(GRIP_LOSS, Severity::Critical, "The part was lost between grasp and release."),
        mode(COLLISION, Severity::Critical, "A link or finger of the robot touched something other than the part."),
    ];
    if rules.modes == ModeSet::All {
        modes.push(at_limit(JAM, Severity::Critical, jam));
        modes.push(at_limit(MISPLACED, Severity::Major, misplaced));
    }
    modes.push(mode(FailureMode::TIMEOUT, Severity::Minor, "The time limit passed before the task was done."));
    modes
}

fn measures() -> Vec<MeasureSpec> {
    let [peak_force, feasible, gave_up] = common_measures();
    vec![
        peak_force,
        measure(SLIP, "m", Better::Lower, "Largest displacement of the part in the hand since it was held."),
        measure(MIN_CLEARANCE, "m", Better::Higher, "Smallest distance between the robot and anything but the part."),
        feasible,
        gave_up,
        measure(TARGET_DISTANCE, "m", Better::Lower, "Horizontal distance of the part from its target."),
    ]
}

/// Information that a policy may use about one episode: facts that are known before the episode.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Briefing {
    /// The object's shape.
    pub shape: String,
    /// The object's bounding box in its own frame (x, y, z), in metres.
    pub object_extent_m: [f64; 3],
    /// Nominal pose of the centre of the object's bounding box, in the base frame.
    pub object_pose: Pose,
    /// Target position of the bounding box's centre, in the base frame.
    pub target_pose: Pose,
    /// Success means at rest within this horizontal distance of the target, in metres.
    pub tolerance_m: f64,
    /// Success also means that the part's orientation is within this angle of the target's, in radians. `None` if the
    /// orientation has no effect.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub orientation_tolerance_rad: Option<f64>,
    /// Speed limit of the tool on its way down to the object, in m/s. `None` leaves it to the policy.
    pub approach_speed_m_s: Option<f64>,
}

impl Briefing {
    /// The briefing as the details of an episode.
    pub fn instance(&self) -> TaskInstance {
        instance(format!("pick up the {} and place it at the target", self.shape), self)
    }

    /// Reads the briefing from the details of an episode.
    ///
    /// # Errors
    /// A setup fault if the details are not those of pick and place.
    pub fn of(instance: &TaskInstance) -> Result<Self, Fault> {
        briefing(super::NAME, instance)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn briefing_survives_json_bit_for_bit() {
        let briefing = Briefing {
            shape: "box".to_owned(),
            object_extent_m: [0.1 + 0.2, 1.0 / 3.0, -0.0],
            object_pose: Pose::upright([0.5, -1e-17, 0.025], 0.7),
            target_pose: Pose::IDENTITY,
            tolerance_m: 0.03,
            orientation_tolerance_rad: Some(0.1),
            approach_speed_m_s: None,
        };
        let read = Briefing::of(&briefing.instance()).unwrap();
        assert_eq!(format!("{read:?}"), format!("{briefing:?}"));
    }
}
