//! Policies behind sockets: each model's own inference server, over its own wire format.
//!
//! A [`Profile`] says what a model was taught to see and how its answers are meant. A dialect, one file each, says how
//! its server speaks. [`ServerPolicy`] is both, as the [`Policy`](robogate_core::Policy) that runs an episode. Whatever
//! goes wrong on the way is a [`ServerError`] with a name, and becomes a fault: never a failure of the policy.

mod array;
mod error;
mod exchange;
mod gr00t;
mod grpc;
mod http;
mod identify;
mod json_numpy;
mod lerobot;
mod link;
mod msgpack;
mod npy;
#[cfg(feature = "onnx")]
mod onnx;
mod openpi;
mod pickle;
mod picture;
mod profile;
mod resample;
mod rest;
mod roboarena;
mod rotation;
mod server;
mod spare;
mod suits;
#[cfg(test)]
mod tests;
mod vla_eval;
mod websocket;

pub use array::{Array, Dtype, NotAnArray};
pub use error::ServerError;
pub use exchange::{Chunk, Query};
pub use picture::Picture;
pub use profile::{
    ActionForm, Arm, Axes, Camera, Chunking, Dialect, Filter, Fit, Gr00t, LeRobot, Part, Patience, Profile,
    ProfileError, Rotation, Side, State, Tool,
};
pub use server::ServerPolicy;
