//! What a campaign promises, held against a small synthetic world.
#![expect(clippy::disallowed_methods, reason = "tests measure times and find their settings in the environment")]
#![expect(clippy::unwrap_used, reason = "helpers of tests are tests, which may")]

mod boundary;
mod determinism;
mod faults;
mod folder;
mod overhead;
mod plan;
mod suite;
mod world;
