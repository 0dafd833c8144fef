//! ZMTP 3, the wire protocol of ZeroMQ (RFC 23 and 37), as far as REQ and REP over TCP with the NULL mechanism need it:
//! [`Requester`] asks, [`Replier`] answers. Blocking, with deadlines of its own, and with bounds on whatever a
//! peer sends, held before memory is set aside for it.

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

/// What a message from a peer may be at most.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Limits {
    /// Frames of a message, the empty one before it not counted.
    pub frames: usize,
    /// Bytes of a frame.
    pub frame_bytes: usize,
    /// Bytes of a message.
    pub message_bytes: usize,
}
