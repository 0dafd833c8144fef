//! Tests of the monitor library.
#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

mod changes;
mod common;
mod paper_rule;
mod promise;
mod warn;
