//! What the gate claims, held to counts, to SciPy and to simulation.

#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

mod common;
mod comparison;
mod errors;
mod evaluation;
mod evidence;
mod planning;
mod score;
mod simulated;
mod table;
