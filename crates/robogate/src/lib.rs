//! Public constants of the command `robogate`, for programs that run it.

pub mod exit_codes;
