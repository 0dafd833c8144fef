//! Tests of the service.
#![expect(clippy::disallowed_methods, reason = "tests measure times and find their settings in the environment")]
#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

mod common;
mod http;
mod killed;
mod mqtt;
mod outputs;
mod page;
mod store;
mod warnings;
