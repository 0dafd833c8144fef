//! How the episodes of a round are divided among shards.

use std::ops::Range;

use robogate_core::Seed;

use super::{Shard, ShardRound};

/// The episodes of one round in shuffled order.
///
/// A shard gets a contiguous block of this order. Without the shuffle, one shard could get all scenarios of a difficult
/// category of a suite, and would take much longer than the others.
pub(super) struct Division {
    first: u64,
    order: Vec<u32>,
}

impl Division {
    /// Shuffles the episodes `indices` of `round`. Only the campaign's seed and the round determine the order.
    pub(super) fn new(indices: Range<u64>, campaign: u64, round: ShardRound) -> Self {
        // The limits of a plan are far below the range of u32.
        let count = u32::try_from(indices.end - indices.start).unwrap_or(u32::MAX);
        let mut order: Vec<u32> = (0..count).collect();
        Seed::campaign(campaign).stream(&format!("shards-{round}")).shuffle(&mut order);
        Self { first: indices.start, order }
    }

    /// The episodes of one shard, in increasing order.
    pub(super) fn of(&self, shard: Shard) -> Vec<u64> {
        let n = self.order.len() as u64;
        let position = |k: u32| (u64::from(k) * n / u64::from(shard.of())) as usize;
        let block = &self.order[position(shard.index())..position(shard.index() + 1)];
        let mut indices: Vec<u64> = block.iter().map(|offset| self.first + u64::from(*offset)).collect();
        indices.sort_unstable();
        indices
    }
}

/// The number of episodes of one shard, if all shards together have `episodes`.
pub(super) fn size(episodes: u64, shard: Shard) -> u64 {
    let position = |k: u32| u64::from(k) * episodes / u64::from(shard.of());
    position(shard.index() + 1) - position(shard.index())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_episode_has_one_shard() {
        for (n, of) in [(1, 1), (7, 3), (100, 16), (3, 5), (0, 2)] {
            let division = Division::new(1000..1000 + n, 7, ShardRound::Uniform);
            let shards: Vec<Vec<u64>> = (0..of).map(|k| division.of(Shard::new(k, of).unwrap())).collect();
            let mut all = shards.concat();
            all.sort_unstable();
            assert!(all.into_iter().eq(1000..1000 + n));
            for (k, shard) in shards.iter().enumerate() {
                assert!(shard.is_sorted());
                assert_eq!(shard.len() as u64, size(n, Shard::new(k as u32, of).unwrap()));
                assert!((n / u64::from(of)..=n.div_ceil(u64::from(of))).contains(&(shard.len() as u64)));
            }
        }
    }

    #[test]
    fn blocks_are_spread() {
        // 1,000 episodes in 10 categories, sorted by category. Each of 10 shards has most categories.
        let division = Division::new(0..1000, 2026, ShardRound::Suite(0));
        for k in 0..10 {
            let shard = division.of(Shard::new(k, 10).unwrap());
            let mut categories: Vec<u64> = shard.iter().map(|index| index / 100).collect();
            categories.dedup();
            assert_eq!(categories.len(), 10, "shard {k}");
        }
    }

    #[test]
    fn seed_and_round_change_order() {
        let of = |seed, round| Division::new(0..100, seed, round).of(Shard::new(0, 4).unwrap());
        assert_eq!(of(7, ShardRound::Suite(0)), of(7, ShardRound::Suite(0)));
        assert_ne!(of(7, ShardRound::Suite(0)), of(8, ShardRound::Suite(0)));
        assert_ne!(of(7, ShardRound::Suite(0)), of(7, ShardRound::Suite(1)));
    }
}
