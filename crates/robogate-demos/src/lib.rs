//! Demonstrations for learning: what an expert saw and did, episode by episode.
//!
//! A [`Recorder`] stands between the expert and the simulator: it notes each observation and what the expert would do, and
//! may push the arm off the expert's path meanwhile ([`Push`]), so that what is learned includes the way back.
//! A [`Dataset`] writes the episodes in the layout of LeRobotDataset 3.0. Images are PNG in the Parquet files.

mod dataset;
mod moments;
mod push;
mod recorder;
mod table;

pub use dataset::{CODEBASE_VERSION, Dataset, DatasetError, Written};
pub use push::Push;
pub use recorder::{Demonstration, Frame, Picture, Recorder};
