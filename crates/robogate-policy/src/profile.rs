//! What a model was taught to see and how its answers are meant, as data.

use robogate_core::{Word, vectors};
use serde::{Deserialize, Serialize};

use super::array::Dtype;

/// All that stands between a cell and a model: a TOML file, built in or one's own.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Profile {
    /// The policy's name in records and rankings.
    pub name: String,
    /// Which model, in words.
    pub model: String,
    /// What whoever uses it should know.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub notes: String,
    /// What the model is told to do; the task's own words where it is left out.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub instruction: Option<String>,
    /// How the server speaks.
    pub dialect: Dialect,
    /// Width and height in pixels at which the cell's own cameras draw for it; left out, 256. What a policy was taught
    /// on small pictures it shall not see made from large ones: they are smoother.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub rendered_px: Option<usize>,
    /// The pictures, in the order in which they are sent.
    #[serde(default, rename = "camera", skip_serializing_if = "Vec::is_empty")]
    pub cameras: Vec<Camera>,
    /// The vectors, in the order in which they are sent.
    #[serde(default, rename = "state", skip_serializing_if = "Vec::is_empty")]
    pub states: Vec<State>,
    /// How the model sees the tool.
    #[serde(default)]
    pub tool: Tool,
    /// What the numbers of an action mean.
    pub action: ActionForm,
    /// How many actions come at once, and how many of them are executed.
    pub chunk: Chunking,
    /// Deadlines and reconnects.
    #[serde(default)]
    pub server: Patience,
}

/// How a server speaks, with the settings that only that dialect has.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(tag = "name", deny_unknown_fields)]
pub enum Dialect {
    /// openpi's `serve_policy.py`: WebSocket, msgpack with binary keys.
    #[serde(rename = "openpi")]
    Openpi {},
    /// RoboArena's: the same encoding, with a description of itself and sessions.
    #[serde(rename = "roboarena")]
    RoboArena {},
    /// Isaac GR00T N1.5's `inference_service.py --server`: ZeroMQ, msgpack with `.npy` in it.
    #[serde(rename = "gr00t-n1.5")]
    Gr00tN15(Gr00t),
    /// Isaac GR00T N1.6's `run_gr00t_server.py`, with or without the simulation wrapper.
    #[serde(rename = "gr00t-n1.6")]
    Gr00tN16(Gr00t),
    /// N1.5's `--http-server`.
    #[serde(rename = "gr00t-n1.5-http")]
    Gr00tN15Http(Gr00t),
    /// OpenVLA's `vla-scripts/deploy.py`: HTTP, JSON with arrays in base64.
    #[serde(rename = "openvla")]
    OpenVla {
        /// Which training set's statistics scale the answer.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        unnorm_key: Option<String>,
    },
    /// OpenVLA-OFT's `vla-scripts/deploy.py`.
    #[serde(rename = "openvla-oft")]
    OpenVlaOft {},
    /// The `/act`, `/reset`, `/health` convention by which Octo is served.
    #[serde(rename = "rest")]
    Rest {
        /// Which training set's statistics scale the answer, for servers that take it.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        unnorm_key: Option<String>,
    },
    /// LeRobot's `policy_server`: gRPC, pickles.
    #[serde(rename = "lerobot")]
    LeRobot(LeRobot),
    /// vla-eval's model servers: WebSocket, msgpack with text keys.
    #[serde(rename = "vla-eval")]
    VlaEval {},
    /// No server: a network in an ONNX file, whose path is the address. Keys are the names of its inputs.
    #[serde(rename = "onnx")]
    Onnx {},
}

/// What a LeRobot server is told to load.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LeRobot {
    /// The kind of policy: `smolvla`, `act`, `pi0`, ...
    pub policy_type: String,
    /// A repository of checkpoints, or a folder on the server's machine.
    pub checkpoint: String,
    /// Where the server runs it: `cpu` or `cuda`.
    #[serde(default = "cpu")]
    pub device: String,
}

fn cpu() -> String {
    "cpu".to_owned()
}

/// The names that a GR00T server's embodiment gives its parts.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Gr00t {
    /// The arrays that make an action, in the order of its numbers, without `action.` before them.
    pub action_keys: Vec<String>,
    /// The instruction's key.
    pub language_key: String,
}

impl Dialect {
    /// The dialect's name.
    pub fn name(&self) -> &'static str {
        match self {
            Self::Openpi {} => "openpi",
            Self::RoboArena {} => "roboarena",
            Self::Gr00tN15(_) => "gr00t-n1.5",
            Self::Gr00tN16(_) => "gr00t-n1.6",
            Self::Gr00tN15Http(_) => "gr00t-n1.5-http",
            Self::OpenVla { .. } => "openvla",
            Self::OpenVlaOft {} => "openvla-oft",
            Self::Rest { .. } => "rest",
            Self::VlaEval {} => "vla-eval",
            Self::LeRobot(_) => "lerobot",
            Self::Onnx {} => "onnx",
        }
    }

    /// What an address of such a server looks like.
    pub fn address(&self) -> String {
        match self {
            Self::Onnx {} => "FILE.onnx".to_owned(),
            _ => format!("{}HOST:PORT", self.scheme()),
        }
    }

    /// How the address of such a server begins.
    pub(crate) fn scheme(&self) -> &'static str {
        match self {
            Self::Openpi {} | Self::RoboArena {} | Self::VlaEval {} => "ws://",
            Self::Gr00tN15(_) | Self::Gr00tN16(_) => "tcp://",
            Self::Gr00tN15Http(_) | Self::OpenVla { .. } | Self::OpenVlaOft {} | Self::Rest { .. } => "http://",
            Self::LeRobot(_) => "grpc://",
            Self::Onnx {} => "",
        }
    }

    /// Whether its address is a file's.
    pub fn is_file(&self) -> bool {
        matches!(self, Self::Onnx {})
    }

    /// Whether the server keeps one state for all who ask: then only one evaluator may.
    pub fn one_at_a_time(&self) -> bool {
        // Octo's server keeps the last pictures and the instruction until /reset, LeRobot's all that it has.
        matches!(self, Self::Rest { .. } | Self::LeRobot(_))
    }
}

/// A picture that the model wants.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Camera {
    /// The cell's camera: `front` or `wrist`.
    pub from: String,
    /// The server's name for it.
    pub key: String,
    /// Pixels in a row.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// How it is made to fit.
    #[serde(default)]
    pub fit: Fit,
    /// How it is resampled.
    #[serde(default)]
    pub filter: Filter,
    /// Whether it is turned by 180 degrees: LIBERO's pictures are upside down, and its models were taught on
    /// pictures that were turned.
    #[serde(default)]
    pub turned: bool,
    /// Share of each side that a crop of the middle keeps, before resizing.
    #[serde(default = "one")]
    pub crop: f64,
    /// The order of the array's axes.
    #[serde(default)]
    pub axes: Axes,
}

fn one() -> f64 {
    1.0
}

/// How a picture is made to fit.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Fit {
    /// Undistorted, with black about it.
    #[default]
    Pad,
    /// Each side by itself.
    Stretch,
}

/// How a picture is resampled.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Filter {
    /// Pillow's bilinear filter.
    #[default]
    Bilinear,
    /// Pillow's Lanczos filter, of three lobes.
    Lanczos,
}

/// The order of a picture's axes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Axes {
    /// Height, width, colour.
    #[default]
    Hwc,
    /// Colour, height, width.
    Chw,
}

/// A vector that the model wants.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct State {
    /// The server's name for it.
    pub key: String,
    /// What it is made of, in order.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub parts: Vec<Part>,
    /// Vectors of the task's observation by name, after the parts, as they are observed.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub vectors: Vec<Word>,
    /// Its numbers' type: `<f4` or `<f8`.
    #[serde(default = "double", rename = "type")]
    pub dtype: Dtype,
}

fn double() -> Dtype {
    Dtype::F64
}

impl State {
    /// How many numbers its parts have, for an arm of so many joints; vectors are not counted.
    pub fn size(&self, joints: usize) -> usize {
        self.parts.iter().map(|part| part.size(joints)).sum()
    }
}

/// A part of a state vector. Positions are in metres in the base frame, angles in radians.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Part {
    /// Of the tool centre point (3).
    ToolPosition,
    /// The first of it.
    ToolX,
    /// The second.
    ToolY,
    /// The third.
    ToolZ,
    /// The tool's rotation vector, by robosuite's formula (3).
    ToolAxisAngle,
    /// Roll, pitch and yaw (3).
    ToolEuler,
    /// The first of them.
    ToolRoll,
    /// The second.
    ToolPitch,
    /// The third.
    ToolYaw,
    /// The tool's quaternion, scalar last (4).
    ToolQuaternionXyzw,
    /// The tool's quaternion, scalar first (4).
    ToolQuaternionWxyz,
    /// Measured joint positions (as many as the arm has).
    JointPositions,
    /// The fingers' positions as robosuite has them for the Panda: plus and minus half the opening (2).
    GripperFingers,
    /// The opening over the gripper's stroke: 0 closed, 1 open.
    GripperOpenness,
    /// One minus the openness.
    GripperClosedness,
    /// The opening in metres.
    GripperOpening,
    /// A zero.
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

    /// The vector of the observation that it is made from.
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

    pub(crate) fn is_share_of_stroke(self) -> bool {
        matches!(self, Self::GripperOpenness | Self::GripperClosedness)
    }
}

/// How the model sees the tool, where its world differs from the cell.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Tool {
    /// Added to the tool's position, in metres: where the robot's base stands in the model's world.
    #[serde(default)]
    pub shift_m: [f64; 3],
    /// The model's tool frame in the cell's, as roll, pitch and yaw in radians.
    #[serde(default)]
    pub turn_rad: [f64; 3],
    /// The gripper's full opening in metres, for its openness.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub stroke_m: Option<f64>,
}

/// What the numbers of an action mean.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ActionForm {
    /// How many numbers it has. The last one is the gripper's, unless `arm` is `vector`.
    pub size: usize,
    /// What the others are.
    pub arm: Arm,
    /// How a turn is written.
    #[serde(default)]
    pub rotation: Rotation,
    /// Metres that a one stands for.
    #[serde(default = "position_scale")]
    pub position_scale_m: f64,
    /// Radians that a one stands for.
    #[serde(default = "rotation_scale")]
    pub rotation_scale_rad: f64,
    /// The arm's numbers are cut to this size before they are scaled; left out, they are not.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub clip: Option<f64>,
    /// Where the gripper's number turns from one command to the other. Required unless `arm` is `vector`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub gripper_threshold: Option<f64>,
    /// Which side of it is open. Required unless `arm` is `vector`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub gripper_open: Option<Side>,
}

/// The paper's scale of positions (section 7.1).
fn position_scale() -> f64 {
    0.02
}

/// The paper's scale of rotations (section 7.1).
fn rotation_scale() -> f64 {
    0.05
}

/// What an action tells the arm.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Arm {
    /// Three numbers of way and three of turn, along and about the axes of the base frame.
    ToolDelta,
    /// A position for each joint, in radians.
    JointPositions,
    /// A way for each joint from where it was measured; a one is `rotation_scale_rad`.
    JointDeltas,
    /// The numbers of the task's own action vector, clipped to its bounds; no gripper beside them.
    Vector,
}

/// How a turn is written.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Rotation {
    /// A rotation vector.
    #[default]
    AxisAngle,
    /// Roll, pitch and yaw: turns about fixed axes, in this order.
    Euler,
}

/// One side of a threshold.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Side {
    /// Greater than it.
    Above,
    /// Less than it.
    Below,
}

/// How many actions come at once, and how many of them are executed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Chunking {
    /// Actions in an answer; left out, any number from `execute` on.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub length: Option<usize>,
    /// How many of them are executed before the server is asked again.
    pub execute: usize,
}

/// Deadlines and reconnects.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Patience {
    /// For a connection, and what a server says of itself, in seconds.
    pub connect_s: f64,
    /// For the first answer on a connection, in seconds: models are compiled on it.
    pub first_answer_s: f64,
    /// For each later answer, in seconds.
    pub answer_s: f64,
    /// How often a connection is tried before an episode is given up. The waits between are 1, 2, 4, 8 s and so on.
    pub attempts: u32,
}

impl Default for Patience {
    fn default() -> Self {
        Self { connect_s: 20.0, first_answer_s: 300.0, answer_s: 30.0, attempts: 5 }
    }
}

/// A profile that cannot be used.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum ProfileError {
    /// Not the TOML of a profile. The message has line and column.
    #[error("no profile: {0}")]
    Form(String),
    /// A value that makes no sense.
    #[error("{field}: {why}")]
    Value {
        /// Its path in the file.
        field: String,
        /// What is wrong, and what would be right.
        why: String,
    },
}

/// The built-in profiles, by name.
const BUILT_IN: &[(&str, &str)] = &[
    ("gr00t-n1.6", include_str!("profiles/gr00t-n1.6.toml")),
    ("gr00t-n1.6-libero", include_str!("profiles/gr00t-n1.6-libero.toml")),
    ("pi0-libero", include_str!("profiles/pi0-libero.toml")),
    ("openvla", include_str!("profiles/openvla.toml")),
    ("openvla-oft", include_str!("profiles/openvla-oft.toml")),
    ("smolvla-vla-eval", include_str!("profiles/smolvla-vla-eval.toml")),
    ("smolvla", include_str!("profiles/smolvla.toml")),
    ("octo-base", include_str!("profiles/octo-base.toml")),
    ("octo-small", include_str!("profiles/octo-small.toml")),
    ("droid-roboarena", include_str!("profiles/droid-roboarena.toml")),
    ("learned", include_str!("profiles/learned.toml")),
];

impl Profile {
    /// The names of the built-in profiles.
    pub fn built_in_names() -> impl Iterator<Item = &'static str> {
        BUILT_IN.iter().map(|(name, _)| *name)
    }

    /// The text of a built-in profile.
    pub fn built_in(name: &str) -> Option<&'static str> {
        BUILT_IN.iter().find(|(known, _)| *known == name).map(|(_, text)| *text)
    }

    /// From TOML, checked.
    pub fn from_toml(text: &str) -> Result<Self, ProfileError> {
        let profile: Self = toml::from_str(text).map_err(|e| ProfileError::Form(e.to_string()))?;
        profile.check()?;
        Ok(profile)
    }

    /// Whether it makes sense.
    pub fn check(&self) -> Result<(), ProfileError> {
        let wrong = |field: &str, why: String| Err(ProfileError::Value { field: field.to_owned(), why });
        let name_fits = |c: char| c.is_ascii_alphanumeric() || matches!(c, '-' | '_' | '.');
        if self.name.is_empty() || self.name.len() > 64 || !self.name.chars().all(name_fits) {
            return wrong("name", format!("`{}` is no name: letters, digits, `-`, `_` and `.`", self.name));
        }
        if let Some(side) = self.rendered_px
            && !(8..=MAX_SIDE).contains(&side)
        {
            return wrong("rendered_px", format!("{side} is not between 8 and {MAX_SIDE} pixels"));
        }
        for (i, camera) in self.cameras.iter().enumerate() {
            let at = |field: &str| format!("camera[{i}].{field}");
            for (field, side) in [("width", camera.width), ("height", camera.height)] {
                if !(1..=MAX_SIDE).contains(&side) {
                    return wrong(&at(field), format!("{side} is not between 1 and {MAX_SIDE} pixels"));
                }
            }
            if !(camera.crop > 0.0 && camera.crop <= 1.0) {
                return wrong(&at("crop"), format!("{} is no share of a side: above 0, at most 1", camera.crop));
            }
            if self.cameras[..i].iter().any(|other| other.key == camera.key) {
                return wrong(&at("key"), format!("`{}` is sent twice", camera.key));
            }
        }
        for (i, state) in self.states.iter().enumerate() {
            if state.parts.is_empty() && state.vectors.is_empty() {
                return wrong(&format!("state[{i}].parts"), "nothing in it".to_owned());
            }
            if !matches!(state.dtype, Dtype::F32 | Dtype::F64) {
                return wrong(&format!("state[{i}].type"), format!("{}: states are <f4 or <f8", state.dtype.name()));
            }
            if self.states[..i].iter().any(|other| other.key == state.key) {
                return wrong(&format!("state[{i}].key"), format!("`{}` is sent twice", state.key));
            }
        }
        let of_stroke = self.states.iter().flat_map(|state| &state.parts).any(|part| part.is_share_of_stroke());
        if of_stroke && self.tool.stroke_m.is_none() {
            return wrong("tool.stroke_m", "left out, but a state has the gripper's openness".to_owned());
        }
        let positive = [
            ("action.position_scale_m", self.action.position_scale_m),
            ("action.rotation_scale_rad", self.action.rotation_scale_rad),
            ("action.clip", self.action.clip.unwrap_or(1.0)),
            ("tool.stroke_m", self.tool.stroke_m.unwrap_or(1.0)),
            ("server.connect_s", self.server.connect_s),
            ("server.first_answer_s", self.server.first_answer_s),
            ("server.answer_s", self.server.answer_s),
        ];
        for (field, value) in positive {
            if !(value.is_finite() && value > 0.0) {
                return wrong(field, format!("{value} is not above zero"));
            }
        }
        for (field, value) in [
            ("connect_s", self.server.connect_s),
            ("answer_s", self.server.answer_s),
            ("first_answer_s", self.server.first_answer_s),
        ] {
            if value > MAX_DEADLINE_S {
                return wrong(&format!("server.{field}"), format!("{value} s is more than a day"));
            }
        }
        if !(1..=MAX_ATTEMPTS).contains(&self.server.attempts) {
            return wrong("server.attempts", format!("{} is not between 1 and {MAX_ATTEMPTS}", self.server.attempts));
        }
        let finite = [("tool.shift_m", self.tool.shift_m), ("tool.turn_rad", self.tool.turn_rad)];
        if let Some((field, _)) = finite.iter().find(|(_, v)| !v.iter().all(|n| n.is_finite())) {
            return wrong(field, "not finite".to_owned());
        }
        if self.action.gripper_threshold.is_some_and(|threshold| !threshold.is_finite()) {
            return wrong("action.gripper_threshold", "not finite".to_owned());
        }
        let gripper = [
            ("action.gripper_threshold", self.action.gripper_threshold.is_some()),
            ("action.gripper_open", self.action.gripper_open.is_some()),
        ];
        let vector = self.action.arm == Arm::Vector;
        if let Some((field, _)) = gripper.iter().find(|(_, given)| *given == vector) {
            let why = if vector { "not used with arm = \"vector\": remove it" } else { "missing" };
            return wrong(field, why.to_owned());
        }
        match (self.action.arm, self.action.size) {
            (Arm::ToolDelta, 7) => {}
            (Arm::ToolDelta, size) => {
                return wrong(
                    "action.size",
                    format!("{size}, but arm = \"tool_delta\" has 7 numbers: 3 of way, 3 of turn, 1 of the gripper"),
                );
            }
            (Arm::Vector, 1..=1024) | (Arm::JointPositions | Arm::JointDeltas, 2..=64) => {}
            (Arm::Vector, size) => return wrong("action.size", format!("{size} is not between 1 and 1024")),
            (_, size) => return wrong("action.size", format!("{size} is no number of joints and a gripper")),
        }
        if matches!(self.dialect, Dialect::LeRobot(_)) && self.chunk.length.is_none() {
            return wrong(
                "chunk.length",
                "left out, but a lerobot server is told how many actions to answer".to_owned(),
            );
        }
        let keys = match &self.dialect {
            Dialect::Gr00tN15(names) | Dialect::Gr00tN16(names) | Dialect::Gr00tN15Http(names) => {
                Some(&names.action_keys)
            }
            _ => None,
        };
        if keys.is_some_and(Vec::is_empty) {
            return wrong("dialect.action_keys", "nothing in it".to_owned());
        }
        let Chunking { length, execute } = self.chunk;
        if execute == 0 || execute > MAX_CHUNK {
            return wrong("chunk.execute", format!("{execute} is not between 1 and {MAX_CHUNK}"));
        }
        if let Some(length) = length
            && !(execute..=MAX_CHUNK).contains(&length)
        {
            return wrong("chunk.length", format!("{length} is not between `execute` ({execute}) and {MAX_CHUNK}"));
        }
        Ok(())
    }
}

/// Longest side of a picture.
const MAX_SIDE: usize = 4096;
/// Most actions in an answer.
pub(crate) const MAX_CHUNK: usize = 1000;
/// Most connection attempts: the last wait is then about eight minutes.
const MAX_ATTEMPTS: u32 = 10;
const MAX_DEADLINE_S: f64 = 86_400.0;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_built_in_profile_holds_and_says_its_own_name() {
        for name in Profile::built_in_names() {
            let profile = Profile::from_toml(Profile::built_in(name).unwrap()).unwrap();
            assert_eq!(profile.name, name);
            // As a run records it.
            let json = serde_json::to_string(&profile).unwrap();
            assert_eq!(serde_json::from_str::<Profile>(&json).unwrap(), profile, "{name}");
        }
    }

    #[test]
    fn what_is_wrong_with_a_profile_is_said_with_its_place() {
        let good = Profile::built_in("pi0-libero").unwrap();
        for (from, to, words) in [
            ("size = 7", "size = 6", "action.size: 6, but"),
            ("execute = 5", "execute = 51", "chunk.length: 50 is not between `execute` (51)"),
            ("execute = 5", "execute = 0", "chunk.execute: 0 is not"),
            ("width = 224", "width = 0", "camera[0].width: 0 is not"),
            ("observation/wrist_image", "observation/image", "camera[1].key: `observation/image` is sent twice"),
            ("gripper_fingers", "gripper_openness", "tool.stroke_m: left out"),
            ("clip = 1.0", "clip = -1.0", "action.clip: -1 is not above zero"),
            ("position_scale_m = 0.02", "position_scale_m = nan", "action.position_scale_m: NaN"),
            ("name = \"pi0-libero\"", "name = \"a b\"", "name: `a b` is no name"),
            ("\"below\"", "\"beneath\"", "TOML parse error at line"),
            ("clip = 1.0", "clap = 1.0", "unknown field `clap`"),
            ("name = \"openpi\"", "name = \"openqi\"", "openqi"),
        ] {
            let error = Profile::from_toml(&good.replacen(from, to, 1)).unwrap_err().to_string();
            assert!(error.contains(words), "{error}");
        }
    }
}
