//! Errors of external policies. They make an episode invalid and are never a failure of the policy.

use robogate_core::{Fault, FaultKind};

/// Why an external policy gave no action.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum PolicyError {
    /// The address does not fit the dialect of the profile.
    #[error("invalid address: `{url}`: {why}")]
    Address {
        /// The address.
        url: String,
        /// What is wrong with it, and what is expected.
        why: String,
    },
    /// The file of a network cannot be used.
    #[error("invalid policy file: {path}: {why}")]
    File {
        /// Path of the file.
        path: String,
        /// What is wrong with it, and what is expected.
        why: String,
    },
    /// No server listens on the address.
    #[error("unreachable: {url}: {why}")]
    Unreachable {
        /// The address.
        url: String,
        /// Error of the operating system.
        why: String,
    },
    /// The deadline passed.
    #[error("timeout: {operation} took longer than {limit_s} s")]
    Timeout {
        /// What was waited for.
        operation: String,
        /// Time limit, in seconds.
        limit_s: f64,
    },
    /// The server closed the connection.
    #[error("connection closed: the server closed the connection {when}{reason}")]
    Closed {
        /// During which operation.
        when: String,
        /// The reason that the server gave, after a colon; or nothing.
        reason: String,
    },
    /// The policy reported an error.
    #[error("policy error: {text}")]
    Reported {
        /// The message of the policy, shortened.
        text: String,
    },
    /// The bytes are not a valid reply of this dialect.
    #[error("invalid reply: {message}: {why}")]
    InvalidReply {
        /// Which message.
        message: &'static str,
        /// What is wrong with it.
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
        /// What listens there, and which dialect to use.
        found: String,
    },
    /// The policy's description of itself contradicts the profile.
    #[error("profile mismatch: {0}")]
    Mismatch(String),
    /// The actions have another shape than the profile says.
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
    /// The observation lacks something that the profile requires.
    #[error("observation: {0}")]
    Observation(String),
}

impl PolicyError {
    /// Whether a new attempt may succeed: the network or the server failed, and not the settings.
    pub(crate) fn is_transient(&self) -> bool {
        matches!(self, Self::Unreachable { .. } | Self::Timeout { .. } | Self::Closed { .. })
    }

    /// Whether the settings are wrong, and not the network or the server.
    pub fn is_usage_error(&self) -> bool {
        matches!(
            self,
            Self::Address { .. }
                | Self::File { .. }
                | Self::WrongDialect { .. }
                | Self::Mismatch(_)
                | Self::Observation(_)
        )
    }

    pub(crate) fn invalid_reply(message: &'static str, why: impl ToString) -> Self {
        Self::InvalidReply { message, why: why.to_string() }
    }

    /// An error in the words of the policy. Keeps the end of a long text, where a Python traceback names the error.
    pub(crate) fn reported(text: &str) -> Self {
        const KEPT: usize = 400;
        let text = text.trim();
        let from = text.char_indices().rev().nth(KEPT).map_or(0, |(i, _)| i);
        let cut = if from > 0 { "... " } else { "" };
        Self::Reported { text: format!("{cut}{}", text.get(from..).unwrap_or_default()) }
    }
}

impl From<PolicyError> for Fault {
    fn from(error: PolicyError) -> Self {
        let kind = match error {
            PolicyError::Shape(_) | PolicyError::NotFinite { .. } => FaultKind::BadAction,
            PolicyError::Observation(_) => FaultKind::Setup,
            _ => FaultKind::Unavailable,
        };
        Self::new(kind, error.to_string())
    }
}
