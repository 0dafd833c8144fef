//! File formats of results, and their recognition.

use std::fmt;
use std::io::{BufRead, BufReader, Read};
use std::path::Path;

use serde::de::{DeserializeSeed, Deserializer, Error, IgnoredAny, MapAccess, SeqAccess, Visitor};

use super::Mapping;
use crate::DictionaryError;
use crate::decode::{Text, start_of};

/// A file format of per-episode results.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Format {
    /// The JSON of the dictionaries released with the paper ([`crate::published`]).
    Published,
    /// LeRobot's `eval_info.json`: `per_episode`, or `per_task` in newer versions with several tasks.
    LeRobot,
    /// The aggregate JSON of vla-eval: `tasks` with `episodes`.
    VlaEval,
    /// The evaluation log of Inspect Robots: `samples` with `epochs`.
    InspectRobots,
    /// The folder of a LeRobot dataset whose frames have `next.success`.
    LeRobotDataset,
    /// Comma, semicolon or tab separated values with a header.
    Csv,
    /// One JSON object per line.
    JsonLines,
    /// A flat Parquet file: uncompressed, snappy or zstd.
    Parquet,
}

impl Format {
    /// Every format.
    pub const ALL: [Self; 8] = [
        Self::Published,
        Self::LeRobot,
        Self::VlaEval,
        Self::InspectRobots,
        Self::LeRobotDataset,
        Self::Csv,
        Self::JsonLines,
        Self::Parquet,
    ];

    /// The name in options and provenance.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Published => "published_json",
            Self::LeRobot => "lerobot",
            Self::VlaEval => "vla_eval",
            Self::InspectRobots => "inspect_robots",
            Self::LeRobotDataset => "lerobot_dataset",
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
            Self::LeRobotDataset => super::lerobot::mapping(),
            Self::Published | Self::InspectRobots | Self::Csv | Self::JsonLines | Self::Parquet => Mapping::default(),
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

/// Recognises the format by the content of the file or folder. The file name is not used.
pub(super) fn recognise(path: &Path) -> Result<Format, DictionaryError> {
    if path.is_dir() {
        return Ok(Format::LeRobotDataset);
    }
    if start_of(path).starts_with(b"PAR1") {
        return Ok(Format::Parquet);
    }
    let text = Text::open_json(path, u64::MAX)?.take(FIRST_LOOK);
    let mut reader = BufReader::with_capacity(1 << 16, text);
    let start = reader.fill_buf().map_err(DictionaryError::io(path, "read"))?;
    let unknown = |what: &str| {
        DictionaryError::results(
            path,
            format!(
                "{what}. Expected LeRobot's eval_info.json or the folder of its dataset, the aggregate JSON of vla-eval, a log of Inspect Robots, the published JSON, CSV, JSON Lines or Parquet\nHint: if it has one of these formats, select it with --format"
            ),
        )
    };
    match start.iter().find(|byte| !byte.is_ascii_whitespace()) {
        None => return Err(unknown("the file is empty")),
        Some(b'{') => {}
        Some(b'[') => return Err(unknown("it is a JSON array; expected one object per line (JSON Lines)")),
        Some(_) => {
            let line = start.split(|byte| *byte == b'\n').next().unwrap_or_default();
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
                "samples" => Some(Format::InspectRobots),
                _ => None,
            };
            let Some(format) = format else {
                map.next_value::<IgnoredAny>()?;
                continue;
            };
            // In a row of JSON Lines, such a key can have any value: LeRobot's episodes.jsonl lists words as `tasks`.
            map.next_value_seed(Start { look: &mut *self, format, inside: false })?;
        }
        self.0 = Some(Seen::Whole);
        Ok(())
    }
}

/// Looks for an array of objects, which has the layout `format`. It ends the reading early with an error.
struct Start<'a> {
    look: &'a mut Look,
    format: Format,
    /// Whether the value is the first element of the array.
    inside: bool,
}

impl Start<'_> {
    fn found<E: Error>(self) -> Result<(), E> {
        self.look.0 = Some(Seen::Format(self.format));
        Err(E::custom("seen enough"))
    }
}

impl<'de> DeserializeSeed<'de> for Start<'_> {
    type Value = ();

    fn deserialize<D: Deserializer<'de>>(self, deserializer: D) -> Result<(), D::Error> {
        deserializer.deserialize_any(self)
    }
}

impl<'de> Visitor<'de> for Start<'_> {
    type Value = ();

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a value")
    }

    fn visit_unit<E: Error>(self) -> Result<(), E> {
        Ok(())
    }

    fn visit_bool<E: Error>(self, _: bool) -> Result<(), E> {
        Ok(())
    }

    fn visit_i64<E: Error>(self, _: i64) -> Result<(), E> {
        Ok(())
    }

    fn visit_u64<E: Error>(self, _: u64) -> Result<(), E> {
        Ok(())
    }

    fn visit_f64<E: Error>(self, _: f64) -> Result<(), E> {
        Ok(())
    }

    fn visit_str<E: Error>(self, _: &str) -> Result<(), E> {
        Ok(())
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut seq: A) -> Result<(), A::Error> {
        let Self { look, format, inside } = self;
        if !inside && seq.next_element_seed(Start { look: &mut *look, format, inside: true })?.is_none() {
            return Start { look, format, inside }.found();
        }
        while seq.next_element::<IgnoredAny>()?.is_some() {}
        Ok(())
    }

    fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<(), A::Error> {
        if self.inside {
            return self.found();
        }
        while map.next_entry::<IgnoredAny, IgnoredAny>()?.is_some() {}
        Ok(())
    }
}
