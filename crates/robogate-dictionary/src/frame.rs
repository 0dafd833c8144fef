//! Frames: how journals and shard files store entries.
//!
//! A frame has the length of its body, the CRC-32 of the body, the CRC-32 of these two fields, and the body: the exact
//! form of one entry. All numbers are little-endian.

use std::fmt;

use crate::codec::{self, Interner};
use crate::{DictionaryError, Entry};

/// The size of a frame's head in bytes.
pub(crate) const HEAD: usize = 12;

/// Appends `entry` to `out` as one frame. The same entry always gives the same bytes.
///
/// Returns an error if the entry cannot be recorded, for example because of an invalid weight. `out` is then unchanged.
pub fn encode_frame(entry: &Entry, out: &mut Vec<u8>) -> Result<(), DictionaryError> {
    entry.check()?;
    let start = out.len();
    out.resize(start + HEAD, 0);
    codec::encode(entry, out);
    let Ok(size) = u32::try_from(out.len() - start - HEAD) else {
        out.truncate(start);
        return Err(DictionaryError::TooLarge { index: entry.index() });
    };
    let head = make_head(size, crc32fast::hash(&out[start + HEAD..]));
    out[start..start + HEAD].copy_from_slice(&head);
    Ok(())
}

/// Reads the entries of consecutive frames. The iterator ends after the first error, which names the problem.
pub struct Frames<'a> {
    rest: &'a [u8],
    words: Interner,
}

impl<'a> Frames<'a> {
    /// Reads frames from `bytes`, which contain nothing else.
    pub fn new(bytes: &'a [u8]) -> Self {
        Self { rest: bytes, words: Interner::default() }
    }

    fn frame(&mut self) -> Result<Entry, String> {
        let Some((head, rest)) = self.rest.split_first_chunk() else {
            return Err("an episode is cut off".to_owned());
        };
        let Some((size, crc)) = parse_head(head) else {
            return Err("the head of an episode does not match its checksum".to_owned());
        };
        let Some((body, rest)) = rest.split_at_checked(size as usize) else {
            return Err("an episode is cut off".to_owned());
        };
        if crc32fast::hash(body) != crc {
            return Err("the content of an episode does not match its checksum".to_owned());
        }
        self.rest = rest;
        codec::decode(body, &mut self.words)
    }
}

impl fmt::Debug for Frames<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Frames").field("bytes_left", &self.rest.len()).finish_non_exhaustive()
    }
}

impl Iterator for Frames<'_> {
    type Item = Result<Entry, String>;

    fn next(&mut self) -> Option<Self::Item> {
        if self.rest.is_empty() {
            return None;
        }
        let frame = self.frame();
        if frame.is_err() {
            self.rest = &[];
        }
        Some(frame)
    }
}

fn make_head(size: u32, crc: u32) -> [u8; HEAD] {
    let mut head = [0; HEAD];
    head[..4].copy_from_slice(&size.to_le_bytes());
    head[4..8].copy_from_slice(&crc.to_le_bytes());
    let own = crc32fast::hash(&head[..8]);
    head[8..].copy_from_slice(&own.to_le_bytes());
    head
}

/// Size and checksum of the body, if the head matches its checksum.
pub(crate) fn parse_head(head: &[u8; HEAD]) -> Option<(u32, u32)> {
    let word = |at: usize| u32::from_le_bytes([head[at], head[at + 1], head[at + 2], head[at + 3]]);
    (crc32fast::hash(&head[..8]) == word(8)).then(|| (word(0), word(4)))
}
