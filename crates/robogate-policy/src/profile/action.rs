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
    /// Frame of translations and rotations, for `tool_delta` and `osc_pose`.
    #[serde(default, skip_serializing_if = "Frame::is_base")]
    pub frame: Frame,
    /// Number of leading numbers that are used. The others are ignored. Default: all.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub used: Option<usize>,
    /// Actions per second. Each action is executed over as many control periods as fit. Default: one per control
    /// period.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub control_hz: Option<f64>,
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
    /// Translation (3 numbers) and rotation of the tool.
    ToolDelta,
    /// Offset of the goal of an impedance controller from the measured pose, as in robosuite's `OSC_POSE`: translation
    /// (3 numbers) and rotation. The arm follows with the lag of that controller.
    OscPose,
    /// Absolute position (3 numbers) and rotation of the tool, in the model's world frame and tool frame.
    ToolPose,
    /// Position of each joint, in radians.
    JointPositions,
    /// Change of each joint from its measured position, in units of `rotation_scale_rad`.
    JointDeltas,
    /// The task's own action vector, clipped to its bounds, without a number for the gripper.
    Vector,
}

impl Arm {
    /// The name in profiles.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::ToolDelta => "tool_delta",
            Self::OscPose => "osc_pose",
            Self::ToolPose => "tool_pose",
            Self::JointPositions => "joint_positions",
            Self::JointDeltas => "joint_deltas",
            Self::Vector => "vector",
        }
    }
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
    /// Unit quaternion, scalar last.
    QuaternionXyzw,
    /// Unit quaternion, scalar first.
    QuaternionWxyz,
    /// The first column of the rotation matrix, then the second.
    Rot6dColumns,
    /// The first two columns of the rotation matrix, row by row.
    Rot6dInterleaved,
    /// The first row of the rotation matrix, then the second.
    Rot6dRows,
}

impl ActionForm {
    /// Number of leading numbers that are used.
    pub fn used(&self) -> usize {
        self.used.unwrap_or(self.size)
    }

    /// Number of control periods of `period_s` seconds for each action.
    ///
    /// # Errors
    /// If the period of the actions is not a multiple of the control period.
    pub fn periods(&self, period_s: f64) -> Result<u32, String> {
        let Some(hz) = self.control_hz else { return Ok(1) };
        let periods = 1.0 / (hz * period_s);
        if periods.round() < 1.0 || (periods - periods.round()).abs() > 1e-6 * periods {
            return Err(format!(
                "action.control_hz = {hz}, but the task has {} control periods per second, which is not a multiple",
                1.0 / period_s
            ));
        }
        Ok(periods.round() as u32)
    }
}

impl Rotation {
    /// Number of elements.
    pub fn size(self) -> usize {
        match self {
            Self::AxisAngle | Self::Euler => 3,
            Self::QuaternionXyzw | Self::QuaternionWxyz => 4,
            Self::Rot6dColumns | Self::Rot6dInterleaved | Self::Rot6dRows => 6,
        }
    }

    /// Whether its elements are angles, which a scale can multiply.
    pub fn is_scaled(self) -> bool {
        matches!(self, Self::AxisAngle | Self::Euler)
    }
}

/// Frame in which a motion is expressed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Frame {
    /// The base frame of the robot.
    #[default]
    Base,
    /// The measured frame of the tool, as the model defines it (`[tool]`).
    Tool,
}

impl Frame {
    pub(crate) fn is_base(&self) -> bool {
        *self == Self::Base
    }
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
