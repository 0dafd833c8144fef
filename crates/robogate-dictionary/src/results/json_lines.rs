//! One JSON object on each line.

use std::io::{BufRead, BufReader, Read};
use std::path::Path;

use serde::de::DeserializeSeed;

use super::flat::FlatRow;
use super::{Frame, Sink};
use crate::DictionaryError;
use crate::codec::Interner;
use crate::raw::{Metered, RawRow};

/// The longest line.
const LONGEST: u64 = 1 << 20;

pub(super) fn read(path: &Path, sink: Sink<'_>) -> Result<Frame, DictionaryError> {
    // The meter is not needed: a line is bounded here, where its number is known.
    let mut reader = BufReader::with_capacity(1 << 16, Metered::open(path, u64::MAX)?);
    let (mut line, mut number) = (Vec::new(), 0_u64);
    let (mut row, mut names) = (RawRow::default(), Interner::default());
    loop {
        line.clear();
        number += 1;
        let n =
            reader.by_ref().take(LONGEST).read_until(b'\n', &mut line).map_err(DictionaryError::io(path, "read"))?;
        if n == 0 {
            break;
        }
        if n as u64 == LONGEST && line.last() != Some(&b'\n') {
            let reason = format!("line {number} has more than {LONGEST} bytes\nhint: one episode stands on each line");
            return Err(DictionaryError::results(path, reason));
        }
        let text = if number == 1 { line.strip_prefix(b"\xef\xbb\xbf").unwrap_or(&line) } else { &line };
        if text.trim_ascii().is_empty() {
            continue;
        }
        row.fields.clear();
        let mut json = serde_json::Deserializer::from_slice(text);
        FlatRow { row: &mut row, names: &mut names, prefix: "" }
            .deserialize(&mut json)
            .and_then(|()| json.end())
            .map_err(|e| {
                let reason = format!("line {number}, column {}: {e}", e.column());
                DictionaryError::results(path, format!("{reason}\nhint: one JSON object stands on each line"))
            })?;
        sink(&row)?;
        row.number += 1;
    }
    Ok(Frame { sha256: reader.into_inner().sha256(), ..Frame::default() })
}
