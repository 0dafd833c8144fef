//! The claims of the dictionary, one module for each part.

mod common;
mod journal;
mod parquet;
