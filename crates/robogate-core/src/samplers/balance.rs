//! Levels of a discrete parameter in equal shares.

use crate::{Domain, Stream};

/// Gives `levels` levels to n points in the order of their rank: rank r of 0..n gets level
/// floor((r k + o) / n), for k levels and one offset o drawn from 0..k for the whole column.
///
/// Each level goes to floor(n/k) or ceil(n/k) points, at any n; which levels get one more is up to o, so
/// that each point's level, taken alone, is uniform (systematic sampling; Madow and Madow 1944,
/// Annals of Mathematical Statistics 15(1)). Levels do not fall with rank: a column that was
/// evenly spread stays so.
#[derive(Debug, Clone, Copy)]
pub(super) struct Shares {
    n: u64,
    levels: u64,
    offset: u64,
}

impl Shares {
    /// `None` for a continuous domain.
    pub(super) fn of(domain: &Domain, n: usize, stream: &mut Stream) -> Option<Self> {
        let levels = domain.levels()?;
        Some(Self { n: n as u64, levels: levels as u64, offset: stream.below(levels) as u64 })
    }

    /// The middle of the level's cell in [0, 1): what [`Domain::from_unit`] takes back to the level.
    pub(super) fn unit(&self, rank: usize) -> f64 {
        // Below 2^31 points and 2^32 levels this stays within 64 bits.
        let level = (rank as u64 * self.levels + self.offset) / self.n;
        (level as f64 + 0.5) / self.levels as f64
    }
}
