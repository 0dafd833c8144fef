//! Environments that run in Python: the interpreter, the embedded package, and the processes.

mod imported;
mod package;
mod process;
mod python;
mod servers;

pub use imported::ENVIRONMENT;
pub(crate) use imported::{check_beside, kept};
pub(crate) use python::cache;
pub use python::{Interpreter, installed, installed_marker};
pub use servers::Servers;

/// The families of bundled environments, as `robogate_eval.environments.FAMILIES` has them.
pub const BUNDLED: [&str; 6] = ["metaworld", "fetch", "robosuite", "libero", "dm_control", "warp"];
