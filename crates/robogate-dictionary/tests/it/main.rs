//! Tests of the dictionary, one module for each part.
#![expect(clippy::disallowed_methods, reason = "tests measure times and find their settings in the environment")]
#![expect(clippy::unwrap_used, reason = "helpers of tests are tests, which may")]

mod common;
mod export;
mod exported;
mod fuzz;
mod hostile;
mod journal;
mod parquet;
mod published;
mod results;
mod v0_1;
