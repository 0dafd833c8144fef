//! Reads JSON Lines: one JSON object per line.

use std::io::{BufRead, BufReader, Read};
use std::path::{Path, PathBuf};

use serde::de::DeserializeSeed;

use super::flat::FlatRow;
use super::{Frame, Sink};
use crate::DictionaryError;
use crate::codec::Interner;
use crate::decode::Text;
use crate::raw::RawRow;

/// Maximum bytes per line.
const LONGEST: u64 = 1 << 20;

/// The non-blank lines of a file.
#[derive(Debug)]
pub(super) struct Lines {
    path: PathBuf,
    reader: BufReader<Text>,
    line: Vec<u8>,
    number: u64,
}

impl Lines {
    pub(super) fn open(path: &Path) -> Result<Self, DictionaryError> {
        // The meter is unnecessary: the length of each line is limited here, where its number is known.
        let reader = BufReader::with_capacity(1 << 16, Text::open_json(path, u64::MAX)?);
        Ok(Self { path: path.to_owned(), reader, line: Vec::new(), number: 0 })
    }

    /// Reads the next line.
    pub(super) fn next(&mut self) -> Result<Option<&[u8]>, DictionaryError> {
        loop {
            self.line.clear();
            self.number += 1;
            let mut limited = self.reader.by_ref().take(LONGEST);
            let n = limited.read_until(b'\n', &mut self.line).map_err(DictionaryError::io(&self.path, "read"))?;
            if n == 0 {
                return Ok(None);
            }
            if n as u64 == LONGEST && self.line.last() != Some(&b'\n') {
                let reason =
                    format!("line {} has more than {LONGEST} bytes. Expected one episode per line", self.number);
                return Err(DictionaryError::results(&self.path, reason));
            }
            if !self.line.trim_ascii().is_empty() {
                break;
            }
        }
        Ok(Some(&self.line))
    }

    /// An error about the last line that was read.
    pub(super) fn wrong(&self, error: &serde_json::Error) -> DictionaryError {
        let reason = format!("line {}, column {}: {error}", self.number, error.column());
        DictionaryError::results(&self.path, format!("{reason}. Expected one JSON object per line"))
    }

    /// The number of the last line that was read, from 1.
    pub(super) fn number(&self) -> u64 {
        self.number
    }

    /// What the reader should know about the encoding of the file.
    pub(super) fn note(&self) -> Option<String> {
        self.reader.get_ref().note()
    }

    /// The hash of the bytes read so far.
    pub(super) fn sha256(self) -> String {
        self.reader.into_inner().sha256()
    }
}

pub(super) fn read(path: &Path, sink: Sink<'_>) -> Result<Frame, DictionaryError> {
    let mut lines = Lines::open(path)?;
    let (mut row, mut names) = (RawRow::default(), Interner::default());
    while let Some(text) = lines.next()? {
        row.fields.clear();
        let mut json = serde_json::Deserializer::from_slice(text);
        FlatRow { row: &mut row, names: &mut names, prefix: "" }
            .deserialize(&mut json)
            .and_then(|()| json.end())
            .map_err(|e| lines.wrong(&e))?;
        row.line = Some(lines.number());
        sink(&row)?;
        row.number += 1;
    }
    Ok(Frame { notes: lines.note().into_iter().collect(), sha256: lines.sha256(), ..Frame::default() })
}
