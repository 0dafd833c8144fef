//! What goes wrong with a policy server. None of it is a failure of the policy.

use robogate_core::{Fault, FaultKind};

/// Why a server gave no action.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum ServerError {
    /// The address is none that this dialect can use.
    #[error("bad address: `{url}`: {why}")]
    Address {
        /// As given.
        url: String,
        /// What is wrong, and what would be right.
        why: String,
    },
    /// Nobody answers there.
    #[error("unreachable: {url}: {why}")]
    Unreachable {
        /// Whom.
        url: String,
        /// What the system says.
        why: String,
    },
    /// The deadline passed.
    #[error("timeout: {what} took longer than {limit_s} s")]
    Timeout {
        /// What was waited for.
        what: String,
        /// The deadline, in seconds.
        limit_s: f64,
    },
    /// The server went away.
    #[error("died: the server closed the connection {when}{reason}")]
    Closed {
        /// In the middle of what.
        when: String,
        /// The reason that it gave, after a colon, or nothing.
        reason: String,
    },
    /// The server answered that it cannot.
    #[error("refused: the server answers with an error: {text}")]
    Refused {
        /// Its own words, cut to a readable length.
        text: String,
    },
    /// Bytes that are no answer of this dialect.
    #[error("undecodable: {what}: {why}")]
    Undecodable {
        /// Which message.
        what: &'static str,
        /// What is wrong with it.
        why: String,
    },
    /// An answer that is too long to be one.
    #[error("too large: an answer of more than {limit} bytes")]
    TooLarge {
        /// What is allowed.
        limit: usize,
    },
    /// Something else listens on the port.
    #[error("another dialect: the profile says {wanted}, but {found}")]
    OtherDialect {
        /// What was expected.
        wanted: &'static str,
        /// What is there, and what to do.
        found: String,
    },
    /// What the server says of itself is not what the profile says.
    #[error("mismatch: {0}")]
    Mismatch(String),
    /// The actions have another shape than the profile says.
    #[error("wrong shape: {0}")]
    Shape(String),
    /// An action that is no number.
    #[error("not finite: number {column} of action {row} is {value}")]
    NotFinite {
        /// Which action of the chunk, from 0.
        row: usize,
        /// Which number of it, from 0.
        column: usize,
        /// NaN or an infinity.
        value: String,
    },
    /// The cell does not show what the profile asks for.
    #[error("observation: {0}")]
    Observation(String),
}

impl ServerError {
    /// Whether asking again may help: the network or the server, not the settings.
    pub(crate) fn is_passing(&self) -> bool {
        matches!(self, Self::Unreachable { .. } | Self::Timeout { .. } | Self::Closed { .. })
    }

    /// Whether the settings are wrong, and not the network or the server.
    pub fn is_in_the_settings(&self) -> bool {
        matches!(self, Self::Address { .. } | Self::OtherDialect { .. } | Self::Mismatch(_) | Self::Observation(_))
    }

    pub(crate) fn undecodable(what: &'static str, why: impl ToString) -> Self {
        Self::Undecodable { what, why: why.to_string() }
    }

    /// An error in the server's own words: the end of them, where Python says what it is.
    pub(crate) fn refused(text: &str) -> Self {
        const KEPT: usize = 400;
        let text = text.trim();
        let from = text.char_indices().rev().nth(KEPT).map_or(0, |(i, _)| i);
        let cut = if from > 0 { "... " } else { "" };
        Self::Refused { text: format!("{cut}{}", text.get(from..).unwrap_or_default()) }
    }
}

impl From<ServerError> for Fault {
    fn from(error: ServerError) -> Self {
        let kind = match error {
            ServerError::Shape(_) | ServerError::NotFinite { .. } => FaultKind::BadAction,
            ServerError::Observation(_) => FaultKind::Setup,
            _ => FaultKind::Unavailable,
        };
        Self::new(kind, error.to_string())
    }
}
