//! The rows of an exported CSV.
//!
//! A separate parser for RFC 4180, because the parser for other tools' tables ignores quotes. Only quotes distinguish
//! an empty text from a missing value, and a text of digits from a number.

use std::io::{self, BufRead, BufReader};
use std::path::{Path, PathBuf};

use super::Field;
use crate::decode::Text;
use crate::raw::{MOST_FIELDS, Meter};
use crate::{DictionaryError, formula};

/// Maximum bytes without a complete row.
const LONGEST: u64 = 1 << 20;

/// The rows of a file after its header line.
pub(super) struct Rows {
    path: PathBuf,
    reader: BufReader<Text>,
    meter: Meter,
    /// Line breaks read so far.
    breaks: u64,
    pub(super) names: Vec<String>,
}

/// The state of the parser within a field.
#[derive(Clone, Copy, PartialEq, Eq)]
enum State {
    Start,
    Bare,
    Quoted,
    /// After a closing quote.
    Closed,
}

impl Rows {
    /// Opens the file and reads its header line. `None` if it has none.
    pub(super) fn open(path: &Path) -> Result<Option<Self>, DictionaryError> {
        let text = Text::open(path, LONGEST)?;
        let meter = text.meter();
        let reader = BufReader::with_capacity(1 << 16, text);
        let mut rows = Self { path: path.to_owned(), reader, meter, breaks: 0, names: Vec::new() };
        let mut names = Vec::new();
        if !rows.record(&mut names)? {
            return Ok(None);
        }
        if names.len() > 2 * MOST_FIELDS {
            return Err(rows.wrong(1, format!("{} columns are more than a dictionary can have", names.len())));
        }
        rows.names = names.iter().map(|name| name.text().unwrap_or_default().to_owned()).collect();
        Ok(Some(rows))
    }

    pub(super) fn next(&mut self, fields: &mut Vec<Field>) -> Result<bool, DictionaryError> {
        loop {
            let line = self.breaks + 1;
            if !self.record(fields)? {
                return Ok(false);
            }
            if fields.len() == self.names.len() {
                return Ok(true);
            }
            if **fields != [Field::Missing] {
                let (found, expected) = (fields.len(), self.names.len());
                return Err(self.wrong(line, format!("{found} fields. Expected {expected}, as in the first line")));
            }
            // A blank line.
        }
    }

    /// Reads one record. Returns `false` at the end of the file.
    fn record(&mut self, fields: &mut Vec<Field>) -> Result<bool, DictionaryError> {
        let line = self.breaks + 1;
        let (mut state, mut field) = (State::Start, Vec::new());
        fields.clear();
        loop {
            let buffer = match self.reader.fill_buf() {
                Ok(buffer) => buffer,
                Err(e) if e.kind() == io::ErrorKind::InvalidData => {
                    return Err(self.wrong(line, format!("{e}\nHint: look for a quote that is never closed")));
                }
                Err(e) => return Err(DictionaryError::io(&self.path, "read")(e)),
            };
            if buffer.is_empty() {
                return match state {
                    State::Start if fields.is_empty() => Ok(false),
                    State::Quoted => Err(self.wrong(line, "a quote is never closed".to_owned())),
                    _ => self.finish(line, state, &mut field, fields).map(|()| true),
                };
            }
            let mut used = 0;
            let mut ends = None;
            for byte in buffer {
                used += 1;
                match (state, byte) {
                    (State::Quoted, b'"') => state = State::Closed,
                    (State::Quoted, byte) => {
                        self.breaks += u64::from(*byte == b'\n');
                        field.push(*byte);
                    }
                    (_, b',' | b'\n') => {
                        ends = Some(*byte);
                        break;
                    }
                    (State::Start, b'"') => state = State::Quoted,
                    (State::Start | State::Bare, byte) => {
                        state = State::Bare;
                        field.push(*byte);
                    }
                    // Two quotes within a quoted field stand for one.
                    (State::Closed, b'"') => {
                        state = State::Quoted;
                        field.push(b'"');
                    }
                    (State::Closed, b'\r') => {}
                    (State::Closed, _) => {
                        return Err(self.wrong(line, "text after a closing quote. Expected a comma".to_owned()));
                    }
                }
            }
            self.reader.consume(used);
            let Some(end) = ends else { continue };
            if end == b'\n' {
                self.breaks += 1;
                if state == State::Bare && field.last() == Some(&b'\r') {
                    field.pop();
                }
            }
            self.finish(line, state, &mut field, fields)?;
            state = State::Start;
            if end == b'\n' {
                self.meter.reset();
                return Ok(true);
            }
        }
    }

    fn finish(
        &self,
        line: u64,
        state: State,
        field: &mut Vec<u8>,
        fields: &mut Vec<Field>,
    ) -> Result<(), DictionaryError> {
        let text = String::from_utf8(std::mem::take(field))
            .map_err(|e| self.wrong(line, format!("{}. Expected UTF-8", e.utf8_error())))?;
        let text = formula::unmarked(&text).to_owned();
        fields.push(match state {
            State::Quoted | State::Closed => Field::Text(text),
            State::Start | State::Bare if text.is_empty() => Field::Missing,
            State::Start | State::Bare => Field::Bare(text),
        });
        Ok(())
    }

    fn wrong(&self, line: u64, reason: String) -> DictionaryError {
        DictionaryError::results(&self.path, format!("line {line}: {reason}"))
    }

    pub(super) fn sha256(self) -> String {
        self.reader.into_inner().sha256()
    }
}
