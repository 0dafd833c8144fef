//! Observations and tasks for tests.

use robogate_core::{Image, Observation, Pose, TaskSpec};

/// Two images whose bytes count up, a tool that points down at x = 0.5 m, an open gripper.
pub(crate) fn observation(side: usize) -> Observation {
    let image = |camera: &str| Image {
        camera: camera.to_owned(),
        width: side,
        height: side,
        rgb: (0..3 * side * side).map(|i| i as u8).collect(),
    };
    Observation {
        time_s: 0.0,
        joint_positions: vec![0.0; 7],
        joint_velocities: vec![0.0; 7],
        gripper_opening_m: Some(0.08),
        tool_pose: Pose { position: [0.5, 0.0, 0.3], orientation: [0.0, 1.0, 0.0, 0.0] },
        images: vec![image("front"), image("wrist")],
    }
}

/// A task with this instruction.
pub(crate) fn task(instruction: &str) -> TaskSpec {
    TaskSpec {
        instruction: instruction.to_owned(),
        control_period_s: 0.05,
        time_limit_s: 10.0,
        shape: "box".to_owned(),
        object_extent_m: [0.05; 3],
        object_pose: Pose::IDENTITY,
        target_pose: Pose::IDENTITY,
        tolerance_m: 0.05,
        approach_speed_m_s: None,
    }
}
