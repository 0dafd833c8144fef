//! Test observations and tasks.

use robogate_core::{
    ActionSpace, ActionSpec, CameraSpec, GripperKind, Image, Observation, ObservationSpec, Policy, Seed, TaskInstance,
    TaskSpec, VectorSpec, Word, vectors,
};

/// Two images with increasing bytes, a tool that points down at x = 0.5 m, and an open gripper.
pub(crate) fn observation(side: usize) -> Observation {
    let image = |camera: &str| Image {
        camera: camera.to_owned(),
        width: side,
        height: side,
        rgb: (0..3 * side * side).map(|i| i as u8).collect(),
    };
    Observation {
        time_s: 0.0,
        vectors: vec![
            (vectors::JOINT_POSITIONS, vec![0.0; 7]),
            (vectors::GRIPPER_OPENING, vec![0.08]),
            (vectors::TOOL_POSE, vec![0.5, 0.0, 0.3, 0.0, 1.0, 0.0, 0.0]),
        ],
        images: vec![image("front"), image("wrist")],
    }
}

/// A task for an arm with seven joints, a gripper and two cameras.
pub(crate) fn task() -> TaskSpec {
    let camera = |name: &str| CameraSpec { name: name.to_owned(), width: 256, height: 256 };
    let vector = |name: Word, length: usize| VectorSpec { name, length, unit: String::new() };
    TaskSpec {
        name: Word::constant("test"),
        version: 1,
        instruction: "do something".to_owned(),
        control_period_s: 0.05,
        time_limit_s: 10.0,
        failure_modes: Vec::new(),
        measures: Vec::new(),
        draws: Vec::new(),
        phases: Vec::new(),
        stages: Vec::new(),
        parameters: Vec::new(),
        settings: Vec::new(),
        observation: ObservationSpec {
            vectors: vec![
                vector(vectors::JOINT_POSITIONS, 7),
                vector(vectors::GRIPPER_OPENING, 1),
                vector(vectors::TOOL_POSE, 7),
            ],
            cameras: vec![camera("front"), camera("wrist")],
        },
        action: ActionSpec {
            spaces: vec![
                ActionSpace::JointPosition { joints: (1..=7).map(|i| format!("joint{i}")).collect() },
                ActionSpace::ToolDelta { translation_m: 0.02, rotation_rad: 0.05 },
            ],
            gripper: Some(GripperKind::Binary),
        },
        details: serde_json::Value::Null,
    }
}

/// Starts an episode of the task with this instruction.
pub(crate) fn begin(policy: &mut dyn Policy, instruction: &str) -> Result<(), robogate_core::Fault> {
    let instance = TaskInstance { instruction: instruction.to_owned(), ..TaskInstance::default() };
    policy.reset(&task(), &instance, Seed::campaign(1))
}
