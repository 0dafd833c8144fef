//! The claims of the dictionary, one module for each part.

mod common;
mod export;
mod hostile;
mod journal;
mod parquet;
mod published;
