//! Failure modes and measures as a task declares them.

use robogate_core::{Better, FailureMode, FailureModeSpec, MeasureSpec, Severity, Word};

/// A failure mode that published exports name by its own word.
pub(crate) fn mode(name: FailureMode, severity: Severity, meaning: &str) -> FailureModeSpec {
    FailureModeSpec { name, meaning: meaning.to_owned(), severity, published_as: None }
}

/// A measure.
pub(crate) fn measure(name: Word, unit: &str, better: Better, meaning: &str) -> MeasureSpec {
    MeasureSpec { name, unit: unit.to_owned(), meaning: meaning.to_owned(), better }
}
