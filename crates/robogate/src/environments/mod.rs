//! Environments that run in Python: the interpreter, the embedded package, and the processes.

mod package;
mod process;
mod python;
mod servers;

pub(crate) use python::{Interpreter, installed, installed_marker};
pub(crate) use servers::Servers;

/// The families of bundled environments, as `robogate_eval.environments.FAMILIES` has them.
pub(crate) const BUNDLED: [&str; 5] = ["metaworld", "fetch", "robosuite", "libero", "dm_control"];
