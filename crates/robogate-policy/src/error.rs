//! Errors of external policies. They make an episode invalid and never count as a failure of the policy.

use robogate_core::{Fault, FaultKind};

/// An error of an external policy, which returned no action.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum PolicyError {
    /// The address does not have the form that the dialect requires.
    #[error("invalid address: `{url}`: {why}")]
    Address {
        /// The address.
        url: String,
        /// The problem, with the expected form.
        why: String,
    },
    /// The file of a network cannot be used.
    #[error("invalid policy file: {path}: {why}")]
    File {
        /// Path of the file.
        path: String,
        /// The problem, with the expected content.
        why: String,
    },
    /// No server listens on the address.
    #[error("unreachable: {url}: {why}")]
    Unreachable {
        /// The address.
        url: String,
        /// The error of the operating system.
        why: String,
    },
    /// The server is running, but it is still loading.
    #[error("not ready: {url}: {why}")]
    NotReady {
        /// The address.
        url: String,
        /// What the server answered.
        why: String,
    },
    /// The TLS connection could not be established.
    #[error("TLS: {url}: {why}")]
    Tls {
        /// The address.
        url: String,
        /// The problem.
        why: String,
    },
    /// The trusted certificates cannot be used.
    #[error("CA certificates: {0}")]
    Certificates(String),
    /// The key of the policy server cannot be used.
    #[error("key of the policy server: {0}")]
    Key(String),
    /// The deadline has passed.
    #[error("timeout: {operation} took longer than {limit_s} s")]
    Timeout {
        /// The operation.
        operation: String,
        /// The time limit, in seconds.
        limit_s: f64,
    },
    /// The server closed the connection.
    #[error("connection closed: the server closed the connection {when}{reason}")]
    Closed {
        /// The operation during which it was closed.
        when: String,
        /// The reason that the server gave, after a colon. Empty without a reason.
        reason: String,
    },
    /// The policy reported an error.
    #[error("policy error: {text}")]
    Reported {
        /// The message of the policy, shortened.
        text: String,
    },
    /// A network in this process computed no answer.
    #[error("policy error: {text}")]
    Network {
        /// The message of the library, shortened.
        text: String,
    },
    /// The bytes are not a valid reply of this dialect.
    #[error("invalid reply: {message}: {why}")]
    InvalidReply {
        /// The message.
        message: &'static str,
        /// The problem.
        why: String,
    },
    /// The reply exceeds the size limit.
    #[error("too large: the reply has more than {limit} bytes")]
    TooLarge {
        /// Size limit in bytes.
        limit: usize,
    },
    /// A server of another dialect listens on the address.
    #[error("wrong dialect: the profile expects {expected}, but {found}")]
    WrongDialect {
        /// Dialect of the profile.
        expected: &'static str,
        /// The detected server, with the matching dialects.
        found: String,
    },
    /// The policy's metadata contradict the profile.
    #[error("profile mismatch: {0}")]
    Mismatch(String),
    /// The shape of the actions differs from the profile.
    #[error("wrong shape: {0}")]
    Shape(String),
    /// An action contains NaN or infinity.
    #[error("not finite: number {column} of action {row} is {value}")]
    NotFinite {
        /// Index of the action in the chunk, from 0.
        row: usize,
        /// Index of the number in the action, from 0.
        column: usize,
        /// The value.
        value: String,
    },
    /// The observation lacks an item that the profile requires, or has another shape or type than the network takes.
    #[error("observation: {0}")]
    Observation(String),
}

impl PolicyError {
    /// Whether a new attempt may succeed: the network or the server failed, not the settings.
    pub(crate) fn is_transient(&self) -> bool {
        matches!(self, Self::Unreachable { .. } | Self::NotReady { .. } | Self::Timeout { .. } | Self::Closed { .. })
    }

    /// Whether the settings are wrong, not the network or the server.
    pub fn is_usage_error(&self) -> bool {
        matches!(
            self,
            Self::Address { .. }
                | Self::File { .. }
                | Self::WrongDialect { .. }
                | Self::Mismatch(_)
                | Self::Tls { .. }
                | Self::Certificates(_)
                | Self::Key(_)
                | Self::Observation(_)
        )
    }

    pub(crate) fn invalid_reply(message: &'static str, why: impl ToString) -> Self {
        Self::InvalidReply { message, why: why.to_string() }
    }

    /// An error that the policy reported.
    pub(crate) fn reported(text: &str) -> Self {
        Self::Reported { text: shortened(text) }
    }
}

/// The end of a long text, where a Python traceback names the error.
pub(crate) fn shortened(text: &str) -> String {
    const KEPT: usize = 400;
    let text = text.trim();
    let from = text.char_indices().rev().nth(KEPT).map_or(0, |(i, _)| i);
    let cut = if from > 0 { "... " } else { "" };
    format!("{cut}{}", text.get(from..).unwrap_or_default())
}

impl From<PolicyError> for Fault {
    fn from(error: PolicyError) -> Self {
        let kind = match error {
            PolicyError::Shape(_) | PolicyError::NotFinite { .. } | PolicyError::Network { .. } => FaultKind::BadAction,
            PolicyError::Observation(_) => FaultKind::Setup,
            _ => FaultKind::Unavailable,
        };
        Self::new(kind, error.to_string())
    }
}
