//! Batches of cycles, parsed before they reach the engine's thread.
//!
//! A body of 16 MB takes much longer to parse than to refuse. It is parsed on the thread that received it, and work and
//! memory are bounded: by the number of lines, and by the number of malformed lines after which the rest is not read.

use std::time::Instant;

use super::intake::Refused;
use crate::Cycle;

/// Maximum number of lines in a batch.
pub const MOST_LINES: usize = 50_000;
/// Malformed lines after which the rest of a batch is not read.
pub const MOST_MALFORMED: u64 = 1_000;
/// Maximum number of refusals in a reply.
pub(super) const LISTED: usize = 100;
/// A batch with more than [`MOST_LINES`] lines. None of them was accepted.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("the batch has more than {MOST_LINES} lines. Send smaller batches")]
pub struct TooManyLines;

/// A parsed batch.
#[derive(Debug, Clone, Default)]
pub struct Batch {
    /// The valid cycles with their lines, counted from 1, and their texts.
    pub(super) cycles: Vec<(u64, Cycle, String)>,
    /// Number of malformed lines, including those that were not read.
    pub(super) malformed: u64,
    /// The first malformed lines.
    pub(super) problems: Vec<Refused>,
    /// Its length in bytes.
    pub(super) bytes: usize,
    /// Who sent it over a network, and when it arrived.
    pub(super) sender: Option<(String, Instant)>,
}

impl Batch {
    /// Parses one cycle per line. Blank lines are ignored.
    ///
    /// # Errors
    /// If there are too many lines.
    pub fn parse(text: &[u8]) -> Result<Self, TooManyLines> {
        let mut batch = Self { bytes: text.len(), ..Self::default() };
        for (at, (line, text)) in lines(text).enumerate() {
            if at == MOST_LINES {
                return Err(TooManyLines);
            }
            if batch.malformed >= MOST_MALFORMED {
                batch.refuse(line, format!("not read: {MOST_MALFORMED} lines before it are malformed"));
                continue;
            }
            match parse(text) {
                Ok((cycle, text)) => batch.cycles.push((line, cycle, text)),
                Err(because) => batch.refuse(line, because),
            }
        }
        Ok(batch)
    }

    /// Cycles that were not sent as lines, or the problem with each. They are numbered from 1.
    pub fn of(cycles: Vec<Result<Cycle, String>>) -> Self {
        let mut batch = Self::default();
        for (cycle, number) in cycles.into_iter().zip(1_u64..) {
            match cycle.and_then(|cycle| Ok((serde_json::to_string(&cycle).map_err(|e| e.to_string())?, cycle))) {
                Ok((text, cycle)) => {
                    batch.bytes += text.len();
                    batch.cycles.push((number, cycle, text));
                }
                Err(because) => batch.refuse(number, because),
            }
        }
        batch
    }

    /// The same batch after so many lines of its file.
    #[must_use]
    pub fn after(mut self, lines: u64) -> Self {
        self.cycles.iter_mut().for_each(|(line, ..)| *line += lines);
        self.problems.iter_mut().for_each(|problem| problem.line += lines);
        self
    }

    /// The same batch from a sender in a network, now.
    pub(super) fn sent_by(self, name: &str) -> Self {
        Self { sender: Some((name.to_owned(), Instant::now())), ..self }
    }

    fn refuse(&mut self, line: u64, because: String) {
        self.malformed += 1;
        if self.problems.len() < LISTED {
            self.problems.push(Refused::new(line, because));
        }
    }
}

/// The lines of a body that are not blank, with their numbers from 1.
pub(super) fn lines(text: &[u8]) -> impl Iterator<Item = (u64, &[u8])> {
    // Programs on Windows begin a file with a byte-order mark.
    let text = text.strip_prefix(b"\xef\xbb\xbf").unwrap_or(text);
    let lines = text.split(|byte| *byte == b'\n').zip(1_u64..);
    lines.map(|(text, line)| (line, text.trim_ascii())).filter(|(_, text)| !text.is_empty())
}

fn parse(text: &[u8]) -> Result<(Cycle, String), String> {
    let text = std::str::from_utf8(text).map_err(|e| format!("not UTF-8: {e}"))?;
    let cycle: Cycle = serde_json::from_str(text).map_err(|e| e.to_string())?;
    cycle.check().map_err(|e| e.to_string())?;
    Ok((cycle, text.to_owned()))
}

#[cfg(test)]
mod tests {
    use super::super::intake::LONGEST_PROBLEM;
    use super::*;

    #[test]
    fn malformed_lines_are_counted_and_bounded() {
        let body = b"x\n".repeat(20_000);
        let batch = Batch::parse(&body).unwrap();
        assert_eq!((batch.malformed, batch.problems.len(), batch.cycles.len()), (20_000, LISTED, 0));
        assert!(batch.problems[0].because.contains("expected value"), "{:?}", batch.problems[0]);
    }

    #[test]
    fn byte_order_mark_is_no_part_of_a_cycle() {
        let line = r#"{"id": "a/0", "robot": "a", "recipe": "bracket", "time_s": 1, "success": true}"#;
        let batch = Batch::parse(format!("\u{feff}{line}\r\n{line}\n").as_bytes()).unwrap();
        assert_eq!((batch.cycles.len(), batch.malformed), (2, 0), "{:?}", batch.problems);
    }

    #[test]
    fn long_batches_are_rejected() {
        assert_eq!(Batch::parse(&b"x\n".repeat(MOST_LINES + 1)).unwrap_err(), TooManyLines);
        assert!(Batch::parse(&b"\n".repeat(1 << 20)).unwrap().problems.is_empty());
    }

    #[test]
    fn long_problems_are_shortened() {
        let line = format!("{{\"{}\": 1}}", "\u{e4}".repeat(10_000));
        let batch = Batch::parse(line.as_bytes()).unwrap();
        assert!(batch.problems[0].because.len() <= LONGEST_PROBLEM);
    }
}
