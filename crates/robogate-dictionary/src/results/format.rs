//! File formats of results, and their recognition.

use std::fmt;
use std::fs::File;
use std::io::{BufRead, BufReader, Read};
use std::path::Path;

use serde::de::{Deserializer, Error, IgnoredAny, MapAccess, Visitor};

use super::Mapping;
use crate::DictionaryError;

/// A file format of per-episode results.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Format {
    /// The JSON of the dictionaries released with the paper ([`crate::published`]).
    Published,
    /// LeRobot's `eval_info.json`: `per_episode`, or `per_task` in newer versions with several tasks.
    LeRobot,
    /// The aggregate JSON of vla-eval: `tasks` with `episodes`.
    VlaEval,
    /// Comma, semicolon or tab separated values with a header.
    Csv,
    /// One JSON object per line.
    JsonLines,
    /// A flat Parquet file: uncompressed, snappy or zstd.
    Parquet,
}

impl Format {
    /// Every format.
    pub const ALL: [Self; 6] =
        [Self::Published, Self::LeRobot, Self::VlaEval, Self::Csv, Self::JsonLines, Self::Parquet];

    /// The name in options and provenance.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Published => "published_json",
            Self::LeRobot => "lerobot",
            Self::VlaEval => "vla_eval",
            Self::Csv => "csv",
            Self::JsonLines => "json_lines",
            Self::Parquet => "parquet",
        }
    }

    /// The default mapping of the format.
    pub(super) fn mapping(self) -> Mapping {
        match self {
            Self::LeRobot => super::lerobot::mapping(),
            Self::VlaEval => super::vla_eval::mapping(),
            Self::Published | Self::Csv | Self::JsonLines | Self::Parquet => Mapping::default(),
        }
    }
}

impl fmt::Display for Format {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.as_str())
    }
}

/// Maximum number of bytes that are read to recognise a JSON object.
const FIRST_LOOK: u64 = 16 << 20;

/// Recognises the format by the content of the file. The file name is not used.
pub(super) fn recognise(path: &Path) -> Result<Format, DictionaryError> {
    let file = File::open(path).map_err(DictionaryError::io(path, "open"))?;
    let mut reader = BufReader::with_capacity(1 << 16, file.take(FIRST_LOOK));
    let start = reader.fill_buf().map_err(DictionaryError::io(path, "read"))?;
    let unknown = |what: &str| {
        DictionaryError::results(
            path,
            format!(
                "{what}. Expected LeRobot's eval_info.json, the aggregate JSON of vla-eval, the published JSON, CSV, JSON Lines or Parquet\nhint: if it has one of these formats, select it with --format"
            ),
        )
    };
    if start.starts_with(b"PAR1") {
        return Ok(Format::Parquet);
    }
    let text = start.strip_prefix(b"\xef\xbb\xbf").unwrap_or(start);
    match text.iter().find(|byte| !byte.is_ascii_whitespace()) {
        None => return Err(unknown("the file is empty")),
        Some(b'{') => {}
        Some(b'[') => return Err(unknown("it is a JSON array; expected one object per line (JSON Lines)")),
        Some(_) => {
            let line = text.split(|byte| *byte == b'\n').next().unwrap_or_default();
            let plain = std::str::from_utf8(line).is_ok_and(|line| !line.contains('\0'));
            return if plain { Ok(Format::Csv) } else { Err(unknown("its format is unknown")) };
        }
    }
    let mut look = Look(None);
    let mut json = serde_json::Deserializer::from_reader(&mut reader);
    let _ = json.deserialize_map(&mut look);
    match look.0 {
        Some(Seen::Format(format)) => Ok(format),
        Some(Seen::Whole) => Ok(Format::JsonLines),
        None => Err(unknown("it starts as JSON, but has neither a known layout nor one object per line")),
    }
}

/// The layout that the keys of the first object indicate.
enum Seen {
    Format(Format),
    /// The object ended without a key of a known layout.
    Whole,
}

struct Look(Option<Seen>);

impl<'de> Visitor<'de> for &mut Look {
    type Value = ();

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("an object")
    }

    fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<(), A::Error> {
        while let Some(key) = map.next_key::<String>()? {
            let format = match key.as_str() {
                "experiments" => Some(Format::Published),
                "per_episode" | "per_task" => Some(Format::LeRobot),
                "tasks" => Some(Format::VlaEval),
                _ => None,
            };
            if let Some(format) = format {
                self.0 = Some(Seen::Format(format));
                return Err(A::Error::custom("seen enough"));
            }
            map.next_value::<IgnoredAny>()?;
        }
        self.0 = Some(Seen::Whole);
        Ok(())
    }
}
