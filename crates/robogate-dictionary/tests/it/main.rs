//! Tests of the dictionary, one module per part.
#![expect(clippy::disallowed_methods, reason = "tests measure times and find their settings in the environment")]
#![expect(clippy::unwrap_used, reason = "test helpers fail by panicking")]

#[global_allocator]
static MEMORY: robogate_testing::CountingAllocator = robogate_testing::CountingAllocator;

mod audit;
mod bombs;
mod common;
mod export;
mod exported;
mod files;
mod foreign_files;
mod fuzz;
mod hostile;
mod journal;
mod parquet;
mod published;
mod raw_parquet;
mod results;
