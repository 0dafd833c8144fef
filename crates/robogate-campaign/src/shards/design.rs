//! The designs of a campaign in shards, drawn once.
//!
//! A Latin hypercube of a few thousand points takes as long as several episodes, because its points keep their distance from each
//! other. The first process that needs a design draws and stores it. All shards then use the same points, also on machines whose C
//! library rounds differently. Large designs are not stored, because every shard would read all of their bytes.
//!
//! The file is the coded numbers of all points, row by row and little-endian, and the SHA-256 of these bytes.

use std::sync::Arc;

use robogate_core::Design;

use super::file::{HASH, sha256};
use super::{ShardError, Shards, Stored, get, put, store};
use crate::stage::Wanted;

/// The largest size of a design that is stored, in numbers: 4 MB.
const MOST_NUMBERS: u64 = 1 << 19;

impl Shards {
    /// The design `wanted`.
    pub(super) fn design(&self, wanted: &Wanted<'_>) -> Result<Design, ShardError> {
        let numbers = wanted.points.saturating_mul(wanted.space.len() as u64);
        if numbers > MOST_NUMBERS {
            return Ok(wanted.draw(self.plan())?);
        }
        let name = format!("{}/{}.points", store::SHARDS, wanted.name);
        if let Some(design) = self.stored(wanted, &name)? {
            return Ok(design);
        }
        let drawn = wanted.draw(self.plan())?;
        match put(&*self.store, &name, &encode(&drawn))? {
            Stored::New => Ok(drawn),
            // Another process was faster, and its points may differ in the last digit.
            Stored::Exists => Ok(self.stored(wanted, &name)?.unwrap_or(drawn)),
        }
    }

    /// The stored design. `None` if no process has stored it.
    fn stored(&self, wanted: &Wanted<'_>, name: &str) -> Result<Option<Design>, ShardError> {
        let Some(bytes) = get(&*self.store, name)? else { return Ok(None) };
        let design = decode(wanted, &bytes).ok_or_else(|| {
            let reason = format!("it is not a design of {} points of this space", wanted.points);
            ShardError::Damaged { path: self.store.place(name), reason }
        })?;
        Ok(Some(design))
    }
}

fn encode(design: &Design) -> Vec<u8> {
    let coded = (0..design.len()).filter_map(|i| design.coded(i)).flatten();
    let mut bytes: Vec<u8> = coded.flat_map(|code| code.to_le_bytes()).collect();
    let hash = sha256(&bytes);
    bytes.extend_from_slice(&hash);
    bytes
}

/// `None` if the bytes are damaged, or are not this design.
fn decode(wanted: &Wanted<'_>, bytes: &[u8]) -> Option<Design> {
    let (numbers, hash) = bytes.split_at_checked(bytes.len().checked_sub(HASH)?)?;
    if sha256(numbers) != hash {
        return None;
    }
    let (numbers, rest) = numbers.as_chunks::<8>();
    let coded = numbers.iter().map(|number| f64::from_le_bytes(*number)).collect();
    let design = Design::from_coded(Arc::clone(wanted.space), coded)?;
    (rest.is_empty() && design.len() as u64 == wanted.points).then_some(design)
}
