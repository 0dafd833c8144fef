//! Environments in servers: an episode has the result that it has in this process, or it is Invalid. No call waits for
//! longer than its timeout.

#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

mod conformance;
mod fuzz;
mod physics;
mod pool;
mod server;
#[path = "../../../robogate-zmtp/tests/support/mod.rs"]
mod support;
mod toy;
