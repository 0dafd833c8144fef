//! Tests of remote environments: an episode has the same result as in this process, or it is invalid. No call waits
//! longer than its timeout.

#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

mod conformance;
mod fuzz;
mod motion;
mod physics;
mod pool;
mod server;
#[path = "../../../robogate-zmtp/tests/support/mod.rs"]
mod support;
mod toy;
