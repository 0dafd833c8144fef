//! Problems of a file, each with its line.

use std::fmt;

use super::document::Text;

/// A problem of a task's file.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Problem {
    /// The line, from 1.
    pub line: usize,
    /// What is wrong, and what was expected.
    pub what: String,
    /// What to do. Empty if `what` says it.
    pub hint: String,
}

impl fmt::Display for Problem {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "line {}: {}", self.line, self.what)?;
        if self.hint.is_empty() { Ok(()) } else { write!(f, "\nHint: {}", self.hint) }
    }
}

/// The problems that were found in a file so far.
#[derive(Debug)]
pub(super) struct Problems<'a> {
    file: &'a str,
    pub(super) found: Vec<Problem>,
}

impl<'a> Problems<'a> {
    pub(super) fn new(file: &'a str) -> Self {
        Self { file, found: Vec::new() }
    }

    fn line(&self, at: usize) -> usize {
        1 + self.file.as_bytes().iter().take(at).filter(|byte| **byte == b'\n').count()
    }

    /// Adds a problem at a byte of the file.
    pub(super) fn at(&mut self, at: usize, what: impl Into<String>, hint: impl Into<String>) {
        let line = self.line(at);
        self.found.push(Problem { line, what: what.into(), hint: hint.into() });
    }

    /// Adds a problem of a text.
    pub(super) fn of(&mut self, text: &Text, what: impl Into<String>) {
        self.at(text.at, what, "");
    }

    /// The value of a result. An error becomes a problem of a text.
    pub(super) fn take<T>(&mut self, text: &Text, result: Result<T, String>) -> Option<T> {
        result.map_err(|why| self.of(text, why)).ok()
    }

    /// The problem of a file that is not TOML or has another form.
    pub(super) fn syntax(&mut self, error: &toml::de::Error) {
        let message = error.message().trim().to_owned();
        // "unknown field `x`, expected one of `a`, `b`"
        let quoted: Vec<&str> = message.split('`').skip(1).step_by(2).collect();
        let (what, hint) = match quoted[..] {
            [unknown, ref known @ ..] if message.starts_with("unknown field") && !known.is_empty() => {
                let hint = robogate_core::hint(unknown, known.iter().copied());
                (format!("unknown key `{unknown}`: {hint}"), String::new())
            }
            _ => (message, String::new()),
        };
        self.at(error.span().map_or(0, |span| span.start), what, hint);
    }
}
