//! Problems of a file, each with its line.

use std::fmt;

use super::document::Text;

/// A problem of a task's file.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Problem {
    /// The file that `task.toml` names, if the problem is in it. Empty for `task.toml` itself.
    pub file: String,
    /// The line, from 1.
    pub line: usize,
    /// What is wrong, and what was expected.
    pub what: String,
    /// What to do. Empty if `what` says it.
    pub hint: String,
}

impl fmt::Display for Problem {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if !self.file.is_empty() {
            write!(f, "{}, ", self.file)?;
        }
        write!(f, "line {}: {}", self.line, self.what)?;
        if self.hint.is_empty() { Ok(()) } else { write!(f, "\nHint: {}", self.hint) }
    }
}

/// The problems that were found in a file so far.
#[derive(Debug)]
pub(super) struct Problems<'a> {
    file: &'a str,
    /// Lines of other files: the positions after the end of this one.
    elsewhere: Vec<(String, usize)>,
    pub(super) found: Vec<Problem>,
}

impl<'a> Problems<'a> {
    pub(super) fn new(file: &'a str) -> Self {
        Self { file, elsewhere: Vec::new(), found: Vec::new() }
    }

    /// A position that stands for a line of another file.
    pub(super) fn elsewhere(&mut self, file: &str, line: usize) -> usize {
        if self.elsewhere.last().is_none_or(|(last, of)| last != file || *of != line) {
            self.elsewhere.push((file.to_owned(), line));
        }
        self.file.len() + self.elsewhere.len()
    }

    fn place(&self, at: usize) -> (String, usize) {
        let other = at.checked_sub(self.file.len() + 1).and_then(|index| self.elsewhere.get(index));
        let line = || 1 + self.file.as_bytes().iter().take(at).filter(|byte| **byte == b'\n').count();
        other.cloned().unwrap_or_else(|| (String::new(), line()))
    }

    /// Adds a problem at a byte of the file.
    pub(super) fn at(&mut self, at: usize, what: impl Into<String>, hint: impl Into<String>) {
        let (file, line) = self.place(at);
        self.found.push(Problem { file, line, what: what.into(), hint: hint.into() });
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
