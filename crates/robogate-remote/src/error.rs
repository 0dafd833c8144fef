//! Errors of requests.

use robogate_core::{Fault, FaultKind};
use robogate_zmtp::{Address, ZmtpError};

use super::header::MalformedHeader;
use super::limits::VERSION;
use super::message::ErrorReply;

/// An error of a request: there is no usable reply.
#[derive(Debug, thiserror::Error)]
pub enum RequestError {
    /// The connection failed, or the server did not answer in time.
    #[error(transparent)]
    Connection(#[from] ZmtpError),
    /// The header of the reply is malformed.
    #[error("malformed reply: {0}")]
    Malformed(#[from] MalformedHeader),
    /// The reply is well formed, but its content violates the protocol.
    #[error("protocol violation: {0}")]
    ProtocolViolation(String),
    /// The server speaks another version of the protocol.
    #[error(
        "the server uses protocol version {server}, but this robogate uses version {VERSION}. {}",
        upgrade(*.server)
    )]
    OtherVersion {
        /// Version of the server.
        server: u64,
    },
    /// The server answered with an error.
    #[error("{}", .0.detail)]
    Rejected(ErrorReply),
    /// The server was to be started again after a failure.
    #[error("cannot be started again: {0}")]
    NotStarted(String),
    /// This side found the error.
    #[error("{}", .0.detail)]
    Local(Fault),
}

impl RequestError {
    /// Whether the server caused the error, rather than the scenario or the action.
    pub fn is_server_failure(&self) -> bool {
        self.kind() == FaultKind::Unavailable
    }

    /// The fault that an episode gets from this error. It names the server only if the server failed: any other fault follows from
    /// the scenario, and a record must not depend on which server ran it.
    pub fn fault(&self, address: &Address) -> Fault {
        let detail = if self.is_server_failure() { format!("{address}: {self}") } else { self.to_string() };
        Fault::new(self.kind(), detail)
    }

    fn kind(&self) -> FaultKind {
        match self {
            Self::Connection(_)
            | Self::Malformed(_)
            | Self::ProtocolViolation(_)
            | Self::OtherVersion { .. }
            | Self::NotStarted(_) => FaultKind::Unavailable,
            Self::Rejected(reply) => reply.kind.fault(),
            Self::Local(fault) => fault.kind,
        }
    }
}

/// The advice for a server with another protocol version.
fn upgrade(server: u64) -> &'static str {
    if server < VERSION { "Upgrade the server (bridges/common of this release)" } else { "Upgrade robogate" }
}

/// A protocol violation with this description.
pub(crate) fn violation(description: impl Into<String>) -> RequestError {
    RequestError::ProtocolViolation(description.into())
}
