//! Why the gate cannot answer.

/// Why the gate cannot answer.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum GateError {
    /// A file of requirements that is none; the text has line, column and key.
    #[error("{0}")]
    Syntax(String),
}
