//! External policies: models behind inference servers, and networks in ONNX files.
//!
//! A [`Profile`] maps the observations and actions of a model to those of the task. A dialect, one module each,
//! implements the wire format of a server. [`ExternalPolicy`] combines both as a [`Policy`](robogate_core::Policy).
//! Each failure of the connection or the server is a [`PolicyError`]. It becomes a fault of the episode, and never a
//! failure of the policy.

mod access;
mod array;
mod buffers;
mod checkpoint;
mod chunk;
mod connection;
mod control;
mod deadline;
mod decoder;
mod draft;
mod encoder;
mod error;
mod external;
mod fingerprint;
mod gr00t;
mod grpc;
mod history;
mod http;
mod identify;
mod json_numpy;
mod lerobot;
mod map;
mod mapping;
mod msgpack;
mod npy;
#[cfg(feature = "onnx")]
mod onnx;
mod openpi;
mod osc;
mod pickle;
mod picture;
mod profile;
mod query;
mod ranges;
mod resample;
mod rest;
mod roboarena;
mod rotation;
mod servers;
mod starvla;
mod statistics;
mod suits;
#[cfg(test)]
mod tests;
mod tls;
mod vla_eval;
mod websocket;
mod xpolicylab;

pub use access::Access;
pub use array::{Array, Dtype, InvalidArray};
pub use checkpoint::{Checkpoint, CheckpointError};
pub use chunk::Chunk;
pub use control::{RandomModel, ThroughProfile};
pub use decoder::Decoder;
pub use draft::{Draft, declared, draft};
pub use encoder::{Encoder, outside_range, read_pose, state_numbers, state_sizes};
pub use error::PolicyError;
pub use external::ExternalPolicy;
pub use fingerprint::{
    Admission, Asked, CameraCheck, CellImage, Fingerprint, Likeness, MOST_PROBES, Probe, Recorder, admit,
    compare_camera,
};
pub use identify::dialects_at;
pub use map::{BoundMap, CameraPiece, MapRow, Mapped, Piece, Pieces, Slice, Source, TaskMap, Unmapped, map_table};
pub use mapping::{MappingProblem, MappingStep, compare_mappings};
#[cfg(feature = "onnx")]
pub use onnx::{NetworkDraft, draft_network};
pub use picture::Picture;
pub use profile::{
    ActionForm, Arm, Axes, Camera, Chunking, Dialect, Filter, Fit, Frame, Gr00t, LeRobot, Memory, Orientation, Part,
    Profile, ProfileError, Rotation, Side, State, Timeouts, Tool,
};
pub use query::{Query, tool_pose};
pub use ranges::{RangeCounts, RangeMeasures, with_range_measures};
pub use servers::{Servers, Usage};
pub use statistics::{Statistics, StatisticsError};
pub use suits::check_task;
pub use websocket::{Incoming, TextSocket};
