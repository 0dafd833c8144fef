//! Tests the statistical guarantees of the gate by enumeration, against SciPy and by simulation.

#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

mod binding;
mod common;
mod comparison;
mod errors;
mod evaluation;
mod evidence;
mod force_limits;
mod leaderboard;
mod planning;
mod production;
mod real;
mod requalification;
mod ruled_out;
mod score;
mod simulated;
mod table;
mod twins;
mod warner;
