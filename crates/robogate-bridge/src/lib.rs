//! The far side of a socket: policy servers and other simulators, and how they speak.

pub mod policy;
pub mod simulator;
pub mod zmtp;
