//! Tests of campaigns with a small synthetic environment.
#![expect(clippy::disallowed_methods, reason = "tests measure times and find their settings in the environment")]
#![expect(clippy::unwrap_used, reason = "test helpers fail by panicking")]

mod active;
mod batch;
mod boundary;
mod determinism;
mod faults;
mod folder;
mod follow;
mod merge_speed;
mod overhead;
mod plan;
mod rows;
mod shards;
mod suite;
mod world;
