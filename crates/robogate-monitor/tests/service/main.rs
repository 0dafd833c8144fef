//! The claims about the service.
#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

mod common;
mod http;
mod killed;
mod mqtt;
mod outputs;
mod page;
mod store;
