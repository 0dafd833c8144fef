//! REQ and REP sockets of ZeroMQ over TCP.
//!
//! The crate implements the parts of ZMTP 3 (RFC 23 and 37) that these sockets need, with the NULL security mechanism.
//!
//! A [`Requester`] sends requests, and a [`Replier`] answers them. Both block, with a deadline for each call. The size
//! of received data is checked before memory is allocated for it.

mod address;
mod connection;
mod decoder;
mod error;
mod replier;
mod requester;

pub use address::Address;
pub use decoder::{Decoder, Greeting, Item};
pub use error::ZmtpError;
pub use replier::Replier;
pub use requester::Requester;

/// Limits on the size of messages from a peer.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Limits {
    /// Maximum number of frames of a message, without the empty delimiter frame.
    pub frames: usize,
    /// Largest frame, in bytes.
    pub frame_bytes: usize,
    /// Largest message, in bytes.
    pub message_bytes: usize,
}
