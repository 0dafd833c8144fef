//! The file of one shard.
//!
//! A header, one [frame](robogate_dictionary::frame) per episode in increasing order of index, and the SHA-256 of all
//! bytes before. The same episodes always give the same bytes. All numbers are little-endian.

use sha2::{Digest, Sha256};

use robogate_dictionary::Entry;
use robogate_dictionary::frame::Frames;

use super::{Shard, ShardRound};

const MAGIC: [u8; 8] = *b"RGSHARD\n";
/// The version of the format.
pub(super) const VERSION: u32 = 1;
const HEADER: usize = 72;
/// The size of a SHA-256 in bytes.
pub(super) const HASH: usize = 32;

/// A SHA-256.
pub(super) type Hash = [u8; HASH];

/// The SHA-256 of `bytes`.
pub(super) fn sha256(bytes: &[u8]) -> Hash {
    Sha256::digest(bytes).into()
}

/// What a shard file says about itself.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Header {
    /// The SHA-256 of `plan.json`.
    pub(super) plan: Hash,
    /// The round.
    pub(super) round: ShardRound,
    /// The shard.
    pub(super) shard: Shard,
    /// The number of episodes.
    pub(super) episodes: u64,
}

/// The file name of a shard.
pub(super) fn name(round: ShardRound, shard: Shard) -> String {
    format!("{round}-{}-of-{}{ENDING}", shard.index(), shard.of())
}

/// The ending of the names of shard files.
pub(super) const ENDING: &str = ".rgs";

/// The round and shard of a file name.
pub(super) fn parse_name(file: &str) -> Option<(ShardRound, Shard)> {
    let (rest, of) = file.strip_suffix(ENDING)?.rsplit_once("-of-")?;
    let (round, index) = rest.rsplit_once('-')?;
    let parsed = (ShardRound::from_name(round)?, Shard::new(index.parse().ok()?, of.parse().ok()?).ok()?);
    // Only the name that this program writes, without leading zeros or signs.
    (name(parsed.0, parsed.1) == file).then_some(parsed)
}

/// The ending of the record of another result for a shard, after the name of its file.
const CONFLICT: &str = ".conflict";

/// The name of the record of another result for a shard. `shard` is the name of its file.
pub(super) fn conflict_name(shard: &str) -> String {
    format!("{shard}{CONFLICT}")
}

/// The file name of the shard to which the record `file` belongs. `None` if it is another file.
pub(super) fn contradicted(file: &str) -> Option<&str> {
    file.strip_suffix(CONFLICT).filter(|shard| parse_name(shard).is_some())
}

/// The bytes of a shard file. `frames` are those of its episodes in order.
pub(super) fn encode<'a>(header: &Header, frames: impl Iterator<Item = &'a [u8]>) -> Vec<u8> {
    let (kind, number) = header.round.code();
    let mut out = Vec::with_capacity(HEADER);
    out.extend_from_slice(&MAGIC);
    out.extend_from_slice(&VERSION.to_le_bytes());
    out.extend_from_slice(&header.plan);
    out.extend_from_slice(&kind.to_le_bytes());
    out.extend_from_slice(&number.to_le_bytes());
    out.extend_from_slice(&header.shard.index().to_le_bytes());
    out.extend_from_slice(&header.shard.of().to_le_bytes());
    out.extend_from_slice(&header.episodes.to_le_bytes());
    frames.for_each(|frame| out.extend_from_slice(frame));
    let hash = sha256(&out);
    out.extend_from_slice(&hash);
    out
}

/// The reason why a file cannot be read as a shard.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) enum Unreadable {
    /// The content is damaged.
    Damaged(String),
    /// A later version of the format.
    Newer(u32),
}

/// Checks the bytes of a shard file, and reads its header.
pub(super) fn decode(bytes: &[u8]) -> Result<(Header, &[u8]), Unreadable> {
    let damaged = |reason: &str| Unreadable::Damaged(reason.to_owned());
    let Some((content, trailer)) = bytes.split_last_chunk::<HASH>() else {
        return Err(damaged("it is too short for a shard"));
    };
    if sha256(content) != *trailer {
        return Err(damaged("its content does not match its SHA-256"));
    }
    let Some((header, frames)) = content.split_at_checked(HEADER) else {
        return Err(damaged("it is too short for a shard"));
    };
    if !header.starts_with(&MAGIC) {
        return Err(damaged("it does not start with the header of a shard"));
    }
    let mut fields = Fields(&header[MAGIC.len()..]);
    match fields.u32() {
        VERSION => {}
        newer @ VERSION.. => return Err(Unreadable::Newer(newer)),
        older => return Err(Unreadable::Damaged(format!("its version is {older}"))),
    }
    let header = Header {
        plan: fields.take(),
        round: ShardRound::from_code((fields.u32(), fields.u64())).ok_or_else(|| damaged("its round is unknown"))?,
        shard: Shard::new(fields.u32(), fields.u32()).map_err(|why| Unreadable::Damaged(why.to_string()))?,
        episodes: fields.u64(),
    };
    Ok((header, frames))
}

/// Reads the episodes `indices` from the frames of a file, in order. A difference is an error.
pub(super) fn entries<'a>(frames: &'a [u8], indices: &'a [u64]) -> impl Iterator<Item = Result<Entry, String>> + 'a {
    let mut expected = indices.iter();
    let mut frames = Frames::new(frames);
    std::iter::from_fn(move || match (frames.next(), expected.next()) {
        (None, None) => None,
        (Some(Ok(entry)), Some(index)) if entry.index() == *index => Some(Ok(entry)),
        (Some(Err(reason)), _) => Some(Err(reason)),
        (Some(Ok(entry)), _) => Some(Err(format!("it contains the unexpected episode {}", entry.index()))),
        (None, Some(index)) => Some(Err(format!("episode {index} is missing"))),
    })
}

/// The fields of a header, whose length was checked.
struct Fields<'a>(&'a [u8]);

impl Fields<'_> {
    fn take<const N: usize>(&mut self) -> [u8; N] {
        let (field, rest) = self.0.split_first_chunk().unwrap_or((&[0; N], &[]));
        self.0 = rest;
        *field
    }

    fn u32(&mut self) -> u32 {
        u32::from_le_bytes(self.take())
    }

    fn u64(&mut self) -> u64 {
        u64::from_le_bytes(self.take())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn header() -> Header {
        let shard = Shard::new(3, 16).unwrap();
        Header { plan: [7; HASH], round: ShardRound::Suite(2), shard, episodes: 0 }
    }

    #[test]
    fn header_round_trips() {
        let bytes = encode(&header(), std::iter::empty());
        assert_eq!(bytes.len(), HEADER + HASH);
        assert_eq!(decode(&bytes), Ok((header(), &[][..])));
    }

    #[test]
    fn newer_version_is_named() {
        let bytes = encode(&header(), std::iter::empty());
        let mut content = bytes[..HEADER].to_vec();
        content[8] = 2;
        let hash = sha256(&content);
        content.extend_from_slice(&hash);
        assert_eq!(decode(&content), Err(Unreadable::Newer(2)));
    }

    #[test]
    fn only_exact_names_are_parsed() {
        let shard = Shard::new(3, 16).unwrap();
        for round in [ShardRound::Uniform, ShardRound::Boundary, ShardRound::Suite(12)] {
            assert_eq!(parse_name(&name(round, shard)), Some((round, shard)));
        }
        assert_eq!(name(ShardRound::Suite(1), shard), "suite-1-3-of-16.rgs");
        for file in ["uniform-03-of-16.rgs", "uniform-3-of-16", "uniform-16-of-16.rgs", "3-of-16.rgs", "layout.json"] {
            assert_eq!(parse_name(file), None, "{file}");
        }
    }

    #[test]
    fn records_of_other_results_name_their_shard() {
        let shard = name(ShardRound::Uniform, Shard::new(3, 16).unwrap());
        assert_eq!(contradicted(&conflict_name(&shard)), Some("uniform-3-of-16.rgs"));
        for file in ["uniform-3-of-16.rgs", "uniform-3-of-16.conflict", "notes.conflict"] {
            assert_eq!(contradicted(file), None, "{file}");
        }
    }
}
