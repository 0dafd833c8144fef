//! What the library tells beside its results: through the `log` crate, at the levels `info` and `warn`.

use std::fmt::Display;

/// The target of all messages.
pub const TARGET: &str = "robogate_session";

/// Tells something that the user may want to know.
pub(crate) fn note(text: impl Display) {
    log::info!(target: TARGET, "{text}");
}

/// Tells something that the user should know.
pub(crate) fn warning(text: impl Display) {
    log::warn!(target: TARGET, "{text}");
}
