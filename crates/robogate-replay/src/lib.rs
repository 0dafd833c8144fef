//! Recorded episodes: the motion of all bodies with contacts, commands, measures and events, for pages and exports.
//!
//! [`record`] runs an episode and returns a [`Recording`]. [`reel`] packs several of them, each as a [`Clip`], into one
//! JSON document for the viewer of a page. [`mcap`](mcap()) writes one episode for Foxglove and other tools, and
//! [`read_mcap`] reads what robots recorded. Equal recordings give equal bytes.
//!
//! The crate uses no file, socket, thread or clock.

mod clip;
mod mcap;
mod mesh;
mod pack;
mod recording;
mod reel;
mod signals;

pub use clip::{Clip, FilmFrame};
pub use mcap::{EncodedImage, Export, McapMessage, Sample, mcap, read_mcap};
pub use pack::{packed_floats, packed_integers};
pub use recording::{FRAME_PERIOD_S, Mark, Recorder, Recording, record, record_all, record_with};
pub use reel::{MESH_BUDGET_BYTES, Reel, reel};
pub use signals::{Clock, Signal};
