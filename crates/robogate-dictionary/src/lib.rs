//! The failure dictionary: the record of every episode.
//!
//! While a campaign runs, each [`Entry`] is appended to a [`Journal`], which survives a `kill -9`. At the end the
//! entries, sorted by index, are written to one Parquet file ([`write_parquet`]), which [`Dictionary`] reads. The file
//! also contains the [`Provenance`] with the task. Neither file contains times or thread counts, so the same settings
//! give the same bytes. [`dataset_hash`] identifies the rows in any file format.
//!
//! [`published`] reads and writes the JSON of the dictionaries released with the paper, [`results`] reads the
//! per-episode results of other tools, and [`export`] writes CSV and JSON Lines. [`fixed_columns`] documents the fixed
//! columns. The other columns are the measures of the task and the parameters of the space.

mod atomic;
mod codec;
mod columns;
mod decode;
mod delta;
mod entry;
mod error;
pub mod export;
mod fields;
pub mod files;
mod formula;
pub mod frame;
mod hash;
mod identity;
mod journal;
mod journal_tail;
mod lost;
mod pages;
mod parquet;
mod platform;
pub mod provenance;
pub mod published;
mod raw;
pub mod results;
mod schema;
mod text;
pub mod v1;
mod world;

pub use columns::{FixedColumn, Kind, check_columns, fixed_columns};
pub use entry::{Entry, Label};
pub use error::{DictionaryError, RowPlace};
pub use formula::marked as spreadsheet_cell;
pub use hash::{DatasetHash, dataset_hash, file_digest, hex};
pub use identity::{TaskIdentity, suite_sha256};
pub use journal::{Journal, PlanHash, Recovery};
pub use journal_tail::JournalTail;
pub use lost::LostEpisode;
pub use parquet::{Column, Dictionary, DictionaryWriter, Entries, Written, write_parquet};
pub use platform::Platform;
pub use provenance::{
    Build, Dimensions, Engine, Provenance, Robot, RowSampling, Source, SourceColumn, Stopping, Tool, robot_sha256,
};
pub use schema::{SCHEMA_VERSION, SchemaVersion};
pub use text::{read_regular_text, read_text};
pub use world::{
    CellPlace, ComparedServers, ControlProblem, ControlResult, Controls, ExternalPolicyRecord, OnWarning, Place,
    PolicyRecord, PythonPlace, RendererRecord, Repeats, WORLD_VERSION, WarnerRecord, World,
};
