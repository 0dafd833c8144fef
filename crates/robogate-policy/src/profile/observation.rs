//! The observations of a model.

use robogate_core::{Word, vectors};
use serde::{Deserialize, Serialize};

use crate::array::Dtype;

/// An image input of a model.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Camera {
    /// Camera of the cell: `front` or `wrist`.
    pub from: String,
    /// Name that the server uses.
    pub key: String,
    /// Width in pixels.
    pub width: usize,
    /// Height in pixels.
    pub height: usize,
    /// How the image is fitted to this size.
    #[serde(default)]
    pub fit: Fit,
    /// Filter for resampling.
    #[serde(default)]
    pub filter: Filter,
    /// Whether the image is rotated by 180 degrees. Images of LIBERO are upside down, and its models were trained on
    /// rotated images.
    #[serde(default)]
    pub turned: bool,
    /// Fraction of width and height that a centre crop keeps, before resizing.
    #[serde(default = "one")]
    pub crop: f64,
    /// Order of the axes of the array.
    #[serde(default)]
    pub axes: Axes,
}

fn one() -> f64 {
    1.0
}

/// How an image is fitted to a size.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Fit {
    /// Keep the aspect ratio and pad with black.
    #[default]
    Pad,
    /// Scale width and height independently.
    Stretch,
}

/// Filter for resampling.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Filter {
    /// Bilinear filter, as in Pillow.
    #[default]
    Bilinear,
    /// Lanczos filter with three lobes, as in Pillow.
    Lanczos,
}

/// Order of the axes of an image.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Axes {
    /// Height, width, channel.
    #[default]
    Hwc,
    /// Channel, height, width.
    Chw,
}

/// A vector input of a model.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct State {
    /// Name that the server uses.
    pub key: String,
    /// Parts of the vector, in order.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub parts: Vec<Part>,
    /// Names of vectors of the task's observation. They are appended unchanged after the parts.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub vectors: Vec<Word>,
    /// Type of its elements: `<f4` or `<f8`.
    #[serde(default = "double", rename = "type")]
    pub dtype: Dtype,
}

fn double() -> Dtype {
    Dtype::F64
}

impl State {
    /// Number of elements of its parts, for an arm with this number of joints. `vectors` are not counted.
    pub fn size(&self, joints: usize) -> usize {
        self.parts.iter().map(|part| part.size(joints)).sum()
    }
}

/// A part of a state vector. Positions are in metres in the base frame, angles in radians.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Part {
    /// Position of the tool centre point (3 numbers).
    ToolPosition,
    /// X coordinate of the tool centre point.
    ToolX,
    /// Y coordinate of the tool centre point.
    ToolY,
    /// Z coordinate of the tool centre point.
    ToolZ,
    /// Rotation vector of the tool, with robosuite's formula (3 numbers).
    ToolAxisAngle,
    /// Roll, pitch and yaw of the tool (3 numbers).
    ToolEuler,
    /// Roll of the tool.
    ToolRoll,
    /// Pitch of the tool.
    ToolPitch,
    /// Yaw of the tool.
    ToolYaw,
    /// Quaternion of the tool, scalar last (4 numbers).
    ToolQuaternionXyzw,
    /// Quaternion of the tool, scalar first (4 numbers).
    ToolQuaternionWxyz,
    /// Measured joint positions (one number for each joint of the arm).
    JointPositions,
    /// Finger positions as robosuite defines them for the Panda: plus and minus half of the opening (2 numbers).
    GripperFingers,
    /// Opening divided by the stroke of the gripper: 0 closed, 1 open.
    GripperOpenness,
    /// One minus the openness.
    GripperClosedness,
    /// Opening in metres.
    GripperOpening,
    /// The number zero.
    Zero,
}

impl Part {
    fn size(self, joints: usize) -> usize {
        match self {
            Self::ToolPosition | Self::ToolAxisAngle | Self::ToolEuler => 3,
            Self::ToolQuaternionXyzw | Self::ToolQuaternionWxyz => 4,
            Self::GripperFingers => 2,
            Self::JointPositions => joints,
            _ => 1,
        }
    }

    /// Name of the observed vector from which it is computed.
    pub(crate) fn vector(self) -> Option<Word> {
        match self {
            Self::Zero => None,
            Self::JointPositions => Some(vectors::JOINT_POSITIONS),
            Self::GripperFingers | Self::GripperOpenness | Self::GripperClosedness | Self::GripperOpening => {
                Some(vectors::GRIPPER_OPENING)
            }
            _ => Some(vectors::TOOL_POSE),
        }
    }

    /// Whether the value depends on `tool.stroke_m`.
    pub(super) fn needs_stroke(self) -> bool {
        matches!(self, Self::GripperOpenness | Self::GripperClosedness)
    }
}

/// Differences between the tool of the cell and that of the training data.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Tool {
    /// Offset added to the position of the tool, in metres: the position of the robot's base in the model's world
    /// frame.
    #[serde(default)]
    pub shift_m: [f64; 3],
    /// Tool frame of the model relative to that of the cell, as roll, pitch and yaw in radians.
    #[serde(default)]
    pub turn_rad: [f64; 3],
    /// Full opening of the gripper in metres, for its openness.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub stroke_m: Option<f64>,
}
