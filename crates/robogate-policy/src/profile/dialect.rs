//! Dialects: the wire formats of inference servers.

use serde::{Deserialize, Serialize};

/// The wire format of a server, with the settings that only this dialect has.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(tag = "name", deny_unknown_fields)]
pub enum Dialect {
    /// openpi's `serve_policy.py`: WebSocket, msgpack with binary keys.
    #[serde(rename = "openpi")]
    Openpi {
        /// What separates the names of nested maps in the keys of cameras and states: with `/`, the key `images/cam_high` is the
        /// entry `cam_high` of the map `images`. `None`: a key is one name.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        separator: Option<char>,
    },
    /// RoboArena: the encoding of openpi, with server metadata and sessions.
    #[serde(rename = "roboarena")]
    RoboArena {},
    /// Isaac GR00T N1.5's `inference_service.py --server`: ZeroMQ, msgpack that contains `.npy` files.
    #[serde(rename = "gr00t-n1.5")]
    Gr00tN15(Gr00t),
    /// Isaac GR00T N1.6's `run_gr00t_server.py`, with or without the simulation wrapper.
    #[serde(rename = "gr00t-n1.6")]
    Gr00tN16(Gr00t),
    /// Isaac GR00T N1.5's `inference_service.py --http-server`.
    #[serde(rename = "gr00t-n1.5-http")]
    Gr00tN15Http(Gr00t),
    /// OpenVLA's `vla-scripts/deploy.py`: HTTP, JSON with arrays in base64.
    #[serde(rename = "openvla")]
    OpenVla {
        /// Training set whose statistics scale the actions.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        unnorm_key: Option<String>,
    },
    /// OpenVLA-OFT's `vla-scripts/deploy.py`.
    #[serde(rename = "openvla-oft")]
    OpenVlaOft {},
    /// The `/act`, `/reset`, `/health` convention of servers for Octo.
    #[serde(rename = "rest")]
    Rest {
        /// Training set whose statistics scale the actions, for servers that need it.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        unnorm_key: Option<String>,
    },
    /// LeRobot's `policy_server`: gRPC, pickles.
    #[serde(rename = "lerobot")]
    LeRobot(LeRobot),
    /// Model servers of vla-eval: WebSocket, msgpack with text keys.
    #[serde(rename = "vla-eval")]
    VlaEval {},
    /// StarVLA's `deployment/model_server`: WebSocket, the arrays of openpi in a list of examples.
    #[serde(rename = "starvla")]
    StarVla {
        /// Training set whose statistics scale the actions, for checkpoints with several.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        unnorm_key: Option<String>,
    },
    /// XPolicyLab's `client_server/ws`: WebSocket, frames of msgpack.
    #[serde(rename = "xpolicylab")]
    XPolicyLab {
        /// Parts that make up an action, in the order of its numbers, for example `left_arm_joint_state`.
        action_keys: Vec<String>,
    },
    /// A network in an ONNX file instead of a server. Keys are the names of its inputs.
    #[serde(rename = "onnx")]
    Onnx {},
}

/// The checkpoint that a LeRobot server loads.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LeRobot {
    /// Type of the policy: `smolvla`, `act`, `pi0`, ...
    pub policy_type: String,
    /// Repository of the checkpoint, or a folder on the machine of the server.
    pub checkpoint: String,
    /// Device on which the server runs the policy: `cpu` or `cuda`.
    #[serde(default = "cpu")]
    pub device: String,
}

fn cpu() -> String {
    "cpu".to_owned()
}

/// Names that the embodiment of a GR00T server uses.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Gr00t {
    /// Arrays that make up an action, in the order of its numbers, without the prefix `action.`.
    pub action_keys: Vec<String>,
    /// Key of the instruction.
    pub language_key: String,
}

impl Dialect {
    /// Name of the dialect in profiles.
    pub fn name(&self) -> &'static str {
        match self {
            Self::Openpi { .. } => "openpi",
            Self::RoboArena {} => "roboarena",
            Self::Gr00tN15(_) => "gr00t-n1.5",
            Self::Gr00tN16(_) => "gr00t-n1.6",
            Self::Gr00tN15Http(_) => "gr00t-n1.5-http",
            Self::OpenVla { .. } => "openvla",
            Self::OpenVlaOft {} => "openvla-oft",
            Self::Rest { .. } => "rest",
            Self::VlaEval {} => "vla-eval",
            Self::LeRobot(_) => "lerobot",
            Self::StarVla { .. } => "starvla",
            Self::XPolicyLab { .. } => "xpolicylab",
            Self::Onnx {} => "onnx",
        }
    }

    /// Expected form of the address of a policy with this dialect.
    pub fn address(&self) -> String {
        match self {
            Self::Onnx {} => "FILE.onnx".to_owned(),
            _ => format!("{}HOST:PORT", self.scheme()),
        }
    }

    /// Prefix of the address of a policy with this dialect.
    pub(crate) fn scheme(&self) -> &'static str {
        match self {
            Self::Openpi { .. }
            | Self::RoboArena {}
            | Self::VlaEval {}
            | Self::StarVla { .. }
            | Self::XPolicyLab { .. } => "ws://",
            Self::Gr00tN15(_) | Self::Gr00tN16(_) => "tcp://",
            Self::Gr00tN15Http(_) | Self::OpenVla { .. } | Self::OpenVlaOft {} | Self::Rest { .. } => "http://",
            Self::LeRobot(_) => "grpc://",
            Self::Onnx {} => "",
        }
    }

    /// Whether its servers declare the names of their inputs and outputs, or the size of their images.
    pub fn declares_modalities(&self) -> bool {
        matches!(self, Self::Gr00tN15(_) | Self::Gr00tN16(_) | Self::RoboArena {})
    }

    /// Whether the address is the path of a file.
    pub fn is_file(&self) -> bool {
        matches!(self, Self::Onnx {})
    }

    /// Whether a request contains an instruction.
    pub fn uses_language(&self) -> bool {
        !self.is_file()
    }

    /// Whether the server has one state for all clients. Only one client may then use it.
    pub fn one_at_a_time(&self) -> bool {
        // Octo's server keeps the last images and the instruction until /reset. LeRobot's server has global state, and XPolicyLab's
        // has one model that all clients reset.
        matches!(self, Self::Rest { .. } | Self::LeRobot(_) | Self::XPolicyLab { .. })
    }
}
