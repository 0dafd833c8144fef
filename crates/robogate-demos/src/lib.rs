//! Demonstrations for learning: the observations and actions of an expert, recorded per episode.
//!
//! A [`Recorder`] wraps the expert and records each observation and the expert's action. It can push the arm off the
//! expert's path ([`Push`]), so the data include recoveries. A [`Dataset`] writes the episodes in the layout of
//! LeRobotDataset 3.0. Images are stored as PNG in the Parquet files.

mod dataset;
mod moments;
mod push;
mod recorder;
mod table;

pub use dataset::{CODEBASE_VERSION, Dataset, DatasetError, Written};
pub use push::Push;
pub use recorder::{Demonstration, Frame, Picture, Recorder, Told};
