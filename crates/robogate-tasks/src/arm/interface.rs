//! What a policy for an arm observes and commands, the same for all tasks of the cell.

use robogate_core::{ActionSpace, ActionSpec, GripperKind, Observation, Pose, VectorSpec, vectors};
use robogate_physics::{ArmState, Gripper, Robot};

/// The unit of a tool delta: metres along, and radians about, each axis (paper, section 7.1).
const TOOL_DELTA: (f64, f64) = (0.02, 0.05);

/// The vectors that a policy observes on this robot.
pub(crate) fn observed_vectors(robot: &Robot) -> Vec<VectorSpec> {
    let joints = robot.settings.arm.joints.len();
    let vector = |name, length, unit: &str| VectorSpec { name, length, unit: unit.to_owned() };
    let mut observed =
        vec![vector(vectors::JOINT_POSITIONS, joints, "rad"), vector(vectors::JOINT_VELOCITIES, joints, "rad/s")];
    if let Gripper::ParallelJaw(_) = robot.settings.gripper {
        observed.push(vector(vectors::GRIPPER_OPENING, 1, "m"));
    }
    observed.push(vector(vectors::TOOL_POSE, 7, ""));
    observed
}

/// The actions that a policy may command on this robot.
pub(crate) fn action_spec(robot: &Robot) -> ActionSpec {
    let (translation_m, rotation_rad) = TOOL_DELTA;
    let joints = robot.settings.arm.joints.clone();
    ActionSpec {
        spaces: vec![ActionSpace::JointPosition { joints }, ActionSpace::ToolDelta { translation_m, rotation_rad }],
        gripper: Some(GripperKind::Binary),
    }
}

/// Converts an arm state to an observation with the tool at `tool_pose`. All values are as measured.
pub(crate) fn observation(time_s: f64, arm: ArmState, tool_pose: Pose) -> Observation {
    let mut vectors =
        vec![(vectors::JOINT_POSITIONS, arm.joint_positions), (vectors::JOINT_VELOCITIES, arm.joint_velocities)];
    vectors.extend(arm.opening_m.map(|opening| (vectors::GRIPPER_OPENING, vec![opening])));
    vectors.push((vectors::TOOL_POSE, tool_pose.to_array().to_vec()));
    Observation { time_s, vectors, images: Vec::new() }
}
