//! What can go wrong between two peers.

use std::io;
use std::time::Duration;

/// Why there is no message. After any of these the connection is gone.
#[derive(Debug, thiserror::Error)]
pub enum ZmtpError {
    /// Text that names no TCP endpoint.
    #[error("`{0}` is no address; one looks like tcp://127.0.0.1:5570")]
    Address(String),
    /// Nobody listens there, or the name is unknown.
    #[error("cannot reach {address}: {why}")]
    Unreachable {
        /// The address.
        address: String,
        /// What the system says.
        why: io::Error,
    },
    /// The address cannot be listened on.
    #[error("cannot listen on {address}: {why}")]
    Unbindable {
        /// The address.
        address: String,
        /// What the system says.
        why: io::Error,
    },
    /// The deadline passed.
    #[error("no answer within {} s", .0.as_secs_f64())]
    TimedOut(Duration),
    /// The peer went away.
    #[error("the other side closed the connection")]
    Closed,
    /// The system reported something else.
    #[error("the connection broke: {0}")]
    Io(io::Error),
    /// The peer speaks something else.
    #[error("the other side does not speak ZMTP 3 with NULL security: {0}")]
    Handshake(String),
    /// Bytes that the protocol does not allow there.
    #[error("the other side broke ZMTP: {0}")]
    Framing(String),
    /// More than this side takes.
    #[error("the other side sent {what} of {size}; at most {limit} are taken")]
    TooLarge {
        /// What is too large.
        what: &'static str,
        /// Its size: bytes, or frames of a message.
        size: u64,
        /// What would be taken.
        limit: u64,
    },
}
