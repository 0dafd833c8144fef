//! The difference of two rates from blocks, with an interval that holds after all looks simultaneously.
//!
//! The result of a block is 1, 0 or -1. Its mean is that of a bounded quantity, tested by constant bets as in
//! [`crate::bounded_mean`]. The capital after a look depends on the counts alone.

use crate::bounded_mean::{STAKES, boundary, ln_mean_exp, stake};
use crate::interval::Interval;

/// The blocks that each of two policies won, among all blocks of both so far.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(super) struct Won {
    /// The first policy got further.
    pub(super) first: u64,
    /// The second policy got further.
    pub(super) second: u64,
    /// All blocks.
    pub(super) blocks: u64,
}

impl Won {
    /// The blocks from the view of the other policy.
    pub(super) fn mirrored(self) -> Self {
        Self { first: self.second, second: self.first, ..self }
    }
}

/// The difference of two policies: of their success rates, or of how often each got further than the other.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PairInterval {
    /// Position of the first policy.
    pub first: usize,
    /// Position of the second policy.
    pub second: usize,
    /// Blocks that both ran.
    pub blocks: u64,
    /// First rate minus second. 0 without blocks.
    pub difference: f64,
    /// Its interval. It holds for all pairs and after all looks simultaneously.
    pub interval: Interval,
}

/// First rate minus second: the differences that no look excludes. Each side has the error probability `tail`.
pub(super) fn difference(looks: &[Won], tail: f64) -> Interval {
    let high = highest(looks, tail);
    let mirrored: Vec<Won> = looks.iter().map(|won| won.mirrored()).collect();
    Interval { low: -highest(&mirrored, tail), high }
}

fn highest(looks: &[Won], tail: f64) -> f64 {
    2.0 * boundary(|m| ln_evidence_below(looks, m) < -tail.ln()) - 1.0
}

/// ln of the largest evidence over all looks against "the mean of (1 + difference) / 2 is at least `m`".
fn ln_evidence_below(looks: &[Won], m: f64) -> f64 {
    if m <= 0.0 {
        return 0.0;
    }
    if m >= 1.0 {
        return if looks.iter().any(|won| won.first < won.blocks) { f64::INFINITY } else { 0.0 };
    }
    let gains = [1.0, 0.5, 0.0].map(|x| (m - x) / (1.0 - m));
    let rates: Vec<[f64; 3]> = (0..STAKES as i32).map(|i| gains.map(|gain| (stake(i) * gain).ln_1p())).collect();
    let evidence = |won: &Won| {
        let counts = [won.first, won.blocks.saturating_sub(won.first + won.second), won.second].map(|n| n as f64);
        let capital: Vec<f64> = rates.iter().map(|rate| rate.iter().zip(counts).map(|(r, n)| r * n).sum()).collect();
        ln_mean_exp(&capital)
    };
    looks.iter().map(evidence).fold(0.0, f64::max)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bounded_mean::BoundedMean;

    #[test]
    fn counts_give_the_interval_of_the_values() {
        let looks = [Won { first: 9, second: 2, blocks: 20 }, Won { first: 21, second: 3, blocks: 40 }];
        let part = |first: usize, second: usize, blocks: usize| {
            let same = vec![1.0; blocks - first - second];
            [vec![2.0; first], vec![0.0; second], same].concat()
        };
        let values = [part(9, 2, 20), part(12, 1, 20)].concat();
        let expected = BoundedMean::new(&values, &[20, 40], 2.0).unwrap().interval(0.025);
        let found = difference(&looks, 0.025);
        assert!((found.low + 1.0 - expected.low).abs() < 1e-9 && (found.high + 1.0 - expected.high).abs() < 1e-9);
        assert!(found.low > 0.0 && found.contains(0.45), "{found:?}");
    }

    #[test]
    fn no_blocks_exclude_nothing() {
        assert_eq!(difference(&[], 0.025), Interval { low: -1.0, high: 1.0 });
    }
}
