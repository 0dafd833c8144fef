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
    /// Names of the same camera in other environments. The first camera that exists is used.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub or_from: Vec<String>,
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
    /// How the upright image of the camera is reoriented. LIBERO's models saw a mirrored world: robosuite returns images
    /// upside down, and the clients rotate them by 180 degrees.
    #[serde(default, skip_serializing_if = "Orientation::is_upright")]
    pub orientation: Orientation,
    /// The old form of `orientation = "rotated"`.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub turned: bool,
    /// Fraction of width and height that a centre crop keeps, before resizing.
    #[serde(default = "one")]
    pub crop: f64,
    /// Order of the axes of the array.
    #[serde(default)]
    pub axes: Axes,
    /// Images of earlier actions that are sent with the present one, for example `[-15, 0]`: now and 15 actions ago.
    /// They become the first axis of the array. Default: the present image, without this axis.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub history: Vec<i32>,
}

fn one() -> f64 {
    1.0
}

impl Camera {
    /// How the image is reoriented, with the old form of the setting.
    pub fn orientation(&self) -> Orientation {
        if self.turned { Orientation::Rotated } else { self.orientation }
    }

    /// Names under which the camera is searched, in order.
    pub fn sources(&self) -> impl Iterator<Item = &str> {
        std::iter::once(self.from.as_str()).chain(self.or_from.iter().map(String::as_str))
    }
}

/// How an upright image is reoriented.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Orientation {
    /// As the camera sees it.
    #[default]
    Upright,
    /// Rotated by 180 degrees.
    Rotated,
    /// Left and right exchanged.
    Mirrored,
    /// Top and bottom exchanged, as in robosuite's frame buffer.
    Flipped,
}

impl Orientation {
    /// The name in profiles.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Upright => "upright",
            Self::Rotated => "rotated",
            Self::Mirrored => "mirrored",
            Self::Flipped => "flipped",
        }
    }

    fn is_upright(&self) -> bool {
        *self == Self::Upright
    }
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
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
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
    /// States of earlier actions that are sent with the present one, for example `[-2, -1, 0]`: two actions ago, one
    /// action ago, and now. They become the first axis of the array. Default: the present state, without this axis.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub history: Vec<i32>,
    /// Smallest value of each number in the training data of the checkpoint, as published with it.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub low: Vec<f64>,
    /// Largest value of each number in the training data of the checkpoint, as published with it.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub high: Vec<f64>,
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
    /// First number of the rotation vector of the tool.
    ToolAxisAngleX,
    /// Second number of the rotation vector of the tool.
    ToolAxisAngleY,
    /// Third number of the rotation vector of the tool.
    ToolAxisAngleZ,
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
    /// The first column of the tool's rotation matrix, then the second (6 numbers).
    ToolRot6dColumns,
    /// The first two columns of the tool's rotation matrix, row by row (6 numbers).
    ToolRot6dInterleaved,
    /// The first row of the tool's rotation matrix, then the second (6 numbers).
    ToolRot6dRows,
    /// Measured joint positions (one number for each joint of the arm).
    JointPositions,
    /// Finger positions as robosuite defines them for the Panda: plus and minus half of the opening (2 numbers).
    GripperFingers,
    /// Opening divided by the stroke of the gripper: 0 closed, 1 open.
    GripperOpenness,
    /// One minus the openness.
    GripperClosedness,
    /// 100 times the openness.
    GripperPercent,
    /// Opening in metres.
    GripperOpening,
    /// The number zero.
    Zero,
}

impl Part {
    pub(crate) fn size(self, joints: usize) -> usize {
        match self {
            Self::ToolPosition | Self::ToolAxisAngle | Self::ToolEuler => 3,
            Self::ToolQuaternionXyzw | Self::ToolQuaternionWxyz => 4,
            Self::ToolRot6dColumns | Self::ToolRot6dInterleaved | Self::ToolRot6dRows => 6,
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
            Self::GripperFingers
            | Self::GripperOpenness
            | Self::GripperClosedness
            | Self::GripperPercent
            | Self::GripperOpening => Some(vectors::GRIPPER_OPENING),
            _ => Some(vectors::TOOL_POSE),
        }
    }

    /// The vectors of robosuite's and LIBERO's environments that can replace [`Self::vector`]. They are in the world
    /// frame of the model already.
    pub(crate) fn robosuite(self) -> &'static [&'static str] {
        match self.vector() {
            Some(vectors::JOINT_POSITIONS) => &["joint_pos"],
            Some(vectors::GRIPPER_OPENING) => &["gripper_qpos"],
            Some(vectors::TOOL_POSE) => &["eef_pos", "eef_axis_angle"],
            _ => &[],
        }
    }

    /// Whether the value depends on `tool.stroke_m`.
    pub(super) fn needs_stroke(self) -> bool {
        matches!(self, Self::GripperOpenness | Self::GripperClosedness | Self::GripperPercent)
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
    /// Radians per unit of the model's joint positions. Default: 1.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub joint_unit_rad: Option<f64>,
    /// Full opening of the gripper in metres, for its openness.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub stroke_m: Option<f64>,
}
