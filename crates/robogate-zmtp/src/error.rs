//! Errors of sockets.

use std::io;
use std::time::Duration;

/// The reason why a socket operation failed. The connection is closed after any of these errors.
#[derive(Debug, thiserror::Error)]
pub enum ZmtpError {
    /// The text is not a TCP endpoint.
    #[error("`{0}` is not a valid address. Expected tcp://HOST:PORT, for example tcp://127.0.0.1:5570")]
    Address(String),
    /// No process listens on the address, or the host name is unknown.
    #[error("cannot reach {address}: {why}")]
    Unreachable {
        /// The address.
        address: String,
        /// Error of the operating system.
        why: io::Error,
    },
    /// This process cannot listen on the address.
    #[error("cannot listen on {address}: {why}")]
    Unbindable {
        /// The address.
        address: String,
        /// Error of the operating system.
        why: io::Error,
    },
    /// The deadline passed.
    #[error("no answer within {} s", .0.as_secs_f64())]
    TimedOut(Duration),
    /// The peer closed the connection.
    #[error("the peer closed the connection")]
    Closed,
    /// The operating system reported any other error.
    #[error("connection error: {0}")]
    Io(io::Error),
    /// The peer does not use this protocol.
    #[error("the peer does not use ZMTP 3 with NULL security: {0}")]
    Handshake(String),
    /// The peer sent bytes that the protocol does not allow.
    #[error("invalid ZMTP from the peer: {0}")]
    Framing(String),
    /// The peer sent more than the limits allow.
    #[error("the peer sent {what} of {size} {unit}; at most {limit} are allowed")]
    TooLarge {
        /// The part that is too large.
        what: &'static str,
        /// Unit of the sizes.
        unit: &'static str,
        /// The size.
        size: u64,
        /// Largest allowed size.
        limit: u64,
    },
}
