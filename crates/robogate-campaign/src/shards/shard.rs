//! The name of a shard: its number and the number of all shards.

use std::fmt;
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

impl FromStr for Shard {
    type Err = ShardNameError;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        let numbers = text.split_once('/').and_then(|(index, of)| Some((index.parse().ok()?, of.parse().ok()?)));
        let (index, of) = numbers.ok_or_else(|| ShardNameError::Syntax { text: text.to_owned() })?;
        Self::new(index, of)
    }
}

/// The reason why a text does not name a shard.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum ShardNameError {
    /// Not two integers.
    #[error("`{text}` is not a shard. Expected K/N, for example 0/16 for the first of 16 shards")]
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

    #[test]
    fn names_round_trip() {
        for text in ["0/1", "3/16", "99999/100000"] {
            assert_eq!(text.parse::<Shard>().unwrap().to_string(), text);
        }
    }

    #[test]
    fn wrong_names_are_rejected() {
        assert_eq!("16/16".parse::<Shard>(), Err(ShardNameError::Index { index: 16, of: 16 }));
        assert_eq!("0/0".parse::<Shard>(), Err(ShardNameError::Count { of: 0 }));
        assert_eq!("0/100001".parse::<Shard>(), Err(ShardNameError::Count { of: 100_001 }));
        for text in ["", "3", "3/", "/16", "-1/4", "a/b", "1/2/3", "1.0/2"] {
            assert!(matches!(text.parse::<Shard>(), Err(ShardNameError::Syntax { .. })), "{text}");
        }
    }
}
