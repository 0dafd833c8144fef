//! Assigns the levels of a discrete parameter to points in equal shares.

use crate::{Domain, Stream};

/// Assigns `levels` levels to n points by rank. Rank r of 0..n gets level floor((r k + o) / n), with k levels and one
/// offset o for the whole column, uniform in 0..k.
///
/// Each level goes to floor(n/k) or ceil(n/k) points, for any n. The offset decides which levels get one more, which
/// makes the level of each single point uniform (systematic sampling; Madow and Madow 1944, Annals of Mathematical
/// Statistics 15(1)). Levels do not decrease with rank, which keeps an evenly spread column evenly spread.
#[derive(Debug, Clone, Copy)]
pub(super) struct Shares {
    n: u64,
    levels: u64,
    offset: u64,
}

impl Shares {
    /// Builds the shares of a domain. Returns `None` for a continuous domain.
    pub(super) fn of(domain: &Domain, n: usize, stream: &mut Stream) -> Option<Self> {
        let levels = domain.levels()?;
        Some(Self { n: n as u64, levels: levels as u64, offset: stream.below(levels) as u64 })
    }

    /// The middle of the level's cell in [0, 1), which [`Domain::from_unit`] maps back to the level.
    pub(super) fn unit(&self, rank: usize) -> f64 {
        // With at most 2^31 points and 2^32 levels the product fits into 64 bits.
        let level = (rank as u64 * self.levels + self.offset) / self.n;
        (level as f64 + 0.5) / self.levels as f64
    }
}
