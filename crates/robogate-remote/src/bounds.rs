//! Headers held to the protocol's bounds before anything is made of them: one pass over the bytes, nothing kept.

use robogate_zmtp::Limits;

/// Version of the protocol.
pub const VERSION: u64 = 1;
/// Bytes of a header.
pub const HEADER_BYTES: usize = 4 << 20;
/// Edge of an image in pixels.
pub const PIXELS: usize = 4096;
/// Cameras of a server.
pub const CAMERAS: usize = 16;
/// Joints of an arm.
pub const JOINTS: usize = 32;
/// Parameters of a scenario.
pub const PARAMETERS: usize = 256;
/// Actions of one `step`.
pub const ACTIONS: usize = 256;
const NESTING: usize = 16;
const STRING_BYTES: usize = 4096;
const ENTRIES: usize = 65_536;

/// What a reply may be at most.
pub const REPLY: Limits = Limits { frames: 1 + CAMERAS, frame_bytes: 48 << 20, message_bytes: 64 << 20 };
/// What a request may be at most: it has a header alone.
pub const REQUEST: Limits = Limits { frames: 1, frame_bytes: HEADER_BYTES, message_bytes: HEADER_BYTES };

/// Bytes that are no header.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum Malformed {
    /// More bytes than a header has.
    #[error("the header has {0} bytes; {HEADER_BYTES} are allowed")]
    TooLong(usize),
    /// They end too early, or too late.
    #[error("the header is cut off, or something follows it, at byte {0}")]
    Cut(usize),
    /// No map, or a key that is no string.
    #[error("the header is no map with strings for keys, at byte {0}")]
    NoMap(usize),
    /// Maps within lists within maps ...
    #[error("{0} is nested more than {NESTING} deep")]
    Deep(String),
    /// Too many entries or too long a string.
    #[error("{0} has {1} entries or bytes")]
    Large(String, usize),
    /// A number that is not finite.
    #[error("{0} is not finite")]
    NotFinite(String),
    /// A value of a type that headers do not have, or text that is no UTF-8.
    #[error("{0} is of no type that a header may have")]
    Type(String),
    /// A key is missing, or a value is another than it must be.
    #[error("{0}")]
    Shape(String),
}

/// Holds a header to the bounds: one whole MessagePack map of string keys, not too large or deep, all numbers finite.
pub fn check(header: &[u8]) -> Result<(), Malformed> {
    if header.len() > HEADER_BYTES {
        return Err(Malformed::TooLong(header.len()));
    }
    let mut scan = Scan { bytes: header, at: 0, path: Vec::new() };
    if !matches!(header.first(), Some(0x80..=0x8f | 0xde | 0xdf)) {
        return Err(Malformed::NoMap(0));
    }
    scan.value()?;
    if scan.at < header.len() { Err(Malformed::Cut(scan.at)) } else { Ok(()) }
}

/// A step on the way to a value.
enum Way<'a> {
    Key(&'a str),
    Entry(usize),
}

struct Scan<'a> {
    bytes: &'a [u8],
    at: usize,
    path: Vec<Way<'a>>,
}

impl<'a> Scan<'a> {
    fn take(&mut self, count: usize) -> Result<&'a [u8], Malformed> {
        let end = self.at.checked_add(count).ok_or(Malformed::Cut(self.at))?;
        let taken = self.bytes.get(self.at..end).ok_or(Malformed::Cut(self.at))?;
        self.at = end;
        Ok(taken)
    }

    /// An unsigned number of so many bytes.
    fn count(&mut self, bytes: usize) -> Result<usize, Malformed> {
        Ok(self.take(bytes)?.iter().fold(0, |sum, byte| sum << 8 | usize::from(*byte)))
    }

    fn value(&mut self) -> Result<(), Malformed> {
        let marker = self.count(1)?;
        match marker {
            // Small integers, nil, false and true.
            0x00..=0x7f | 0xe0..=0xff | 0xc0 | 0xc2 | 0xc3 => Ok(()),
            0x80..=0x8f => self.map(marker & 0x0f),
            0x90..=0x9f => self.list(marker & 0x0f),
            0xa0..=0xbf => self.text(marker & 0x1f).map(drop),
            0xca => {
                let bits = self.count(4)? as u32;
                self.finite(f32::from_bits(bits).is_finite())
            }
            0xcb => {
                let bits = self.count(8)? as u64;
                self.finite(f64::from_bits(bits).is_finite())
            }
            // Integers of 1, 2, 4 and 8 bytes, unsigned and signed.
            0xcc..=0xcf => self.take(1 << (marker - 0xcc)).map(drop),
            0xd0..=0xd3 => self.take(1 << (marker - 0xd0)).map(drop),
            0xd9..=0xdb => {
                let length = self.count(1 << (marker - 0xd9))?;
                self.text(length).map(drop)
            }
            0xdc | 0xdd => {
                let length = self.count(2 << (marker - 0xdc))?;
                self.list(length)
            }
            0xde | 0xdf => {
                let length = self.count(2 << (marker - 0xde))?;
                self.map(length)
            }
            _ => Err(Malformed::Type(self.place())),
        }
    }

    fn finite(&self, finite: bool) -> Result<(), Malformed> {
        if finite { Ok(()) } else { Err(Malformed::NotFinite(self.place())) }
    }

    fn text(&mut self, length: usize) -> Result<&'a str, Malformed> {
        if length > STRING_BYTES {
            return Err(Malformed::Large(self.place(), length));
        }
        let bytes = self.take(length)?;
        std::str::from_utf8(bytes).map_err(|_| Malformed::Type(self.place()))
    }

    /// Room for so many entries, one level deeper.
    fn enter(&self, entries: usize) -> Result<(), Malformed> {
        if entries > ENTRIES {
            return Err(Malformed::Large(self.place(), entries));
        }
        if self.path.len() >= NESTING { Err(Malformed::Deep(self.place())) } else { Ok(()) }
    }

    fn map(&mut self, entries: usize) -> Result<(), Malformed> {
        self.enter(entries)?;
        for _ in 0..entries {
            let start = self.at;
            let length = match self.count(1)? {
                marker @ 0xa0..=0xbf => marker & 0x1f,
                marker @ 0xd9..=0xdb => self.count(1 << (marker - 0xd9))?,
                _ => return Err(Malformed::NoMap(start)),
            };
            let key = self.text(length)?;
            self.path.push(Way::Key(key));
            self.value()?;
            self.path.pop();
        }
        Ok(())
    }

    fn list(&mut self, entries: usize) -> Result<(), Malformed> {
        self.enter(entries)?;
        for i in 0..entries {
            self.path.push(Way::Entry(i));
            self.value()?;
            self.path.pop();
        }
        Ok(())
    }

    /// The value's place in words: `steps[0].observation.time_s`.
    fn place(&self) -> String {
        let mut place = String::new();
        for way in &self.path {
            match way {
                Way::Key(key) => {
                    let key: String = key.chars().filter(|c| !c.is_control()).take(64).collect();
                    place.push_str(if place.is_empty() { "" } else { "." });
                    place.push_str(&key);
                }
                Way::Entry(i) => place.push_str(&format!("[{i}]")),
            }
        }
        if place.is_empty() { "the header".to_owned() } else { place }
    }
}
