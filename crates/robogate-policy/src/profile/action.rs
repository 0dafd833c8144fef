//! The actions of a model.

use serde::{Deserialize, Serialize};

/// Meaning of the numbers of an action.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ActionForm {
    /// Number of elements. The last one is for the gripper, unless `arm` is `vector`.
    pub size: usize,
    /// Meaning of the other elements.
    pub arm: Arm,
    /// Representation of rotations.
    #[serde(default)]
    pub rotation: Rotation,
    /// Translation per unit of an action, in metres.
    #[serde(default = "position_scale")]
    pub position_scale_m: f64,
    /// Rotation per unit of an action, in radians.
    #[serde(default = "rotation_scale")]
    pub rotation_scale_rad: f64,
    /// Limit on the magnitude of the numbers for the arm. They are clipped before scaling. Default: no clipping.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub clip: Option<f64>,
    /// Threshold of the number for the gripper. Required unless `arm` is `vector`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub gripper_threshold: Option<f64>,
    /// Side of the threshold on which the gripper opens. Required unless `arm` is `vector`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub gripper_open: Option<Side>,
}

/// The position scale of the paper (section 7.1).
fn position_scale() -> f64 {
    0.02
}

/// The rotation scale of the paper (section 7.1).
fn rotation_scale() -> f64 {
    0.05
}

/// Meaning of the numbers for the arm.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Arm {
    /// Translation (3 numbers) and rotation (3 numbers) of the tool, in the base frame.
    ToolDelta,
    /// Position of each joint, in radians.
    JointPositions,
    /// Change of each joint from its measured position, in units of `rotation_scale_rad`.
    JointDeltas,
    /// The task's own action vector, clipped to its bounds, without a number for the gripper.
    Vector,
}

/// Representation of rotations.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Rotation {
    /// Rotation vector.
    #[default]
    AxisAngle,
    /// Roll, pitch and yaw: rotations about fixed axes, in this order.
    Euler,
}

/// Side of a threshold.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Side {
    /// Greater than the threshold.
    Above,
    /// Less than the threshold.
    Below,
}

/// Number of actions in a reply, and number of executed actions.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Chunking {
    /// Number of actions in a reply. Default: any number of at least `execute`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub length: Option<usize>,
    /// Number of actions that are executed before the next request.
    pub execute: usize,
}
