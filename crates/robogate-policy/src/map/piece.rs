//! The pieces of a map: where numbers and images come from.

use std::fmt;
use std::ops::Range;
use std::str::FromStr;

use serde::de::value::{MapAccessDeserializer, SeqAccessDeserializer};
use serde::de::{Error as _, MapAccess, SeqAccess, Visitor};
use serde::{Deserialize, Deserializer, Serialize, Serializer};

use crate::profile::Orientation;

/// The pieces of a vector, in order: one, or a list.
#[derive(Debug, Clone, PartialEq)]
pub struct Pieces(pub Vec<Piece>);

/// A piece of a vector or of an action.
#[derive(Debug, Clone, PartialEq)]
pub enum Piece {
    /// A constant.
    Number(f64),
    /// Numbers of a source: `scale * source + offset`.
    From {
        /// Where the numbers come from.
        source: Source,
        /// Their factor.
        scale: f64,
        /// What is added after scaling.
        offset: f64,
    },
}

/// A named vector, or numbers of it: `NAME`, `NAME[3]` or `NAME[0:3]`, with the end excluded. Negative positions count
/// from the end.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Source {
    /// The name.
    pub name: String,
    /// Which numbers. `None`: all.
    pub slice: Option<Slice>,
}

/// Which numbers of a vector.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Slice {
    /// One number.
    At(i64),
    /// From the first position up to the second, which is excluded. `None`: from the start, or to the end.
    Range(Option<i64>, Option<i64>),
}

/// A camera of the environment.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct CameraPiece {
    /// Its name.
    pub from: String,
    /// How its image is reoriented, before the profile's own orientation applies.
    pub orientation: Orientation,
}

impl Source {
    /// The positions of the numbers in a vector of this length.
    ///
    /// # Errors
    /// If the vector is too short.
    pub fn resolve(&self, length: usize) -> Result<Range<usize>, String> {
        let at = |position: i64| {
            let from_start = if position < 0 { position + length as i64 } else { position };
            usize::try_from(from_start).ok().filter(|at| *at <= length)
        };
        let range = match self.slice {
            None => Some(0..length),
            Some(Slice::At(position)) => at(position).map(|at| at..at + 1),
            Some(Slice::Range(low, high)) => {
                low.map_or(Some(0), at).zip(high.map_or(Some(length), at)).map(|(a, b)| a..b)
            }
        };
        let fits = range.filter(|range| range.start < range.end && range.end <= length);
        fits.ok_or_else(|| format!("`{self}`: out of range, because `{}` has {}", self.name, numbers(length)))
    }
}

/// A count of numbers as text.
pub(super) fn numbers(count: usize) -> String {
    if count == 1 { "1 number".to_owned() } else { format!("{count} numbers") }
}

impl FromStr for Source {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let wrong = || format!("`{text}` is not a source. Expected NAME, NAME[3] or NAME[0:3]");
        let text_of = |part: &str| part.trim().parse::<i64>().map_err(|_| wrong());
        let (name, slice) = match text.trim().split_once('[') {
            None => (text.trim(), None),
            Some((name, rest)) => {
                let inside = rest.strip_suffix(']').ok_or_else(wrong)?;
                let end = |part: &str| if part.trim().is_empty() { Ok(None) } else { text_of(part).map(Some) };
                let slice = match inside.split_once(':') {
                    None => Slice::At(text_of(inside)?),
                    Some((low, high)) => Slice::Range(end(low)?, end(high)?),
                };
                (name.trim(), Some(slice))
            }
        };
        if name.is_empty() || name.contains([' ', ']', ':']) {
            return Err(wrong());
        }
        Ok(Self { name: name.to_owned(), slice })
    }
}

impl fmt::Display for Source {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let end = |position: Option<i64>| position.map_or_else(String::new, |n| n.to_string());
        match self.slice {
            None => f.write_str(&self.name),
            Some(Slice::At(position)) => write!(f, "{}[{position}]", self.name),
            Some(Slice::Range(low, high)) => write!(f, "{}[{}:{}]", self.name, end(low), end(high)),
        }
    }
}

impl fmt::Display for Piece {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self::From { source, scale, offset } = self else {
            let Self::Number(number) = self else { return Ok(()) };
            return write!(f, "{number}");
        };
        match *scale {
            1.0 => write!(f, "{source}"),
            -1.0 => write!(f, "-{source}"),
            scale => write!(f, "{scale} {source}"),
        }?;
        match *offset {
            0.0 => Ok(()),
            offset if offset < 0.0 => write!(f, " - {}", -offset),
            offset => write!(f, " + {offset}"),
        }
    }
}

/// The table of a piece.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Table {
    from: String,
    #[serde(default = "one")]
    scale: f64,
    #[serde(default)]
    offset: f64,
}

fn one() -> f64 {
    1.0
}

impl Serialize for Piece {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        match self {
            Self::Number(number) => serializer.serialize_f64(*number),
            Self::From { source, scale, offset } if *scale == 1.0 && *offset == 0.0 => {
                serializer.serialize_str(&source.to_string())
            }
            Self::From { source, scale, offset } => {
                Table { from: source.to_string(), scale: *scale, offset: *offset }.serialize(serializer)
            }
        }
    }
}

impl<'de> Deserialize<'de> for Piece {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_any(PieceVisitor)
    }
}

/// Reads a piece. The errors name what was expected, which those of an untagged enum do not.
struct PieceVisitor;

impl<'de> Visitor<'de> for PieceVisitor {
    type Value = Piece;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a number, a source such as \"observation[0:3]\", or { from = SOURCE, scale = 1.0, offset = 0.0 }")
    }

    fn visit_f64<E: serde::de::Error>(self, number: f64) -> Result<Piece, E> {
        if number.is_finite() { Ok(Piece::Number(number)) } else { Err(E::custom("the number is not finite")) }
    }

    fn visit_i64<E: serde::de::Error>(self, number: i64) -> Result<Piece, E> {
        Ok(Piece::Number(number as f64))
    }

    fn visit_u64<E: serde::de::Error>(self, number: u64) -> Result<Piece, E> {
        Ok(Piece::Number(number as f64))
    }

    fn visit_str<E: serde::de::Error>(self, text: &str) -> Result<Piece, E> {
        Ok(Piece::From { source: text.parse().map_err(E::custom)?, scale: 1.0, offset: 0.0 })
    }

    fn visit_map<A: MapAccess<'de>>(self, map: A) -> Result<Piece, A::Error> {
        let Table { from, scale, offset } = Table::deserialize(MapAccessDeserializer::new(map))?;
        if !scale.is_finite() || scale == 0.0 {
            return Err(A::Error::custom(format!("scale is {}. Expected a number other than 0", said(scale))));
        }
        if !offset.is_finite() {
            return Err(A::Error::custom("offset is not finite"));
        }
        Ok(Piece::From { source: from.parse().map_err(A::Error::custom)?, scale, offset })
    }
}

fn said(number: f64) -> String {
    if number.is_finite() { number.to_string() } else { "not finite".to_owned() }
}

impl Serialize for Pieces {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        match self.0.as_slice() {
            [one] => one.serialize(serializer),
            several => several.serialize(serializer),
        }
    }
}

impl<'de> Deserialize<'de> for Pieces {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Several;

        impl<'de> Visitor<'de> for Several {
            type Value = Pieces;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                PieceVisitor.expecting(f)?;
                f.write_str(", or a list of these")
            }

            fn visit_f64<E: serde::de::Error>(self, number: f64) -> Result<Pieces, E> {
                PieceVisitor.visit_f64(number).map(|piece| Pieces(vec![piece]))
            }

            fn visit_i64<E: serde::de::Error>(self, number: i64) -> Result<Pieces, E> {
                PieceVisitor.visit_i64(number).map(|piece| Pieces(vec![piece]))
            }

            fn visit_u64<E: serde::de::Error>(self, number: u64) -> Result<Pieces, E> {
                PieceVisitor.visit_u64(number).map(|piece| Pieces(vec![piece]))
            }

            fn visit_str<E: serde::de::Error>(self, text: &str) -> Result<Pieces, E> {
                PieceVisitor.visit_str(text).map(|piece| Pieces(vec![piece]))
            }

            fn visit_map<A: MapAccess<'de>>(self, map: A) -> Result<Pieces, A::Error> {
                PieceVisitor.visit_map(map).map(|piece| Pieces(vec![piece]))
            }

            fn visit_seq<A: SeqAccess<'de>>(self, list: A) -> Result<Pieces, A::Error> {
                let pieces = Vec::<Piece>::deserialize(SeqAccessDeserializer::new(list))?;
                if pieces.is_empty() {
                    return Err(A::Error::custom("the list is empty. Expected at least one piece"));
                }
                Ok(Pieces(pieces))
            }
        }

        deserializer.deserialize_any(Several)
    }
}

/// The table of a camera.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct CameraTable {
    from: String,
    #[serde(default)]
    orientation: Orientation,
}

impl Serialize for CameraPiece {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        match self.orientation {
            Orientation::Upright => serializer.serialize_str(&self.from),
            orientation => CameraTable { from: self.from.clone(), orientation }.serialize(serializer),
        }
    }
}

impl<'de> Deserialize<'de> for CameraPiece {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Reader;

        impl<'de> Visitor<'de> for Reader {
            type Value = CameraPiece;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("the name of a camera, or { from = NAME, orientation = \"rotated\" }")
            }

            fn visit_str<E: serde::de::Error>(self, name: &str) -> Result<CameraPiece, E> {
                Ok(CameraPiece { from: name.to_owned(), orientation: Orientation::Upright })
            }

            fn visit_map<A: MapAccess<'de>>(self, map: A) -> Result<CameraPiece, A::Error> {
                let CameraTable { from, orientation } = CameraTable::deserialize(MapAccessDeserializer::new(map))?;
                Ok(CameraPiece { from, orientation })
            }
        }

        deserializer.deserialize_any(Reader)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn slices_resolve_as_in_python() {
        for (text, length, want) in [
            ("q", 4, Ok(0..4)),
            ("q[2]", 4, Ok(2..3)),
            ("q[-1]", 4, Ok(3..4)),
            ("q[1:3]", 4, Ok(1..3)),
            ("q[:2]", 4, Ok(0..2)),
            ("q[2:]", 4, Ok(2..4)),
            ("q[-3:-1]", 4, Ok(1..3)),
            ("q[4]", 4, Err(())),
            ("q[0:5]", 4, Err(())),
            ("q[2:2]", 4, Err(())),
            ("q[-5]", 4, Err(())),
        ] {
            let source: Source = text.parse().unwrap();
            assert_eq!(source.to_string(), text);
            assert_eq!(source.resolve(length).map_err(drop), want, "{text}");
        }
        let error = "q[4]".parse::<Source>().unwrap().resolve(1).unwrap_err();
        assert_eq!(error, "`q[4]`: out of range, because `q` has 1 number");
    }
}
