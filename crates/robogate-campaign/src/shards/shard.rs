//! The names of shards: their numbers and the number of all shards.

use std::collections::BTreeSet;
use std::fmt;
use std::ops::RangeInclusive;
use std::str::FromStr;

/// Largest number of shards. More is probably a typing error: each shard is a file.
pub const MOST_SHARDS: u32 = 100_000;

/// One of several shards, counted from 0. As text: `3/16`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Shard {
    index: u32,
    of: u32,
}

impl Shard {
    /// Creates shard `index` of `of`. The index is counted from 0.
    pub fn new(index: u32, of: u32) -> Result<Self, ShardNameError> {
        match of {
            1..=MOST_SHARDS if index < of => Ok(Self { index, of }),
            1..=MOST_SHARDS => Err(ShardNameError::Index { index, of }),
            _ => Err(ShardNameError::Count { of }),
        }
    }

    /// The number of the shard, from 0.
    pub fn index(self) -> u32 {
        self.index
    }

    /// The number of all shards.
    pub fn of(self) -> u32 {
        self.of
    }
}

impl fmt::Display for Shard {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}/{}", self.index, self.of)
    }
}

/// At least one shard of a campaign. As text: `3/16`, or numbers and ranges such as `0-3,7/16`.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ShardSet {
    indices: BTreeSet<u32>,
    of: u32,
}

impl ShardSet {
    /// The number of all shards of the campaign, also of those that are not in this set.
    pub fn of(&self) -> u32 {
        self.of
    }

    /// The shards in increasing order.
    pub fn iter(&self) -> impl Iterator<Item = Shard> {
        self.indices.iter().map(|index| Shard { index: *index, of: self.of })
    }
}

/// The range of a text `3` or `0-3`.
fn range(text: &str) -> Option<RangeInclusive<u32>> {
    let (first, last) = text.split_once('-').unwrap_or((text, text));
    let (first, last) = (first.parse().ok()?, last.parse().ok()?);
    (first <= last).then_some(first..=last)
}

impl FromStr for ShardSet {
    type Err = ShardNameError;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        let syntax = || ShardNameError::Syntax { text: text.to_owned() };
        let (numbers, of) = text.split_once('/').ok_or_else(syntax)?;
        let of = of.parse().map_err(|_| syntax())?;
        let mut indices = BTreeSet::new();
        for part in numbers.split(',') {
            let range = range(part).ok_or_else(syntax)?;
            // The largest number is checked first, so a long range costs nothing.
            Shard::new(*range.end(), of)?;
            indices.extend(range);
        }
        Ok(Self { indices, of })
    }
}

/// The reason why a text does not name shards.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum ShardNameError {
    /// Not integers and ranges.
    #[error(
        "`{text}` is not a shard. Expected K/N, for example 0/16 for the first of 16 shards, or several such as 0-3,7/16"
    )]
    Syntax {
        /// The text.
        text: String,
    },
    /// The number of the shard is too large.
    #[error("shard {index} of {of} does not exist. Expected 0 to {}: shards are counted from 0", of - 1)]
    Index {
        /// The number of the shard.
        index: u32,
        /// The number of all shards.
        of: u32,
    },
    /// The number of all shards is out of range.
    #[error("{of} shards are out of range. Expected 1 to {MOST_SHARDS}")]
    Count {
        /// The number of all shards.
        of: u32,
    },
}

#[cfg(test)]
mod tests {
    use super::*;

    fn named(text: &str) -> Vec<String> {
        text.parse::<ShardSet>().unwrap().iter().map(|shard| shard.to_string()).collect()
    }

    #[test]
    fn names_are_read() {
        for text in ["0/1", "3/16", "99999/100000"] {
            assert_eq!(named(text), [text]);
        }
        assert_eq!(named("7,0-2,2/16"), ["0/16", "1/16", "2/16", "7/16"]);
        assert_eq!(named("0-99999/100000").len(), 100_000);
    }

    #[test]
    fn wrong_names_are_rejected() {
        assert_eq!("16/16".parse::<ShardSet>(), Err(ShardNameError::Index { index: 16, of: 16 }));
        assert_eq!("0-4294967295/16".parse::<ShardSet>(), Err(ShardNameError::Index { index: u32::MAX, of: 16 }));
        assert_eq!("0/0".parse::<ShardSet>(), Err(ShardNameError::Count { of: 0 }));
        assert_eq!("0/100001".parse::<ShardSet>(), Err(ShardNameError::Count { of: 100_001 }));
        for text in ["", "3", "3/", "/16", "-1/4", "a/b", "1/2/3", "1.0/2", "1,/4", "2-1/4", "0-1-2/4", "0-/4"] {
            assert!(matches!(text.parse::<ShardSet>(), Err(ShardNameError::Syntax { .. })), "{text}");
        }
    }
}
