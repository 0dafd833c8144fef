//! Reads separated values with a header.

use std::io::{BufRead, BufReader};
use std::path::Path;
use std::sync::Arc;

use ::csv::{ErrorKind, Reader, ReaderBuilder, StringRecord};

use super::numbers::{Evidence, Numbers};
use super::{Frame, Sink, changed, units};
use crate::DictionaryError;
use crate::decode::Text;
use crate::formula::unmarked;
use crate::raw::{MOST_FIELDS, Meter, RawRow, Scalar};

/// Maximum bytes per record. Without it, an unclosed quote would consume the whole file.
const LONGEST: u64 = 1 << 20;

pub(super) fn read(path: &Path, spelling: &Spelling, sink: Sink<'_>) -> Result<Frame, DictionaryError> {
    let mut table = Table::open(path)?;
    let mut row = RawRow::default();
    let mut repeated: Vec<u64> = Vec::new();
    while table.next()? {
        if table.repeats_header()? {
            repeated.push(table.line());
            continue;
        }
        row.line = Some(table.line());
        row.fields.clear();
        for ((name, field), unit) in table.names.iter().zip(&table.record).zip(&spelling.units) {
            let field = unit.and_then(|_| units::parts(field)).map_or(field, |(number, _)| number);
            row.fields.push((Arc::clone(name), scalar(field, spelling.numbers)));
        }
        sink(&row)?;
        row.number += 1;
    }
    let text = table.reader.into_inner().into_inner();
    let (note, sha256) = (text.note(), text.sha256());
    if sha256 != spelling.sha256 {
        return Err(changed(path));
    }
    let mut notes: Vec<String> = note.into_iter().collect();
    let with_unit =
        table.names.iter().zip(&spelling.units).filter_map(|(name, unit)| Some(format!("`{name}` in {}", (*unit)?)));
    let with_unit: Vec<String> = with_unit.collect();
    if !with_unit.is_empty() {
        notes.push(format!("Numbers with a unit are read as numbers: {}.", with_unit.join(", ")));
    }
    if let Some(first) = repeated.first() {
        let n = repeated.len();
        notes.push(format!(
            "Lines that repeat the header, as after a merge of files: {n}, first line {first}. They are skipped."
        ));
    }
    Ok(Frame { sha256, notes, ..Frame::default() })
}

/// How a file writes its values.
#[derive(Debug)]
pub(super) struct Spelling {
    numbers: Numbers,
    /// The unit of each column whose numbers have one.
    units: Vec<Option<&'static str>>,
    /// SHA-256 of the file.
    sha256: String,
}

/// How the file writes its values, from all fields.
pub(super) fn spelling(path: &Path) -> Result<Spelling, DictionaryError> {
    let mut table = Table::open(path)?;
    let mut evidence = Evidence::default();
    let mut columns = vec![units::Column::default(); table.names.len()];
    while table.next()? {
        let line = table.line();
        if table.repeats_header()? {
            continue;
        }
        for (field, column) in table.record.iter().map(str::trim).zip(&mut columns) {
            let parts = units::parts(field);
            evidence.take(line, parts.map_or(field, |(number, _)| number));
            if !is_missing(field) {
                column.take(line, field, parts.map(|(_, unit)| unit), Evidence::may_be_number);
            }
        }
    }
    let units: Result<_, String> = table.names.iter().zip(&columns).map(|(name, column)| column.decide(name)).collect();
    let sha256 = table.reader.into_inner().into_inner().sha256();
    let decided = evidence.decide().and_then(|numbers| Ok(Spelling { numbers, units: units?, sha256 }));
    decided.map_err(|reason| DictionaryError::results(path, reason))
}

/// Whether a field stands for a missing value. Other tools write `nan` and similar words.
fn is_missing(text: &str) -> bool {
    ["", "nan", "null", "none", "na", "n/a", "#n/a", "-", "--"].iter().any(|word| text.eq_ignore_ascii_case(word))
}

/// The records of a file after its header.
struct Table<'a> {
    path: &'a Path,
    reader: Reader<BufReader<Text>>,
    meter: Meter,
    /// Lines before the header.
    before: u64,
    names: Vec<Arc<str>>,
    record: StringRecord,
}

impl<'a> Table<'a> {
    fn open(path: &'a Path) -> Result<Self, DictionaryError> {
        let text = Text::open(path, LONGEST)?;
        let meter = text.meter();
        let mut text = BufReader::with_capacity(1 << 16, text);
        let start = text.fill_buf().map_err(DictionaryError::io(path, "read"))?;
        let first = start.split(|byte| *byte == b'\n').next().unwrap_or_default();
        // Excel reads the separator from such a line.
        let stated = first.trim_ascii().trim_ascii_end();
        let stated = stated.strip_prefix(b"\"").and_then(|line| line.strip_suffix(b"\"")).unwrap_or(stated);
        let (delimiter, before) = match stated.split_at_checked(4) {
            Some((key, [separator])) if key.eq_ignore_ascii_case(b"sep=") => (*separator, 1),
            // The tab is trimmed.
            Some((key, [])) if key.eq_ignore_ascii_case(b"sep=") => (b'\t', 1),
            _ => (delimiter(first), 0),
        };
        if before > 0 {
            let line = first.len() + 1;
            text.consume(line);
        }
        let mut reader = ReaderBuilder::new().delimiter(delimiter).from_reader(text);
        let headers = reader.headers().map_err(|e| refuse(path, before, &e))?;
        if headers.len() > MOST_FIELDS {
            let reason = format!("its header has {} columns. Expected at most {MOST_FIELDS}", headers.len());
            return Err(DictionaryError::results(path, reason));
        }
        let names: Vec<Arc<str>> = headers.iter().map(|name| unmarked(name.trim()).into()).collect();
        if let Some(i) = (1..names.len()).find(|i| names[..*i].contains(&names[*i])) {
            return Err(DictionaryError::results(path, format!("its header has the column `{}` twice", names[i])));
        }
        Ok(Self { path, reader, meter, before, names, record: StringRecord::new() })
    }

    fn next(&mut self) -> Result<bool, DictionaryError> {
        self.meter.reset();
        self.reader.read_record(&mut self.record).map_err(|e| refuse(self.path, self.before, &e))
    }

    /// The line of the record, from 1.
    fn line(&self) -> u64 {
        self.record.position().map_or(0, ::csv::Position::line) + self.before
    }

    /// Whether the record is the header again. Files that were merged repeat it. A header with other columns, or in
    /// another order, would give its rows a wrong meaning.
    fn repeats_header(&self) -> Result<bool, DictionaryError> {
        let is_name = |field: &str| self.names.iter().any(|name| **name == *field.trim());
        let same = self.names.iter().zip(&self.record).filter(|(name, field)| ***name == *field.trim()).count();
        if same == self.names.len() && same > 1 {
            return Ok(true);
        }
        let named = self.record.iter().filter(|field| is_name(field)).count();
        // A table of one column may have its name as a word: `success`.
        if 2 * named > self.names.len() {
            let what = if self.names.len() == 1 {
                "it repeats the name of the only column, which can be a header or a value\nHint: write true or false"
            } else {
                "it is a second header with other columns, or with columns in another order\nHint: import each file \
                 by itself, or give all files the same columns"
            };
            return Err(DictionaryError::results(self.path, format!("line {}: {what}", self.line())));
        }
        Ok(false)
    }
}

/// The separator of the header: the most frequent of comma, semicolon, tab and bar.
fn delimiter(header: &[u8]) -> u8 {
    let count = |of: u8| header.iter().filter(|byte| **byte == of).count();
    let most = *b",;\t|".iter().rev().max_by_key(|of| count(**of)).unwrap_or(&b',');
    if count(most) == 0 { b',' } else { most }
}

/// The truth values of spreadsheets in German, French, Spanish, Portuguese, Italian, Dutch, Polish and Swedish.
const TRUE: [&str; 11] =
    ["true", "True", "TRUE", "WAHR", "VRAI", "VERDADERO", "VERDADEIRO", "VERO", "WAAR", "PRAWDA", "SANT"];
const FALSE: [&str; 10] =
    ["false", "False", "FALSE", "FALSCH", "FAUX", "FALSO", "ONWAAR", "FA\u{141}SZ", "FALSZ", "FALSKT"];

/// Parses the value of a field.
fn scalar(text: &str, numbers: Numbers) -> Scalar {
    let text = text.trim();
    if is_missing(text) {
        return Scalar::Null;
    }
    if TRUE.contains(&text) {
        Scalar::Bool(true)
    } else if FALSE.contains(&text) {
        Scalar::Bool(false)
    } else {
        numbers.read(text).unwrap_or_else(|| Scalar::Text(unmarked(text).to_owned()))
    }
}

fn refuse(path: &Path, before: u64, error: &::csv::Error) -> DictionaryError {
    let line = error.position().map_or_else(String::new, |position| format!("line {}: ", position.line() + before));
    let reason = match error.kind() {
        ErrorKind::Io(e) if e.kind() == std::io::ErrorKind::InvalidData => {
            format!("{line}{e}\nHint: look for a quote that is never closed")
        }
        ErrorKind::Utf8 { err, .. } => format!("{line}{err}. Expected UTF-8"),
        ErrorKind::UnequalLengths { expected_len, len, .. } => {
            format!("{line}{len} fields. Expected {expected_len}, as in the header")
        }
        _ => error.to_string(),
    };
    DictionaryError::results(path, reason)
}
