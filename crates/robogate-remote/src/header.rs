//! Encodes, checks and decodes headers.
//!
//! [`check`] makes one pass over the bytes and allocates nothing unless it finds an error, so a hostile header cannot
//! exhaust memory.

use serde::Serialize;
use serde::de::DeserializeOwned;

use super::limits::{ENTRIES, HEADER_BYTES, NESTING, STRING_BYTES};

/// An error in a header.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum MalformedHeader {
    /// The header exceeds [`HEADER_BYTES`].
    #[error("the header has {0} bytes; at most {HEADER_BYTES} are allowed")]
    TooLong(usize),
    /// The bytes end inside a value, or continue after the header. Holds the position.
    #[error("the header ends early or has extra bytes after it, at byte {0}")]
    Length(usize),
    /// The header is not a map, or has a key that is not a string. Holds the position.
    #[error("the header is not a MessagePack map with string keys, at byte {0}")]
    NotAMap(usize),
    /// Maps and arrays are nested deeper than [`NESTING`]. Holds the path of the value.
    #[error("{0} is nested more than {NESTING} levels deep")]
    TooDeep(String),
    /// A map, an array or a string is too large.
    #[error("{path} has {size} entries or bytes; at most {limit} are allowed")]
    TooLarge {
        /// Path of the value.
        path: String,
        /// Its entries, or its bytes for a string.
        size: usize,
        /// The limit.
        limit: usize,
    },
    /// A number is NaN or infinite. Holds its path.
    #[error("{0} is not finite")]
    NotFinite(String),
    /// A value has a MessagePack type that headers do not use, or a string is not UTF-8. Holds its path.
    #[error("{0} has a type that is not allowed in a header, or is not UTF-8")]
    Type(String),
    /// A key is missing, or a value has the wrong type.
    #[error("{0}")]
    Shape(String),
}

/// Encode a header.
pub fn encode(header: &impl Serialize) -> Result<Vec<u8>, MalformedHeader> {
    rmp_serde::to_vec_named(header).map_err(|why| MalformedHeader::Shape(why.to_string()))
}

/// Check a header and decode it.
pub fn decode<T: DeserializeOwned>(bytes: &[u8]) -> Result<T, MalformedHeader> {
    check(bytes)?;
    rmp_serde::from_slice(bytes).map_err(|why| MalformedHeader::Shape(format!("header: {why}")))
}

/// Check that the bytes are exactly one MessagePack map with string keys, within the limits, all numbers finite.
pub fn check(header: &[u8]) -> Result<(), MalformedHeader> {
    if header.len() > HEADER_BYTES {
        return Err(MalformedHeader::TooLong(header.len()));
    }
    let mut scanner = Scanner { bytes: header, position: 0, path: Vec::new() };
    if !matches!(header.first(), Some(0x80..=0x8f | 0xde | 0xdf)) {
        return Err(MalformedHeader::NotAMap(0));
    }
    scanner.value()?;
    if scanner.position < header.len() { Err(MalformedHeader::Length(scanner.position)) } else { Ok(()) }
}

/// One segment of the path to a value.
enum Segment<'a> {
    Key(&'a str),
    Index(usize),
}

struct Scanner<'a> {
    bytes: &'a [u8],
    position: usize,
    path: Vec<Segment<'a>>,
}

impl<'a> Scanner<'a> {
    fn take(&mut self, count: usize) -> Result<&'a [u8], MalformedHeader> {
        let end = self.position.checked_add(count).ok_or(MalformedHeader::Length(self.position))?;
        let taken = self.bytes.get(self.position..end).ok_or(MalformedHeader::Length(self.position))?;
        self.position = end;
        Ok(taken)
    }

    /// Read a big-endian unsigned integer of this many bytes.
    fn unsigned(&mut self, bytes: usize) -> Result<usize, MalformedHeader> {
        Ok(self.take(bytes)?.iter().fold(0, |sum, byte| sum << 8 | usize::from(*byte)))
    }

    fn value(&mut self) -> Result<(), MalformedHeader> {
        let marker = self.unsigned(1)?;
        match marker {
            // Small integers, nil, false and true.
            0x00..=0x7f | 0xe0..=0xff | 0xc0 | 0xc2 | 0xc3 => Ok(()),
            0x80..=0x8f => self.map(marker & 0x0f),
            0x90..=0x9f => self.array(marker & 0x0f),
            0xa0..=0xbf => self.string(marker & 0x1f).map(drop),
            0xca => {
                let bits = self.unsigned(4)? as u32;
                self.finite(f32::from_bits(bits).is_finite())
            }
            0xcb => {
                let bits = self.unsigned(8)? as u64;
                self.finite(f64::from_bits(bits).is_finite())
            }
            // Integers of 1, 2, 4 and 8 bytes, unsigned and signed.
            0xcc..=0xcf => self.take(1 << (marker - 0xcc)).map(drop),
            0xd0..=0xd3 => self.take(1 << (marker - 0xd0)).map(drop),
            0xd9..=0xdb => {
                let length = self.unsigned(1 << (marker - 0xd9))?;
                self.string(length).map(drop)
            }
            0xdc | 0xdd => {
                let length = self.unsigned(2 << (marker - 0xdc))?;
                self.array(length)
            }
            0xde | 0xdf => {
                let length = self.unsigned(2 << (marker - 0xde))?;
                self.map(length)
            }
            _ => Err(MalformedHeader::Type(self.path())),
        }
    }

    fn finite(&self, finite: bool) -> Result<(), MalformedHeader> {
        if finite { Ok(()) } else { Err(MalformedHeader::NotFinite(self.path())) }
    }

    fn string(&mut self, length: usize) -> Result<&'a str, MalformedHeader> {
        if length > STRING_BYTES {
            return Err(MalformedHeader::TooLarge { path: self.path(), size: length, limit: STRING_BYTES });
        }
        let bytes = self.take(length)?;
        std::str::from_utf8(bytes).map_err(|_| MalformedHeader::Type(self.path()))
    }

    /// Check the limits before the entries of a map or an array are read.
    fn enter(&self, entries: usize) -> Result<(), MalformedHeader> {
        if entries > ENTRIES {
            return Err(MalformedHeader::TooLarge { path: self.path(), size: entries, limit: ENTRIES });
        }
        if self.path.len() >= NESTING { Err(MalformedHeader::TooDeep(self.path())) } else { Ok(()) }
    }

    fn map(&mut self, entries: usize) -> Result<(), MalformedHeader> {
        self.enter(entries)?;
        for _ in 0..entries {
            let start = self.position;
            let length = match self.unsigned(1)? {
                marker @ 0xa0..=0xbf => marker & 0x1f,
                marker @ 0xd9..=0xdb => self.unsigned(1 << (marker - 0xd9))?,
                _ => return Err(MalformedHeader::NotAMap(start)),
            };
            let key = self.string(length)?;
            self.path.push(Segment::Key(key));
            self.value()?;
            self.path.pop();
        }
        Ok(())
    }

    fn array(&mut self, entries: usize) -> Result<(), MalformedHeader> {
        self.enter(entries)?;
        for i in 0..entries {
            self.path.push(Segment::Index(i));
            self.value()?;
            self.path.pop();
        }
        Ok(())
    }

    /// The path of the current value as text: `steps[0].observation.time_s`.
    fn path(&self) -> String {
        let mut text = String::new();
        for segment in &self.path {
            match segment {
                Segment::Key(key) => {
                    let key: String = key.chars().filter(|c| !c.is_control()).take(64).collect();
                    text.push_str(if text.is_empty() { "" } else { "." });
                    text.push_str(&key);
                }
                Segment::Index(i) => text.push_str(&format!("[{i}]")),
            }
        }
        if text.is_empty() { "the header".to_owned() } else { text }
    }
}
