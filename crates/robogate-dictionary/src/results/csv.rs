//! Reads separated values with a header.

use std::io::{BufRead, BufReader};
use std::path::Path;
use std::sync::Arc;

use ::csv::{ErrorKind, ReaderBuilder, StringRecord};

use super::{Frame, Sink};
use crate::DictionaryError;
use crate::formula::unmarked;
use crate::raw::{MOST_FIELDS, Metered, RawRow, Scalar};

/// Maximum bytes per record. Without it, an unclosed quote would consume the whole file.
const LONGEST: u64 = 1 << 20;

pub(super) fn read(path: &Path, sink: Sink<'_>) -> Result<Frame, DictionaryError> {
    let metered = Metered::open(path, LONGEST)?;
    let meter = metered.meter();
    let mut metered = BufReader::with_capacity(1 << 16, metered);
    let start = metered.fill_buf().map_err(DictionaryError::io(path, "read"))?;
    let first = start.split(|byte| *byte == b'\n').next().unwrap_or_default();
    let delimiter = delimiter(first);
    if start.starts_with(b"\xef\xbb\xbf") {
        metered.consume(3);
    }
    let mut reader = ReaderBuilder::new().delimiter(delimiter).from_reader(&mut metered);
    let headers = reader.headers().map_err(|e| refuse(path, &e))?;
    if headers.len() > MOST_FIELDS {
        let reason = format!("its header has {} columns. Expected at most {MOST_FIELDS}", headers.len());
        return Err(DictionaryError::results(path, reason));
    }
    let names: Vec<Arc<str>> = headers.iter().map(|name| unmarked(name.trim()).into()).collect();
    if let Some(i) = (1..names.len()).find(|i| names[..*i].contains(&names[*i])) {
        return Err(DictionaryError::results(path, format!("its header has the column `{}` twice", names[i])));
    }
    let mut row = RawRow::default();
    let mut record = StringRecord::new();
    while reader.read_record(&mut record).map_err(|e| refuse(path, &e))? {
        meter.reset();
        row.fields.clear();
        row.fields.extend(names.iter().cloned().zip(record.iter().map(scalar)));
        sink(&row)?;
        row.number += 1;
    }
    drop(reader);
    Ok(Frame { sha256: metered.into_inner().sha256(), ..Frame::default() })
}

/// The separator of the header: the most frequent of comma, semicolon and tab.
fn delimiter(header: &[u8]) -> u8 {
    let count = |of: u8| header.iter().filter(|byte| **byte == of).count();
    let most = *b",;\t".iter().rev().max_by_key(|of| count(**of)).unwrap_or(&b',');
    if count(most) == 0 { b',' } else { most }
}

/// Parses the value of a field. Other tools write `nan` and similar words for a missing value.
fn scalar(text: &str) -> Scalar {
    let text = text.trim();
    if ["", "nan", "null", "none", "na", "n/a"].contains(&text.to_ascii_lowercase().as_str()) {
        return Scalar::Null;
    }
    match text {
        "true" | "True" | "TRUE" => return Scalar::Bool(true),
        "false" | "False" | "FALSE" => return Scalar::Bool(false),
        _ => {}
    }
    if let Ok(n) = text.parse() {
        return Scalar::Integer(n);
    }
    match text.parse::<f64>() {
        // A parameter cannot be infinite.
        Ok(x) if x.is_finite() => Scalar::Number(x),
        _ => Scalar::Text(unmarked(text).to_owned()),
    }
}

fn refuse(path: &Path, error: &::csv::Error) -> DictionaryError {
    let line = error.position().map_or_else(String::new, |position| format!("line {}: ", position.line()));
    let reason = match error.kind() {
        ErrorKind::Io(e) if e.kind() == std::io::ErrorKind::InvalidData => {
            format!("{line}{e}\nhint: look for a quote that is never closed")
        }
        ErrorKind::Utf8 { err, .. } => format!("{line}{err}. Expected UTF-8"),
        ErrorKind::UnequalLengths { expected_len, len, .. } => {
            format!("{line}{len} fields. Expected {expected_len}, as in the header")
        }
        _ => error.to_string(),
    };
    DictionaryError::results(path, reason)
}
